"""The part of a surface that robots have to drive on: the largest rectangle that lies on it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights, Surface, within

CELLS = 128  # along each axis, where the surface is not a grid itself
Half = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Part:
    """A rectangle in x, y of a surface's frame: its ``middle``, and how far it reaches to both sides of that, m."""

    middle: tuple[float, float]
    half: Half


def part_of(surface: Surface, half: Half, about: Floats | None = None) -> Part | None:
    """The largest rectangle on the surface that reaches no farther than ``half`` m to both sides of its middle.

    Where ``about`` (2,) is given, no farther than that from there. None where there is no surface.
    """
    centre = np.zeros(2) if about is None else about
    low, high = _bounds(surface, centre - half, centre + half, about is not None)
    if not (low < high).all():
        return None
    lines = [_lines(surface, axis, low[axis], high[axis]) for axis in range(2)]
    found = _largest(_on(surface, *lines))
    if found is None:
        return None
    x0, x1, y0, y1 = found
    sides = np.array([[lines[0][x0], lines[0][x1]], [lines[1][y0], lines[1][y1]]])
    middle, reach = sides.mean(axis=1), np.minimum(0.5 * np.diff(sides)[:, 0], half)
    return Part((float(middle[0]), float(middle[1])), (float(reach[0]), float(reach[1])))


def _bounds(surface: Surface, low: Floats, high: Floats, near: bool) -> tuple[Floats, Floats]:
    """Where it may lie, (2,) each; what has no bounds of its own, or is looked at ``near`` a place, within these."""
    own = []
    if isinstance(surface.shape, Heights):
        last = np.array(surface.shape.values.shape) - 1
        own.append((surface.shape.origin, surface.shape.origin + last * surface.shape.step))
    if len(surface.edge):
        own.append((surface.edge.min(axis=0), surface.edge.max(axis=0)))
    if near or not own:
        own.append((low, high))
    lows, highs = zip(*own, strict=True)
    return np.max(lows, axis=0), np.min(highs, axis=0)


def _lines(surface: Surface, axis: int, low: float, high: float) -> Floats:
    """The lines across an axis that cut it into cells: a grid's own."""
    if not isinstance(surface.shape, Heights):
        return np.linspace(low, high, CELLS + 1)
    nodes = surface.shape.values.shape[axis]
    lines: Floats = surface.shape.origin[axis] + surface.shape.step[axis] * np.arange(nodes)
    return lines[(lines > low - 1e-9) & (lines < high + 1e-9)]


def _on(surface: Surface, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """Which cells (nx, ny) between these lines are on the surface."""

    def grid(xs: Floats, ys: Floats) -> Floats:
        return np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)

    if len(x) < 2 or len(y) < 2:
        return np.zeros((0, 0), np.bool_)
    on = surface.ground(grid(0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))).inside.reshape(len(x) - 1, len(y) - 1)
    if len(surface.edge):
        nodes = grid(x, y)
        nodes -= 1e-6 * (nodes - nodes.mean(axis=0))  # they may lie on the edge itself
        corners = within(surface.edge, nodes).reshape(len(x), len(y))
        on = on & corners[1:, 1:] & corners[1:, :-1] & corners[:-1, 1:] & corners[:-1, :-1]
    return on


def _largest(on: NDArray[np.bool_]) -> tuple[int, int, int, int] | None:
    """First and last line along x, and along y, of the largest rectangle of cells that are all set; None of none.

    Source: the largest rectangle below a histogram with a stack, for the runs of cells that end at each row.
    """
    if on.all() and on.size:
        return 0, on.shape[0], 0, on.shape[1]
    best, found = 0, None
    runs = np.zeros(on.shape[1] + 1, np.int64)
    for row, cells in enumerate(on):
        runs[:-1] = np.where(cells, runs[:-1] + 1, 0)
        stack: list[tuple[int, int]] = []  # where a rectangle begins, how tall it is
        for column, run in enumerate(runs.tolist()):
            start = column
            while stack and stack[-1][1] >= run:
                start, tall = stack.pop()
                if tall * (column - start) > best:
                    best, found = tall * (column - start), (row + 1 - tall, row + 1, start, column)
            stack.append((start, run))
    return found
