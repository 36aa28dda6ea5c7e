"""Pictures of a map, as PNG, seen along the z of the surface's frame; read on a light page as on a dark one: they have
no ground of their own.
"""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps, dates
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from asterism.protocol.geometry import Floats
from asterism.server.coverage.grid import Grid
from asterism.server.coverage.regions import OVERWORKED, Regions
from asterism.server.coverage.summary import Summary
from asterism.server.coverage.visits import Visits

GREY = "#7c7c7c"  # letters and lines, as far from white as from a dark page
GAP, MUCH = "#D55E00", "#CC2F7B"
DPI, WIDTH = 100, 10.0  # inches
MOST_PANELS_IN_A_ROW = 3
ARROWS = 28  # along the longer side
STRAIGHT = 0.3  # of a way that goes to and fro less is one direction: no arrow
_CLOCK_NS = 10**17
_NOBODY = ListedColormap([(0.5, 0.5, 0.5, 0.28)])


@dataclass(frozen=True, slots=True)
class Picture:
    """The file's name, what it shows, and the bytes of the PNG."""

    name: str
    caption: str
    png: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """What is drawn of visits: ``values`` of them, (rows, columns), ``label`` with its unit. The colours go from
    ``least`` to ``most``; ``beyond``: there is one for what is more. ``whole`` numbers, or ``times``.
    """

    label: str
    values: Callable[[Visits], Floats]
    least: float
    most: float
    beyond: bool = False
    whole: bool = False
    times: bool = False


def pictures_of(told: Summary) -> list[Picture]:
    """All pictures: of all robots together, and of each."""
    quantities = _quantities(told)
    plan = "Seen along the z of the surface's frame. Grey: on the surface, never under a tool."
    captions = {
        "dwell": f"Dwell: for how long a tool was over each patch. {plan} Outlined and numbered as in the lists: gaps "
        f"(orange, dashed) and overworked patches (pink), with more than {OVERWORKED:g} times the median dwell.",
        "passes": f"Passes: how often a tool came over each patch. {plan}",
        "speed": f"Mean speed of the tool over each patch, and the direction it went: the longer an arrow, the more "
        f"it always was the same way; none where it went to and fro. {plan}",
        "last": f"Last visit: when a tool was over each patch last. {plan}",
    }
    pictures = []
    for name, quantity in quantities.items():
        pictures.append(Picture(f"{name}.png", captions[name], _together(told, name, quantity)))
    for name, quantity in quantities.items():
        caption = f"{captions[name].partition(':')[0].partition(' of')[0]} by each robot, in the same colours."
        pictures.append(Picture(f"{name}-by-robot.png", caption, _by_robot(told, name, quantity)))
    return pictures


def _quantities(told: Summary) -> Mapping[str, Quantity]:
    whole = told.whole
    seen = whole.visited
    dwell, passes = float(whole.dwell_s.max(initial=0.0)), float(whole.passes.max(initial=0))
    limit = told.overworked.limit_s
    speeds = whole.speed[seen]
    fast = float(np.percentile(speeds, 99)) if len(speeds) else 0.0
    times = np.array(_times(whole)[seen])
    least, most = (float(times.min()), float(times.max())) if len(times) else (0.0, 1.0)
    film = 0 < told.covered.until_ns < _CLOCK_NS
    much = 0.0 < limit < dwell
    return {
        "dwell": Quantity("dwell, s", lambda each: each.dwell_s, 0.0, (limit if much else dwell) or 1.0, much),
        "passes": Quantity("passes", lambda each: each.passes.astype(np.float64), 0.0, max(passes, 1.0), whole=True),
        "speed": Quantity("speed, m/s", lambda each: each.speed, 0.0, fast or 1.0, bool((speeds > 1.01 * fast).any())),
        "last": Quantity(
            "last visit, s" if film else "last visit, UTC", _times, least, max(most, least + 1e-5), times=not film
        ),
    }


