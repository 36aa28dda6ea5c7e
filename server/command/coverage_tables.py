"""Where tools were, as tables of 80 columns."""

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.server.coverage.added import Added
from asterism.server.coverage.visits import CoverageMap, Visits

WIDTH, WIDEST = 80, 14
_COLUMNS = ("robot", "area\ncm2", "of the\nsurface", "dwell\nmean s", "\nmedian", "\nleast", "\nmost", "passes\nmean",
            "speed\nmm/s")  # fmt: skip


def print_coverage(found: CoverageMap, added: Sequence[Added]) -> None:
    """The surface, what every robot did on it, what was left out and why, and what each recording added."""
    console = Console(width=WIDTH, highlight=False)
    grid = found.grid
    size = f"{grid.area_m2 * 1e4:.1f} cm2" if grid.ends else "without an edge, so no share of it is told"
    console.print(f"surface: {size}; patches of {grid.pitch_m * 1e3:.2f} mm", markup=False)
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0))
    for name in _COLUMNS:
        table.add_column(name, justify="left" if name == "robot" else "right", no_wrap=True)
    for robot, visits in found.robots.items():
        table.add_row(robot if len(robot) <= WIDEST else f"{robot[: WIDEST - 1]}…", *_cells(found, visits))
    table.add_row("together", *_cells(found, found.together))
    console.print(table)
    for robot, visits in found.robots.items():
        told = ", ".join(f"{count} {_named(reason, count)}" for reason, count in visits.left_out.items())
        console.print(f"{robot}: {visits.counted} poses over {visits.counted_s:.1f} s{_left(told)}", markup=False)
    if len(added) > 1:
        for each in added:
            console.print(
                f"{each.name}: {each.over_m2 * 1e4:.1f} cm2, {each.new_m2 * 1e4:.1f} of them new", markup=False
            )


def _left(told: str) -> str:
    return f"; left out: {told}" if told else ""


def _named(reason: str, count: int) -> str:
    return "gaps in time" if reason == "gap" and count != 1 else "gap in time" if reason == "gap" else reason


def _cells(found: CoverageMap, visits: Visits) -> list[str]:
    there = visits.visited
    if not there.any():
        return ["0", *("" for _ in _COLUMNS[2:])]
    areas, dwell = found.grid.areas[there], visits.dwell_s[there]
    order = np.argsort(dwell)
    half = np.searchsorted(np.cumsum(areas[order]), 0.5 * areas.sum())
    share = f"{areas.sum() / found.grid.area_m2:.1%}" if found.grid.ends else ""
    mean, passes = (float(np.average(each, weights=areas)) for each in (dwell, visits.passes[there]))
    speed = float(visits.path_m.sum() / visits.dwell_s.sum())
    figures = (mean, float(dwell[order[half]]), float(dwell.min()), float(dwell.max()))
    return [f"{areas.sum() * 1e4:.1f}", share, *(f"{each:.3g}" for each in figures), f"{passes:.1f}",
            f"{speed * 1e3:.1f}"]  # fmt: skip
