"""Plots of lines that are named where they end, for the pages in docs/: SVG, or what else a file's name asks for."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from asterism.server.budget.plots import COLOURS, MARKS

ORDER = (0, 3, 5, 4, 6, 2)  # of the colours: neighbours differ most
LEAST_APART = 0.062  # of the axis: the height of a name
STYLE: dict[Any, Any] = {
    "font.size": 11,
    "svg.fonttype": "none",  # words stay words
    "svg.hashsalt": "asterism",  # the same lines, the same file
    "axes.spines.top": False,
    "axes.spines.right": False,
}


class Axis(NamedTuple):
    """What an axis says, where it has ticks, and its ends."""

    label: str
    ticks: Sequence[float]
    ends: tuple[float, float]
    log: bool = False


def apart(places: Sequence[float], least: float) -> list[float]:
    """The places, moved no farther than they must to be ``least`` apart, in their order.

    That is the isotonic regression of what they are beyond their least distances: runs that would go down are joined.
    """
    order = np.argsort(places, kind="stable")
    runs: list[list[float]] = []  # mean, how many
    for k, place in enumerate(np.asarray(places)[order]):
        runs.append([float(place) - k * least, 1.0])
        while len(runs) > 1 and runs[-2][0] > runs[-1][0]:
            (before, n), (last, m) = runs[-2:]
            runs[-2:] = [[(n * before + m * last) / (n + m), n + m]]
    settled = [mean for mean, n in runs for _ in range(int(n))]
    moved = [0.0] * len(settled)
    for k, row in enumerate(order):
        moved[row] = settled[k] + k * least
    return moved


def _ruled(panel: Axes, across: Axis, up: Axis) -> None:
    """Scales, ticks and words of both axes."""
    panel.set(xlabel=across.label, ylabel=up.label, xscale="log" if across.log else "linear")
    panel.set(xlim=across.ends, ylim=up.ends)
    panel.minorticks_off()
    panel.set_xticks(across.ticks, [f"{tick:g}" for tick in across.ticks])
    panel.set_yticks(up.ticks, [f"{tick:g}" for tick in up.ticks])
    panel.grid(visible=True, alpha=0.3)


def draw_lines(
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    across: Axis,
    up: Axis,
    out: Path,
    meant: tuple[float, float] | None = None,
) -> None:
    """Write the ``lines``, each (x, y) by its name, which stands at its right end; ``meant``: a band of y in grey."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.8), layout="constrained")
        panel = figure.subplots()
        _ruled(panel, across, up)
        if meant is not None:
            panel.axhspan(*meant, color="0.9", linewidth=0)
        height = up.ends[1] - up.ends[0]
        beside = apart([y[-1] for _, y in lines.values()], LEAST_APART * height)
        for (name, (x, y)), place, k in zip(lines.items(), beside, ORDER, strict=False):
            panel.plot(x, y, color=COLOURS[k], marker=MARKS[k], markersize=5, clip_on=False, zorder=3)
            panel.annotate(name, (1.02, place), xycoords=panel.get_yaxis_transform(), color=COLOURS[k], va="center")
        figure.savefig(out, dpi=110, metadata={"Date": None} if out.suffix == ".svg" else None)
