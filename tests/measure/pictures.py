"""Are covariances meant where the picture is worse than the camera's? `python -m tests.measure.pictures [FRAMES]`.

Robots drawn by tests/centres/rendering.py, located alone. JPEG: the same frames compressed at several qualities, beside
themselves uncompressed. Streaks: robots that move and turn while the shutter is open, so that an LED's image is drawn
out by so many times its width; truth is the pose at mid-exposure. NEES is the squared error weighted by the covariance,
6 where covariances are meant (flips aside); "either": TILT_AMBIGUOUS; "times": RMS error of x and y over that of the
uncompressed, unmoved frame. "lost" and "wrong" (20 mm off) are robots.
"""

import sys
from collections.abc import Iterator, Mapping

import cv2
import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server import PoseEstimate
from tests.chain.frames import alone, draw, poses_apart
from tests.chain.judging import Judged
from tests.rigs import make_rig

QUALITIES = (95, 85, 60)
WIDTHS = (0.25, 0.5, 1.0, 2.0)  # of a spot, that its streak is longer than it
ROBOTS = 5
STEPS = 9  # an exposure is drawn as so many


def compressed(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """The image through JPEG."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def moved(pose: Pose, motion: Floats, share: float) -> Pose:
    """The pose a share of its ``motion`` (6,), m and rad in the parent's axes, later."""
    return Pose.from_matrix(exp_rotation(share * motion[3:]) @ pose.rotation, pose.position + share * motion[:3])


def smeared(rig: Rig, poses: Mapping[str, Pose], widths: float, rng: np.random.Generator) -> Floats:
    """Expected light (h, w) of robots that move by so many widths of their LEDs' spots during the exposure."""
    motions = {}
    for name in poses:
        along = rng.normal(size=6) * np.array([1.0, 1.0, 0.3, 0.0, 0.0, 0.0])
        motions[name] = along / np.linalg.norm(along[:2]) * widths * 2 * (rig.robot(name).led_radius or 0.0)
        motions[name][3:] = rng.normal(size=3) * np.linalg.norm(motions[name][:3]) / 0.1
    shares = (np.arange(STEPS) + 0.5) / STEPS - 0.5
    lights = [draw(rig, {name: moved(poses[name], motions[name], s) for name in poses}).light for s in shares]
    return np.mean(lights, axis=0)


def judged(rig: Rig, image: NDArray[np.uint8], poses: Mapping[str, Pose]) -> Iterator[Judged]:
    """Every robot of a frame, located alone."""
    for name, answer in alone(image, rig).answers.items():
        yield Judged(name, 6, answer if isinstance(answer, PoseEstimate) else None, poses[name])


def cells(kind: str, robots: list[Judged], least: float | None) -> tuple[list[str], float]:
    """A row of the table, and its RMS error of x and y, m."""
    found = [robot for robot in robots if robot.answer is not None]
    right = [robot for robot in found if not robot.wrong]
    rms = float(np.sqrt(np.mean([np.sum(robot.error[:2] ** 2) for robot in right])))
    nees = [robot.nees for robot in right if not robot.tilted]
    either = sum(robot.answer is not None and robot.answer.alternative is not None for robot in found)
    row = [
        kind,
        str(len(robots) - len(found)),
        str(len(found) - len(right)),
        f"{100 * either / len(found):.0f} %",
        f"{np.mean(nees):.2f} ±{np.std(nees) / np.sqrt(len(nees)):.2f}",
        f"{np.median(nees):.2f}",
        f"{rms / (least or rms):.2f}",
    ]
    return row, rms


def main(frames: int, console: Console) -> None:
    """Measure and print."""
    table = Table(title="each frame alone", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("picture", "lost", "wrong", "either", "NEES", "median", "times"):
        table.add_column(heading, justify="left" if heading == "picture" else "right")
    kinds: dict[str, list[Judged]] = {}
    for frame in track(range(frames), description="locating", transient=True, disable=not console.is_terminal):
        rng = np.random.default_rng([11, frame])
        rig = make_rig(ROBOTS, seed=frame % 4)
        poses = poses_apart(rig, rng, depth_m=(1.0, 1.6), tilt_deg=(0.0, 45.0))
        still = draw(rig, poses)
        image = still.expose(rng)
        kinds.setdefault("as it is", []).extend(judged(rig, image, poses))
        for quality in QUALITIES:
            kinds.setdefault(f"JPEG {quality}", []).extend(judged(rig, compressed(image, quality), poses))
        for widths in WIDTHS:
            still.light = smeared(rig, poses, widths, rng)
            kinds.setdefault(f"streak {widths:g} widths", []).extend(judged(rig, still.expose(rng), poses))
    least = None
    for kind, robots in kinds.items():
        row, rms = cells(kind, robots, least)
        least = least or rms
        table.add_row(*row)
    console.print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12, Console(width=100))
