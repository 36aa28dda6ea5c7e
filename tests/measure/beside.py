"""Poses where other light leans on LEDs, against the bound of them alone: `python -m tests.measure.beside [FRAMES]`.

Robots drawn by tests/centres/rendering.py, located alone. "mirrored": the image of every LED of a robot in a floor, 1.2
to 3 radii beside it, of 5 to 50 % of its light and a little blurred. "leaning": on every other LED a glow of 5 to 50 %
of its light, as wide as the LED or twice as wide, 0.5 to 3 radii beside it. "floor": rough surroundings, 1 to 5 grey
levels RMS. The bound is that of the robot without the other light, each LED's centre at its own Cramer-Rao bound
(`centre_noise`). "x": errors of unflagged poses over it, root mean square over its six axes; "median": of single poses.
NEES: squared error weighted by the covariance, 6 where covariances are meant, of all poses but flips; "> 60": poses
without an alternative whose squared error is more than sixty times its covariance; "either": TILT_AMBIGUOUS.
"""

import sys
from collections.abc import Callable, Mapping

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.ndimage import gaussian_filter

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server.centres.centre_noise import centre_covariances
from asterism.server.simulation.simulate import Look
from tests.centres.bounds import GAIN, READ, pose_bound
from tests.centres.rendering import Canvas
from tests.chain.frames import LEVEL, disc_image, draw, poses_apart
from tests.chain.judging import Judged
from tests.measure.pictures import judged
from tests.rigs import make_rig

ROBOTS = 5
LOOK = Look(psf_px=Canvas.of(1, 1).psf_px, brightness=LEVEL, read_noise=READ, gain=GAIN)
SILENT = 60.0
Leds = list[tuple[Floats, float, float, float]]  # of a robot: centre px, semi-axes px, angle


def leds_of(rig: Rig, name: str, pose: Pose) -> Leds:
    """The images of a robot's LEDs."""
    robot = rig.robot(name)
    normal = pose.rotation @ robot.T_robot_plane.rotation[:, 2]
    return [disc_image(rig.camera, led, normal, robot.led_radius or 0.0025) for led in pose.map(robot.leds)]


def mirrored(canvas: Canvas, leds: Leds, rng: np.random.Generator) -> None:
    """Every LED's image in a floor."""
    angle, away, share = rng.uniform(0, 2 * np.pi), rng.uniform(1.2, 3.0), rng.uniform(0.05, 0.5)
    blur = float(np.hypot(canvas.psf_px, rng.uniform(0.0, 1.2)))
    for (x, y), a, b, turn in leds:
        canvas.ellipse(
            x + a * away * np.cos(angle), y + a * away * np.sin(angle), a, b, turn, level=share * LEVEL, blur=blur
        )


def leaning(canvas: Canvas, leds: Leds, rng: np.random.Generator) -> None:
    """A glow on some LEDs."""
    for (x, y), a, _, _ in leds:
        if rng.random() < 0.5:
            angle, away, width = rng.uniform(0, 2 * np.pi), a * rng.uniform(0.5, 3.0), a * rng.uniform(1.0, 2.0)
            share = rng.uniform(0.05, 0.5)
            canvas.ellipse(
                x + away * np.cos(angle), y + away * np.sin(angle), 0.5 * width, level=share * LEVEL, blur=0.8 * width
            )


def floor(canvas: Canvas, leds: Leds, rng: np.random.Generator) -> None:
    """Rough surroundings of the robot."""
    middle, reach = np.mean([centre for centre, *_ in leds], axis=0), 70
    texture = gaussian_filter(rng.standard_normal((2 * reach, 2 * reach)), rng.uniform(1.5, 5.0))
    fade = np.hanning(2 * reach)
    patch = rng.uniform(1.0, 5.0) * (texture - texture.min()) / texture.std() * np.outer(fade, fade)
    x, y = (int(value) - reach for value in middle)
    x, y = min(max(x, 0), canvas.light.shape[1] - 2 * reach), min(max(y, 0), canvas.light.shape[0] - 2 * reach)
    canvas.light[y : y + 2 * reach, x : x + 2 * reach] += patch


