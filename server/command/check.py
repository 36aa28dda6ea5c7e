"""asterism check: how well a rig's robots can be told apart, and what can go wrong."""

import argparse
import math
from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from asterism.protocol.rig import load_rig
from asterism.protocol.surface_sight import sight_of, sight_sentence, surface_warnings
from asterism.server.chain.kernel_list import CHECK
from asterism.server.chain.warm_up import warm_up
from asterism.server.command.progress import working
from asterism.server.design.pose_bounds import Bound
from asterism.server.design.rig_check import KINDS, SIGMA_PX, TYPICAL_DEG, RigCheck, check_rig
from asterism.server.design.telling_apart import SIGMAS

EXAMPLES = "asterism check rig.yaml\n"

MOST_ROWS = 12  # robots that are listed


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("rig", metavar="RIG", help="rig.yaml")


def run(options: argparse.Namespace) -> int:
    """Print separations, pose conditioning, flip risk and a verdict."""
    rig = load_rig(options.rig)
    warm_up(CHECK)
    with working("checking") as now:
        found = check_rig(rig, now)
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    near, _, far = found.distances
    where = "" if rig.range_m else " (no range in the rig: from filling the image to LEDs that merge)"
    console.print(
        f"{escape(options.rig)}: {len(rig.robots)} robot{'s' * (len(rig.robots) > 1)}, camera "
        f"{escape(rig.camera.name)} (f = {rig.camera.focal_px:g} px), {near:.4g} to {far:.4g} m{where}, tilted by up "
        f"to {found.tilt_deg:.3g}° from its axis",
        highlight=False,
        soft_wrap=True,
    )
    for title, table in (
        (f"Weakest separations at {far:.4g} m; {SIGMAS:g} sigma of the centres are needed", _separations(found)),
        (_robots_title(found), _robots(found)),
        (
            f"Poses from one frame, all LEDs visible, centres {SIGMA_PX:g} px off (sigmas scale with it): median robot "
            "/ worst",
            _poses(found),
        ),
    ):
        console.print(f"\n[bold]{title}[/bold]", highlight=False)
        console.print(table)
    console.print()
    sight = sight_of(rig)
    surface = [f"surface: {text}" for text in ([sight_sentence(sight)] if sight else []) + surface_warnings(rig)]
    for sentence in (*found.verdict(), *surface):
        console.print(f"[bold]verdict[/bold] {escape(sentence)}", highlight=False, soft_wrap=True)
    return 0


def _table(columns: Sequence[str], left: Sequence[str] = (), wrapped: Sequence[str] = ()) -> Table:
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0))
    for name in columns:
        table.add_column(name, justify="left" if name in left else "right", no_wrap=name not in wrapped)
    return table


def _separations(found: RigCheck) -> Table:
    seen, taken = "seen", "taken for"
    table = _table(
        ("of", "LEDs", "mm", "px", f"at {found.tilt_deg:.3g}°", "good for sigma", seen, taken),
        ("of", "LEDs", seen, taken),
        (seen, taken),
    )
    ids = [escape(robot.id) for robot in found.rig.robots]
    for entry in found.weakest:
        confusion = entry.confusion
        tilted = found.px(confusion.separation, found.tilt_deg)
        image = "'s image" if entry.kind == KINDS[2] else ""
        table.add_row(
            entry.kind,
            "one hidden" if entry.hidden else "all visible",
            f"{confusion.separation * 1e3:.2f}",
            f"{found.px(confusion.separation, 0.0):.2f}",
            f"{tilted:.2f}",
            f"{tilted / SIGMAS:.2g} px",
            f"{ids[confusion.seen]}{image} {' '.join(map(str, confusion.seen_leds))}",
            f"{ids[confusion.taken]} {' '.join(map(str, confusion.taken_leds))}",
        )
    return table


def _robots_title(found: RigCheck) -> str:
    some = f", the {MOST_ROWS} weakest of {len(found.robots)}" if len(found.robots) > MOST_ROWS else ""
    return (
        f"Robots{some}: separations, mm; standard deviations at {found.distances[-1]:.4g} m and {TYPICAL_DEG:g}°; "
        "all LEDs visible / one hidden"
    )


def _robots(found: RigCheck) -> Table:
    shown = list(found.robots)
    if len(shown) > MOST_ROWS:
        shown = sorted(shown, key=lambda entry: min(entry.other[1], entry.itself[1]))[:MOST_ROWS]
    table = _table(("robot", "rms radius", "from others", "from itself", "z mm", "tilt °"), ("robot",))
    for entry in shown:
        table.add_row(
            escape(entry.robot.id),
            f"{entry.rms_radius * 1e3:.1f}",
            *(
                " / ".join(f"{by[hidden] * 1e3:.2f}" if math.isfinite(by[hidden]) else "-" for hidden in (0, 1))
                for by in (entry.other, entry.itself)
            ),
            f"{entry.bound.depth_m * 1e3:.2f} / {entry.bound_hidden.depth_m * 1e3:.2f}",
            f"{math.degrees(entry.bound.tilt_rad):.2f} / {math.degrees(entry.bound_hidden.tilt_rad):.2f}",
        )
    return table


def _poses(found: RigCheck) -> Table:
    table = _table(("m", "tilt", "x, y mm", "z mm", "tilt °", "spin °", "wrong tilt %"))
    before = None
    for (distance, tilt), bounds in found.bounds.items():
        table.add_row(
            "" if distance == before else f"{distance:.4g}",
            f"{tilt:g}°",
            _both(bounds, lambda bound: bound.across_m * 1e3, 3),
            _both(bounds, lambda bound: bound.depth_m * 1e3, 2),
            _both(bounds, lambda bound: math.degrees(bound.tilt_rad), 2),
            _both(bounds, lambda bound: math.degrees(bound.spin_rad), 3),
            "-" if tilt == 0 else _both(bounds, lambda bound: 100.0 * bound.flip, 2),
        )
        before = distance
    return table


def _both(bounds: Sequence[Bound], value: Callable[[Bound], float], decimals: int) -> str:
    values = [value(bound) for bound in bounds]
    return f"{np.median(values):.{decimals}f} / {max(values):.{decimals}f}"
