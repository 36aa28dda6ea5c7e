"""Accuracy and identity on frames with truth: `python -m tests.measure.accuracy [FOLDER ...]`.

FOLDER holds `rig.yaml`, `frames/` and their truth (../shared/samples has eleven; `asterism simulate` writes more).
Every frame is located alone, as `asterism locate --independent` does. "wrong": more than 20 mm off, or a robot that
is not there. "tilt": more than 5 degrees off, with neither `alternative` nor the covariance saying so. NEES is the
squared error weighted by the covariance; honest covariances average 6.
"""

import sys
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from tests.chain.judging import judge
from tests.helpers import SHARED

LEAST = {"clutter": 5, "occluded": 5, "ghosts": 5}  # a robot counts from that many visible LEDs on; elsewhere from six


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
    return [
        *cells,
        f"{1e3 * np.median(errors[:, :2]):.4f}",
        f"{1e3 * np.median(errors[:, 2]):.3f}",
        f"{np.degrees(np.median(np.linalg.norm(errors[:, 3:], axis=1))):.3f}",
        f"{np.mean(nees):.1f}",
        f"{np.median(nees):.1f}",
    ]


def samples() -> list[Path]:
    """The folders of sample frames, none where they are not."""
    return sorted(path.parent for path in (SHARED / "samples").glob("*/truth.json"))


def main(folders: list[Path], console: Console) -> None:
    """Measure and print."""
    table = Table(title="each frame alone; errors are medians", box=box.SIMPLE_HEAD, pad_edge=False)
    headings = ("frames", "LEDs", "found", "wrong", "tilt", "x,y mm", "z mm", "deg", "NEES", "median")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "frames" else "right")
    for folder in track(folders, description="locating", transient=True, disable=not console.is_terminal):
        table.add_row(*row(folder))
    console.print(table)


if __name__ == "__main__":
    given = [Path(argument) for argument in sys.argv[1:]] or samples()
    if not given:
        sys.exit(f"{SHARED / 'samples'} is not there; name folders with rig.yaml, frames/ and their truth")
    main(given, Console(width=100))
