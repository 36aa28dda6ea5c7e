"""asterism compare: differences of two recordings, or of two batches."""

import argparse
import math
from pathlib import Path

from rich.console import Console
from rich.table import Table

from asterism.protocol.errors import InputError
from asterism.protocol.two_digits import two_digits
from asterism.recordings.compare import compare, percentile
from asterism.recordings.reader import Recording
from asterism.server.command.batch_tables import print_changes
from asterism.server.command.number_arguments import not_negative
from asterism.server.service.batch.comparing import compared
from asterism.server.service.batch.folder import is_batch, read_result

EXAMPLES = (
    "asterism compare RECORDING_A RECORDING_B\n"
    "asterism compare A B --position 0.0001 --rotation 0.001\n"
    "asterism compare BATCH_A BATCH_B\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("a", metavar="A", type=Path, help="a recording's folder, or a batch's")
    part.add_argument("b", metavar="B", type=Path, help="another")
    part.add_argument("--position", metavar="M", type=not_negative, default=1e-6, help="allowed, m (default: 1e-6)")
    part.add_argument("--rotation", metavar="RAD", type=not_negative, default=1e-6, help="allowed, rad (default: 1e-6)")


def run(options: argparse.Namespace) -> int:
    """Print the differences; exit code 1 if they exceed the tolerances."""
    if is_batch(options.a) or is_batch(options.b):
        return _compare_batches(options)
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


def _compare_batches(options: argparse.Namespace) -> int:
    for path in (options.a, options.b):
        if not is_batch(path):
            raise InputError(f"{path}: is no batch, the other is; expected two batches, or two recordings")
    tolerances = options.position, options.rotation
    changed, apart = compared(options.a, read_result(options.b), options.b, tolerances)
    for text in apart:
        print(text)
    same = print_changes(changed, f"from {options.a} to {options.b}", tolerances)
    return 0 if same and not apart else 1


def _cell(value: float) -> str:
    """A difference; one that is nothing in mm, degrees and px takes no room."""
    return "<1e-6" if 0.0 < value < 1e-6 else two_digits(value)
