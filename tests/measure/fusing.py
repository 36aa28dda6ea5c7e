"""Poses of several cameras joined, on rendered films: `python -m tests.measure.fusing [ROW ...] [--seeds N]`.

Rows: `pair`, two cameras 60 degrees apart that expose together; `late`, the second half a frame later; `moved`, three
cameras of which the third is 1 mm and 0.1 degrees from where its rig says; `plate` and `ruler`, two cameras, LEDs off
by 0.05 and 0.4 mm and cameras placed to 0.3 mm and 0.02 degrees; `row`, robots that drive along three cameras in a row.
f = 1400 px, 1.3 m, 60 Hz, two robots at 0.12 m/s (`row`: one at 0.5 m/s). Errors are in the first camera's frame, and
for comparison in each camera's own. The bound takes every LED's centre at its own Cramer-Rao bound, of all cameras
together, without any motion. The first frames of `late`, until velocities are known, are left out. NEES is 6 where
covariances are honest.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.rig import Rig
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.fuse import fuse
from asterism.server.fusing.fused import Fused, FusedPose
from asterism.server.fusing.memory import Joint
from asterism.server.fusing.sighting import Sighting, sighting_of
from asterism.server.pose.place import moved
from tests.centres.bounds import centre_bound, pose_bound
from tests.measure.poses import BLUR_PX, LOOK, spots_of
from tests.several import Drive, Poses, facing_pair, frames_of, looking_at, reports_of, rigs_at

PERIOD_NS = 16_666_667
START_NS = 1_000_000_000
SETTLED = 15  # frames until velocities are known
OFF = np.array([1e-3] * 3 + [math.radians(0.1)] * 3) / math.sqrt(3.0)
PLACED = np.diag([0.3e-3] * 3 + [math.radians(0.02)] * 3) ** 2


@dataclass(frozen=True)
class Film:
    """Cameras as believed, ``views``, and as they are, ``true``; how robots move; ``late_ns`` of every camera."""

    views: Sequence[View]
    true: Sequence[Rig]
    drive: Callable[[float], Poses]
    frames: int
    late_ns: Sequence[int] = (0, 0, 0)
    seed: int = 0

    def sightings(self) -> list[Sighting]:
        """Of all cameras' frames, by their times."""
        found = []
        for view, rig, late in zip(self.views, self.true, self.late_ns, strict=False):
            times = [START_NS + late + k * PERIOD_NS for k in range(self.frames)]
            reports = reports_of(frames_of(rig, self.drive, times, look=LOOK, seed=self.seed), view.rig)
            found += [sighting_of(report, view) for report in reports]
        return sorted(found, key=lambda one: (one.exposed_ns, one.camera))


@dataclass
class Tally:
    """What came of films: errors (6,) of fused poses in the first camera's axes, and ``turned`` into each camera's; of
    the cameras' ``own`` poses, each in its axes; variances of the best possible poses; NEES.
    """

    errors: list[Floats] = field(default_factory=list)
    bounds: list[Floats] = field(default_factory=list)
    own: dict[str, list[Floats]] = field(default_factory=dict)
    turned: dict[str, list[Floats]] = field(default_factory=dict)
    nees: list[float] = field(default_factory=list)
    jumps: list[Floats] = field(default_factory=list)
    lost: int = 0
    wrong: int = 0
    ambiguous: int = 0


def fused_of(film: Film, cameras: Sequence[str] = ()) -> Iterator[tuple[Fused, list[Sighting], Joint]]:
    """What fusing makes of the film, of all its cameras or some."""
    views = [view for view in film.views if not cameras or view.camera in cameras]
    fleet, joint = Fleet.of(views), Joint.none()
    some = [one for one in film.sightings() if one.camera in fleet.views]
    for _, together in groupby(some, key=lambda one: one.exposed_ns):
        sightings = list(together)
        fused, joint = fuse(sightings, fleet, joint)
        yield fused, sightings, joint


def error_of(pose: Pose, true: Pose, axes: Floats) -> Floats:
    """(6,) m and rad, in axes (3, 3) whose columns are in the world."""
    return np.concatenate(
        [axes.T @ (pose.position - true.position), axes.T @ log_rotation(pose.rotation @ true.rotation.T)]
    )


