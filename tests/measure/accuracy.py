"""Accuracy and identity on frames with truth: `python -m tests.measure.accuracy [FOLDER ...]`.

FOLDER holds `rig.yaml`, `frames/` and their truth, as `asterism simulate` writes them. Without one the frames are
simulated first, seeded: the demonstration's five robots as they drive, with every tenth LED hidden, among 30 glints,
with both, and one robot shown by hand, tilted to all sides. Every frame is located alone, as `asterism locate
--independent` does. "wrong": more than 20 mm off, or a robot that is not there. "tilt": more than 5 degrees off, with
neither `alternative` nor the covariance saying so. "either": the share of poses on six LEDs that are TILT_AMBIGUOUS.
NEES is the squared error weighted by the covariance; honest covariances average 6.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.server.__main__ import main as asterism
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.chain.judging import judge
from tests.helpers import SHARED

# A robot counts from that many visible LEDs on; elsewhere from six.
LEAST = {"clutter": 5, "occluded": 5, "ghosts": 5, "hidden": 5, "hidden, glints": 5}
FRAMES = 60
SIMULATED = {
    "plain": (),
    "hidden": ("--hide", "0.1"),
    "glints": ("--glints", "30"),
    "hidden, glints": ("--hide", "0.1", "--glints", "30"),
    "by hand": ("--hand", "alpha"),
}


def row(folder: Path) -> list[str]:
    """One folder's figures, as the table shows them."""
    robots = list(judge(folder))
    least = LEAST.get(folder.name, 6)
    counted = [robot for robot in robots if robot.visible >= least]
    found = sum(robot.answer is not None for robot in counted)
    cells = [
        folder.name,
        str(least),
        f"{found}/{len(counted)}",
        str(sum(robot.wrong for robot in robots)),
        str(sum(robot.silent_tilt for robot in robots)),
    ]
    right = [robot for robot in robots if robot.answer is not None and robot.true is not None and not robot.wrong]
    if not right:
        return cells
    errors = np.abs([robot.error for robot in right])
    nees = [robot.nees for robot in right if not robot.tilted]
    whole = [robot.answer for robot in right if robot.answer is not None and len(robot.answer.leds) == 6]
    either = sum(answer.alternative is not None for answer in whole)
    return [
        *cells,
        f"{100 * either / max(len(whole), 1):.0f} %",
        f"{1e3 * np.median(errors[:, :2]):.4f}",
        f"{1e3 * np.median(errors[:, 2]):.3f}",
        f"{np.degrees(np.median(np.linalg.norm(errors[:, 3:], axis=1))):.3f}",
        f"{np.mean(nees):.1f}",
        f"{np.median(nees):.1f}",
    ]


def samples() -> list[Path]:
    """The folders of sample frames, none where they are not."""
    return sorted(path.parent for path in (SHARED / "samples").glob("*/truth.json"))


def simulate(out: Path) -> list[Path]:
    """Folders of simulated frames in ``out``, one of every kind."""
    folders = [out / kind for kind in SIMULATED]
    for seed, folder in enumerate(folders):
        arguments = ("simulate", DEMO_RIG, folder, "--frames", FRAMES, "--seed", seed, *SIMULATED[folder.name])
        if asterism([str(argument) for argument in arguments]):
            sys.exit(f"{folder.name}: asterism simulate failed")
    return folders


def main(folders: list[Path], console: Console) -> None:
    """Measure and print; no folders: on frames simulated for it."""
    if not folders:
        with tempfile.TemporaryDirectory() as name:
            main(simulate(Path(name)), console)
        return
    table = Table(title="each frame alone; errors are medians", box=box.SIMPLE_HEAD, pad_edge=False)
    headings = ("frames", "LEDs", "found", "wrong", "tilt", "either", "x,y mm", "z mm", "deg", "NEES", "median")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "frames" else "right")
    for folder in track(folders, description="locating", transient=True, disable=not console.is_terminal):
        table.add_row(*row(folder))
    console.print(table)


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]], Console(width=100))