def _times(visits: Visits) -> Floats:
    """Of the last visit, as matplotlib counts: days since the Unix epoch; of a film s."""
    film = int(visits.last_ns.max(initial=0)) < _CLOCK_NS
    return visits.last_ns.astype(np.float64) * (1e-9 if film else 1e-9 / 86_400.0)


def _together(told: Summary, name: str, quantity: Quantity) -> bytes:
    width, height = _size(told.covered.grid)
    figure = Figure(figsize=(WIDTH, min(max(0.86 * WIDTH * height / width, 3.0), 1.1 * WIDTH)), layout="constrained")
    axes = figure.subplots()
    _panel(axes, told, told.whole, name, quantity)
    if name == "dwell":
        _outline(axes, told.covered.grid, told.gaps, GAP, "--")
        _outline(axes, told.covered.grid, told.overworked, MUCH, "-")
    _bar(figure, [axes], quantity)
    return _png(figure)


def _by_robot(told: Summary, name: str, quantity: Quantity) -> bytes:
    robots = told.covered.robots
    columns = min(len(robots), MOST_PANELS_IN_A_ROW)
    rows = -(-len(robots) // columns)
    width, height = _size(told.covered.grid)
    panel = min(max(WIDTH / columns * height / width, 1.8), WIDTH)
    figure = Figure(figsize=(WIDTH, rows * (panel + 0.4)), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes in grid.ravel()[len(robots) :]:
        axes.set_visible(False)
    for axes, (robot, visits) in zip(grid.ravel(), robots.items(), strict=False):
        _panel(axes, told, visits, name, quantity)
        axes.set_title(robot, color=GREY, fontsize=10)
        axes.label_outer()
    _bar(figure, [axes for axes in grid.ravel() if axes.get_visible()], quantity)
    return _png(figure)


def _size(grid: Grid) -> tuple[float, float]:
    """Width and height, m, of what is drawn."""
    x0, x1, y0, y1 = _sides(grid)
    return x1 - x0, y1 - y0


def _sides(grid: Grid) -> tuple[float, float, float, float]:
    """Left, right, lower and upper end, m, of the patches."""
    box = grid.box
    columns, rows = max(box.shape[1], 1), max(box.shape[0], 1)  # an empty map is shown as a patch
    ends = box.column, box.column + columns, box.row, box.row + rows
    x0, x1, y0, y1 = (grid.pitch_m * end for end in ends)
    return x0, x1, y0, y1


def _panel(axes: Axes, told: Summary, visits: Visits, name: str, quantity: Quantity) -> None:
    grid = told.covered.grid
    sides = _sides(grid)
    axes.set_facecolor("none")
    if not grid.box.patches:
        axes.set(xlim=sides[:2], ylim=sides[2:])
    nobody = np.ma.masked_where(~grid.inside, np.zeros(grid.box.shape))
    axes.imshow(nobody, cmap=_NOBODY, extent=sides, origin="lower", interpolation="nearest")
    values = np.ma.masked_where(~visits.visited, quantity.values(visits))
    axes.imshow(
        values, cmap=_colours(quantity), vmin=quantity.least, vmax=quantity.most, extent=sides, origin="lower",
        interpolation="nearest",
    )  # fmt: skip
    if name == "speed":
        _arrows(axes, grid, visits)
    axes.set(xlabel="x of the surface, m", ylabel="y of the surface, m")
    axes.xaxis.label.set_color(GREY)
    axes.yaxis.label.set_color(GREY)
    axes.tick_params(colors=GREY)
    axes.locator_params(nbins=6)
    for spine in axes.spines.values():
        spine.set_color(GREY)


def _colours(quantity: Quantity) -> Colormap:
    return colormaps["viridis"].with_extremes(over=MUCH) if quantity.beyond else colormaps["viridis"]


def _arrows(axes: Axes, grid: Grid, visits: Visits) -> None:
    """Where tools went, on the whole, in squares of several patches."""
    step = max(1, -(-max(grid.box.shape) // ARROWS))
    path, shift_x, shift_y = (
        _summed(each, step) for each in (visits.path_m, visits.shift_m[..., 0], visits.shift_m[..., 1])
    )
    with np.errstate(invalid="ignore"):
        x, y = shift_x / path, shift_y / path
    there = _summed(visits.visited.astype(np.float64), step)
    drawn = (np.hypot(x, y) > STRAIGHT) & (there > 0.5 * step**2)
    # Squares at the grid's end may be cut: the middle is that of the patches there are.
    xs = np.array([grid.x_m[k : k + step].mean() for k in range(0, len(grid.x_m), step)])
    ys = np.array([grid.y_m[k : k + step].mean() for k in range(0, len(grid.y_m), step)])
    at_x, at_y = np.meshgrid(xs, ys)
    axes.quiver(
        at_x[drawn], at_y[drawn], x[drawn], y[drawn], angles="xy", scale_units="xy", scale=1.1 / (step * grid.pitch_m),
        pivot="middle", color="white", edgecolor="black", linewidth=0.4, width=0.0035, minlength=0,
    )  # fmt: skip


def _summed(values: Floats, step: int) -> Floats:
    """Sums of squares of ``step`` patches."""
    rows, columns = np.arange(0, values.shape[0], step), np.arange(0, values.shape[1], step)
    summed: Floats = np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
    return summed


def _outline(axes: Axes, grid: Grid, regions: Regions, colour: str, style: str) -> None:
    halo = [withStroke(linewidth=3.2, foreground="white", alpha=0.8)]
    for region in regions.found:
        for (x0, y0), (x1, y1) in _rim(regions.numbers == region.number):
            ends = (
                (grid.box.column + np.array([x0, x1])) * grid.pitch_m,
                (grid.box.row + np.array([y0, y1])) * grid.pitch_m,
            )
            axes.plot(*ends, style, color=colour, linewidth=1.4, scalex=False, scaley=False)
        axes.text(
            float(region.xy[0]), float(region.xy[1]), str(region.number), color=colour, ha="center", va="center",
            fontsize=10, weight="bold", path_effects=halo,
        )  # fmt: skip


def _rim(own: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]") -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """The sides, as straight as they go, between patches that are marked and that are not, in numbers of patches."""
    padded = np.pad(own, 1)
    lines = []
    across = padded[1:, 1:-1] != padded[:-1, 1:-1]  # lower sides of patches: y is their row
    for y, x0, x1 in _runs(across):
        lines.append(((x0, y), (x1, y)))
    along = padded[1:-1, 1:] != padded[1:-1, :-1]
    for x, y0, y1 in _runs(along.T):
        lines.append(((x, y0), (x, y1)))
    return lines


def _runs(marked: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]") -> list[tuple[int, int, int]]:
    """Row, first and behind the last column of every run of marks."""
    steps = np.diff(np.pad(marked, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    begins, ends = np.argwhere(steps == 1), np.argwhere(steps == -1)
    return [(int(row), int(first), int(end)) for (row, first), (_, end) in zip(begins, ends, strict=True)]


def _bar(figure: Figure, panels: list[Axes], quantity: Quantity) -> None:
    bar = figure.colorbar(
        panels[0].images[-1], ax=panels, label=quantity.label, extend="max" if quantity.beyond else "neither",
        shrink=0.9, aspect=30, pad=0.015,
    )  # fmt: skip
    if quantity.times:
        locator = dates.AutoDateLocator(maxticks=7)  # type: ignore[no-untyped-call]
        bar.ax.yaxis.set_major_locator(locator)
        formatter = dates.ConciseDateFormatter(locator)  # type: ignore[no-untyped-call]
        bar.ax.yaxis.set_major_formatter(formatter)
        bar.ax.yaxis.get_offset_text().set_color(GREY)
    if quantity.whole:
        bar.ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    bar.ax.tick_params(colors=GREY)
    bar.ax.yaxis.label.set_color(GREY)
    for spine in bar.ax.spines.values():
        spine.set_color(GREY)


def _png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI, transparent=True)
    return out.getvalue()