def count(film: Film, tally: Tally, skip: int = 0, cameras: Sequence[str] = (), bounded: bool = False) -> None:
    """Add a film to the tally, from a line on."""
    first = film.views[0].T_world_camera.rotation
    before: dict[str, tuple[Floats, Floats]] = {}
    cache: dict[tuple[int, ...], Floats] = {}
    for line, (fused, sightings, _) in enumerate(fused_of(film, cameras)):
        true = film.drive(fused.exposed_ns * 1e-9)
        for robot, answer in fused.answers.items():
            if line < skip:
                continue
            if not isinstance(answer, FusedPose):
                tally.lost += 1
                continue
            error = error_of(answer.pose, true[robot], np.eye(3))
            tally.wrong += bool(np.linalg.norm(error[:3]) > 0.005 or np.linalg.norm(error[3:]) > math.radians(5))
            tally.ambiguous += answer.alternative is not None
            tally.nees.append(float(error @ np.linalg.solve(answer.covariance, error)))
            tally.errors.append(error_of(answer.pose, true[robot], first))
            for view in film.views:
                turned = error_of(answer.pose, true[robot], view.T_world_camera.rotation)
                tally.turned.setdefault(view.camera, []).append(turned)
            if robot in before:
                e, c = before[robot]
                tally.jumps.append((error - e) / np.sqrt(np.diag(answer.covariance + c)))
            before[robot] = error, answer.covariance
            if bounded:
                tally.bounds.append(bound_of(film, robot, true[robot], first, cache))
        _count_own(tally, sightings, true)


def _count_own(tally: Tally, sightings: Sequence[Sighting], true: Poses) -> None:
    for one in sightings:
        axes = one.T_world_camera.rotation
        for robot, told in one.told.items():
            if told.HasField("pose"):
                tally.own.setdefault(one.camera, []).append(error_of(report_pose(told.pose), true[robot], axes))


def bound_of(film: Film, robot: str, true: Pose, axes: Floats, cache: dict[tuple[int, ...], Floats]) -> Floats:
    """Variances (6,) of the best possible pose by all cameras together, in those axes."""
    covariances, cameras = [], []
    for rig in film.true:
        assert rig.T_world_camera is not None
        one = replace(rig, robots=(rig.robot(robot),))
        cameras.append((one, rig.T_world_camera.inverse()))
        for a, b, angle, level in spots_of(one, cameras[-1][1] @ true):
            key = (round(a * 10), round(b * 10), round(np.degrees(angle) / 15) % 12, round(level / 10))
            if key not in cache:
                short = min(key[1] / 10, key[0] / 10 - 0.02)
                cache[key] = centre_bound(key[0] / 10, short, math.radians(key[2] * 15), key[3] * 10.0, BLUR_PX)
            covariances.append(cache[key])

    def project(step: Floats) -> Floats:
        pose = Pose.from_matrix(exp_rotation(axes @ step[3:]) @ true.rotation, true.position + axes @ step[:3])
        return np.concatenate([rig.camera.project((T @ pose).map(rig.robots[0].leds)) for rig, T in cameras])

    return np.diag(pose_bound(project, np.zeros(6), np.array(covariances)))


def pair(seeds: int, late_ns: int = 0) -> Tally:
    """Two cameras 60 degrees apart."""
    tally = Tally()
    for seed in range(seeds):
        rigs = rigs_at(facing_pair(), 2, seed)
        drive = Drive(tuple(robot.id for robot in rigs[0].robots), seed)
        film = Film([View(rig) for rig in rigs], rigs, drive, 60, (0, late_ns), seed)
        count(film, tally, SETTLED * 2 if late_ns else 0, bounded=True)
    return tally


def off_leds(seeds: int, off_m: float) -> Tally:
    """Two cameras, placed by hand, whose rigs have the LEDs wrong."""
    tally = Tally()
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 7])
        rigs = rigs_at(facing_pair(), 2, seed)
        drive = Drive(tuple(robot.id for robot in rigs[0].robots), seed)
        robots = tuple(replace(robot, leds=robot.leds + off_m * rng.normal(size=(6, 3))) for robot in rigs[0].robots)
        true = []
        for rig in rigs:
            assert rig.T_world_camera is not None
            place = moved(rig.T_world_camera, np.sqrt(np.diag(PLACED)) * rng.normal(size=6))
            true.append(replace(rig, robots=robots, T_world_camera=place))
        count(Film([View(rig, PLACED) for rig in rigs], true, drive, 12, seed=seed), tally)
    return tally


def three() -> list[Pose]:
    """Three cameras about one floor."""
    return [*facing_pair(), looking_at(1.3 * np.array([0.05, 0.37, 0.93]), np.zeros(3), 0.1)]


