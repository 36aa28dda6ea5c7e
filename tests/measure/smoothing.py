"""What `--smooth` gains and whether its covariance is meant: `python -m tests.measure.smoothing [FRAMES]`.

Films of the demonstration's five robots, rendered and located, at several speeds (1: as `asterism demo` drives them, at
most 0.12 m/s), and the sample film if it is there. Printed per film: RMSE smoothed over RMSE of the frames alone, for
every component; NEES of both (6 where covariances are meant).
"""

import sys
from collections.abc import Iterator

import cv2
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.rig import Rig, load_rig
from asterism.server import Frame, FrameResult, PoseEstimate, Tracks, localize
from asterism.server.chain.smooth import Motions, smooth
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look, Scene
from tests.chain.judging import truth_of
from tests.helpers import SHARED

STEP_NS = 16_666_667
SPEEDS = (0.0, 0.03, 0.1, 0.3, 1.0)

Film = Iterator[tuple[Frame, dict[str, Pose]]]


def rendered(rig: Rig, speed: float, frames: int) -> Film:
    """Simulated frames with T_parent_robot of every robot."""
    scene = Scene(rig, 7, Look())
    T_parent_camera = rig.T_world_camera or Pose.identity()
    for k in range(frames):
        truth = scene.truth(k, speed * k / 60)
        yield (
            Frame(scene.render(k, truth), 1 + k * STEP_NS, k),
            {entry.robot: T_parent_camera @ entry.T_camera_robot for entry in truth},
        )


def sample() -> Film:
    """The sample film."""
    folder = SHARED / "samples" / "film"
    for k, entry in enumerate(truth_of(folder)):
        image = cv2.imread(str(folder / "frames" / entry["frame"]), cv2.IMREAD_GRAYSCALE)
        robots = {r["id"]: Pose(np.array(r["position"]), np.array(r["orientation"])) for r in entry["robots"]}
        yield Frame(np.asarray(image, np.uint8), 1 + k * STEP_NS, k), robots


def errors(result: FrameResult, truth: dict[str, Pose]) -> tuple[list[Floats], list[float]]:
    """(6,) m and rad of every located robot, and their NEES."""
    off, nees = [], []
    for robot, answer in result.answers.items():
        if isinstance(answer, PoseEstimate):
            true = truth[robot]
            turned = log_rotation(answer.pose.rotation @ true.rotation.T)
            off.append(np.concatenate([answer.position - true.position, turned]))
            nees.append(float(off[-1] @ np.linalg.solve(answer.covariance, off[-1])))
    return off, nees


def row(name: str, rig: Rig, film: Film) -> list[str]:
    """One film's figures."""
    tracks, motions = Tracks.none(), Motions.none()
    told: tuple[list[Floats], list[Floats]] = ([], [])
    nees: tuple[list[float], list[float]] = ([], [])
    for frame, truth in film:
        result, tracks = localize(frame, rig, tracks)
        smoothed, motions = smooth(result, motions)
        for place, answers in enumerate((result, smoothed)):
            off, weighted = errors(answers, truth)
            told[place].extend(off)
            nees[place].extend(weighted)
    alone, joined = (np.sqrt(np.mean(np.square(part), axis=0)) for part in told)
    return [name, *(f"{ratio:.2f}" for ratio in joined / alone), *(f"{np.mean(part):.1f}" for part in nees)]


def main(frames: int) -> None:
    """Measure and print."""
    table = Table(title="RMSE smoothed over RMSE of frames alone", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("film", "x", "y", "z", "rx", "ry", "rz", "NEES alone", "smoothed"):
        table.add_column(heading, justify="left" if heading == "film" else "right")
    rig = load_rig(DEMO_RIG)
    for speed in SPEEDS:
        table.add_row(*row(f"demo, speed {speed:g}", rig, rendered(rig, speed, frames)))
    folder = SHARED / "samples" / "film"
    if folder.exists():
        table.add_row(*row("sample film", load_rig(folder / "rig.yaml"), sample()))
    Console(width=100).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 180)
