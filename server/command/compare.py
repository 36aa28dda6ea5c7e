"""asterism compare: differences of two recordings."""

import argparse
import math
from pathlib import Path

from rich.console import Console
from rich.table import Table

from asterism.recordings.compare import compare, percentile
from asterism.recordings.reader import Recording
from asterism.server.command.number_arguments import not_negative

EXAMPLES = "asterism compare RECORDING_A RECORDING_B\nasterism compare A B --position 0.0001 --rotation 0.001\n"


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("a", metavar="A", type=Path, help="a recording's folder")
    part.add_argument("b", metavar="B", type=Path, help="another")
    part.add_argument("--position", metavar="M", type=not_negative, default=1e-6, help="allowed, m (default: 1e-6)")
    part.add_argument("--rotation", metavar="RAD", type=not_negative, default=1e-6, help="allowed, rad (default: 1e-6)")


def run(options: argparse.Namespace) -> int:
    """Print the differences; exit code 1 if they exceed the tolerances."""
    found = compare(Recording(options.a), Recording(options.b))
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0))
    columns = (
        "robot", "frames", "only\nin A", "only\nin B", "other\nstate", "other\nLEDs", "position\nmm", "\nmax",
        "rotation\ndeg", "\nmax", "rms\npx", "\nmax",
    )  # fmt: skip
    for name in columns:
        table.add_column(name, justify="left" if name == "robot" else "right", no_wrap=True)
    for robot in found.robots.values():
        cells = [
            robot.robot,
            *(
                str(count)
                for count in (
                    robot.frames,
                    robot.located_only_a,
                    robot.located_only_b,
                    robot.other_state,
                    robot.other_leds,
                )
            ),
        ]
        for values, scale in (
            (robot.position_m, 1e3),
            (robot.rotation_rad, math.degrees(1.0)),
            (robot.rms_px, 1.0),
        ):
            cells += [_cell(scale * percentile(values, share)) for share in (50, 100)]
        table.add_row(*cells)
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    console.print(
        f"{found.frames_both} frames in both, {found.frames_only_a} only in A, {found.frames_only_b} only in B"
    )
    console.print(table)
    same = found.within(options.position, options.rotation)
    console.print(
        f"{'within' if same else 'beyond'} the tolerances ({options.position:g} m, {options.rotation:g} rad)",
        highlight=False,
    )
    return 0 if same else 1


def _cell(value: float) -> str:
    """A difference; one that is nothing in mm, degrees and px takes no room."""
    return "<1e-6" if 0.0 < value < 1e-6 else f"{value:.2g}"