def misplaced(seeds: int) -> tuple[Tally, Tally, float, int]:
    """Three cameras, the third moved: figures of all three, of the two alone, the longest time until it was named, s,
    and how many poses rested on it.
    """
    all_three, alone, longest, rested = Tally(), Tally(), 0.0, 0
    for seed in range(seeds):
        rigs = rigs_at(three(), 2, seed)
        drive = Drive(tuple(robot.id for robot in rigs[0].robots), seed)
        assert rigs[2].T_world_camera is not None
        true = [*rigs[:2], replace(rigs[2], T_world_camera=moved(rigs[2].T_world_camera, OFF))]
        film = Film([View(rig) for rig in rigs], true, drive, 90, seed=seed)
        count(film, all_three)
        count(film, alone, cameras=("left", "right"))
        named = math.inf
        for fused, _, joint in fused_of(film):
            told = [answer for answer in fused.answers.values() if isinstance(answer, FusedPose)]
            rested += sum("third" in answer.cameras for answer in told)
            if "third" in joint.places.misplaced:
                named = min(named, (fused.exposed_ns - START_NS) * 1e-9)
        longest = max(longest, named)
    return all_three, alone, longest, rested


def along(seeds: int) -> Tally:
    """Robots that drive along a row of three cameras."""
    tally = Tally()
    for seed in range(seeds):
        rigs = rigs_at(
            [looking_at(np.array([x, 0.0, 1.3]), np.array([x, 0.0, 0.0])) for x in (-0.7, 0.0, 0.7)], 1, seed
        )
        rng = np.random.default_rng([seed, 3])
        y, yaw, sway = rng.uniform(-0.15, 0.15), rng.uniform(-math.pi, math.pi), rng.uniform(0, 6, 3)

        def drive(time_s: float, y: float = y, yaw: float = yaw, sway: Floats = sway) -> Poses:
            t = time_s - START_NS * 1e-9
            turn = exp_rotation(np.array([0.1 * np.sin(t + sway[0]), 0.1 * np.sin(1.3 * t + sway[1]), yaw + 0.5 * t]))
            return {"r00": Pose.from_matrix(turn, np.array([-0.95 + 0.5 * t, y + 0.05 * np.sin(t + sway[2]), 0.0]))}

        count(Film([View(rig) for rig in rigs], rigs, drive, 228, seed=seed), tally)
    return tally


def rows(tally: Tally) -> Iterator[list[str]]:
    """The table's rows: fused, and each camera alone."""
    factors = np.array([1e3] * 3 + [180 / math.pi] * 3)
    rmse = np.sqrt(np.mean(np.square(tally.errors), axis=0))
    yield ["fused", *(f"{x:.4f}" for x in rmse * factors), f"{np.mean(tally.nees):.2f}"]
    if tally.bounds:
        bound = np.sqrt(np.mean(tally.bounds, axis=0))
        yield ["bound", *(f"{x:.4f}" for x in bound * factors), ""]
        yield ["fused / bound", *(f"{x:.2f}" for x in rmse / bound), ""]
    for camera, errors in tally.own.items():
        alone = np.sqrt(np.mean(np.square(errors), axis=0))
        yield [f"{camera} alone, its axes", *(f"{x:.4f}" for x in alone * factors), ""]
        together = np.sqrt(np.mean(np.square(tally.turned[camera]), axis=0)) if camera in tally.turned else None
        if together is not None:
            yield ["  alone / fused", *(f"{x:.1f}" for x in alone / together), ""]


def show(title: str, tally: Tally, console: Console) -> None:
    """Print one row's figures."""
    table = Table(title=title, box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "x mm", "y mm", "z mm", "x deg", "y deg", "z deg", "NEES"):
        table.add_column(heading, justify="right" if heading else "left")
    for row in rows(tally):
        table.add_row(*row)
    console.print(table)
    jumps = np.abs(tally.jumps)
    console.print(
        f"{len(tally.nees)} poses, {tally.lost} missing, {tally.wrong} wrong, {tally.ambiguous} ambiguous; jumps from "
        f"frame to frame beyond 3 sigma: {100 * np.mean(jumps > 3):.2f} % (chance: 0.27 %), largest {jumps.max():.1f}\n"
    )


def main(names: Sequence[str], seeds: int, console: Console) -> None:
    """Measure and print."""
    for name in names:
        if name == "moved":
            tally, alone, longest, rested = misplaced(seeds)
            show("moved: all three", tally, console)
            show("moved: without the third", alone, console)
            console.print(f"named within {longest:.2f} s in all {seeds} films; {rested} poses rested on it\n")
            continue
        made = {
            "pair": lambda: pair(seeds),
            "late": lambda: pair(seeds, PERIOD_NS // 2),
            "plate": lambda: off_leds(seeds, 5e-5),
            "ruler": lambda: off_leds(seeds, 4e-4),
            "row": lambda: along(seeds),
        }[name]
        show(name, made(), console)


if __name__ == "__main__":
    NAMES = ("pair", "late", "moved", "plate", "ruler", "row")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", default=NAMES, choices=NAMES)
    parser.add_argument("--seeds", type=int, default=20)
    told = parser.parse_args()
    main(told.rows, told.seeds, Console(width=110))