def nothing(canvas: Canvas, leds: Leds, rng: np.random.Generator) -> None:
    """The robot alone."""


KINDS: dict[str, Callable[[Canvas, Leds, np.random.Generator], None]] = {
    "nothing": nothing,
    "mirrored": mirrored,
    "leaning": leaning,
    "floor": floor,
}


def bound_of(rig: Rig, name: str, pose: Pose) -> Floats:
    """Covariance (6, 6) of the best possible pose without other light."""
    robot = rig.robot(name)
    points = pose.map(robot.leds)
    normal = pose.rotation @ robot.T_robot_plane.rotation[:, 2]
    normals = np.tile(normal, (len(points), 1))
    focal = float(rig.camera.matrix[0, 0])
    noise, rounding = centre_covariances(points, normals, robot.led_radius or 0.0025, focal, LOOK)

    def project(step: Floats) -> Floats:
        moved = Pose.from_matrix(exp_rotation(step[3:]) @ pose.rotation, pose.position + step[:3])
        projected: Floats = rig.camera.project(moved.map(robot.leds))
        return projected

    return pose_bound(project, np.zeros(6), noise + rounding)


def cells(kind: str, robots: list[tuple[Judged, Floats]]) -> list[str]:
    """A row of the table."""
    found = [(robot, bound) for robot, bound in robots if robot.answer is not None and not robot.wrong]
    ratios, nees, silent, flagged = [], [], 0, 0
    for robot, bound in found:
        assert robot.answer is not None
        alone = robot.answer.alternative is None
        flagged += not alone
        if alone:
            ratios.append(float(robot.error @ np.linalg.solve(bound, robot.error)) / 6.0)
            silent += robot.nees > SILENT
        if not robot.tilted:
            nees.append(robot.nees)
    return [
        kind,
        f"{len(found)}/{len(robots)}",
        f"{np.sqrt(np.mean(ratios)):.2f}",
        f"{np.sqrt(np.median(ratios)):.2f}",
        f"{np.mean(nees):.1f} ±{np.std(nees) / np.sqrt(len(nees)):.1f}",
        f"{np.median(nees):.1f}",
        str(silent),
        f"{100 * flagged / max(len(found), 1):.0f} %",
    ]


def measure(frames: int, console: Console) -> Mapping[str, list[tuple[Judged, Floats]]]:
    """Render and locate every kind of frame."""
    kinds: dict[str, list[tuple[Judged, Floats]]] = {name: [] for name in KINDS}
    for frame in track(range(frames), description="locating", transient=True, disable=not console.is_terminal):
        rng = np.random.default_rng([23, frame])
        rig = make_rig(ROBOTS, seed=frame % 4)
        poses = poses_apart(rig, rng, depth_m=(0.9, 1.5), tilt_deg=(0.0, 45.0))
        leds = {name: leds_of(rig, name, pose) for name, pose in poses.items()}
        bounds = {name: bound_of(rig, name, pose) for name, pose in poses.items()}
        clean = draw(rig, poses)
        for kind, disturb in KINDS.items():
            canvas = Canvas(clean.light.copy(), clean.psf_px)
            for seen in leds.values():
                disturb(canvas, seen, rng)
            kinds[kind] += [(robot, bounds[robot.where]) for robot in judged(rig, canvas.expose(rng), poses)]
    return kinds


def main(frames: int, console: Console) -> None:
    """Measure and print."""
    table = Table(title="each frame alone", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("beside LEDs", "found", "x", "median", "NEES", "median", "> 60", "either"):
        table.add_column(heading, justify="left" if heading == "beside LEDs" else "right")
    for kind, robots in measure(frames, console).items():
        table.add_row(*cells(kind, robots))
    console.print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, Console(width=100))
