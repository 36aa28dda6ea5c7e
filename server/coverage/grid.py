"""The patches of a surface: squares over the x and y of its frame, numbered from the frame's origin, so that the maps
of several days lie on each other.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights, Surface

_BLOCK = 32  # patches: a grid begins and ends at whole blocks
_SLICE = 1 << 16  # places at once: a grid of heights takes 1 kB for each


class Box(NamedTuple):
    """Numbers of patches along x (columns) and y (rows) of the frame: from the first to before the last."""

    column: int
    row: int
    column_end: int
    row_end: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.row_end - self.row, self.column_end - self.column

    @property
    def patches(self) -> int:
        """How many there are."""
        rows, columns = self.shape
        return rows * columns

    def with_(self, other: "Box") -> "Box":
        """The least that holds both."""
        if not self.patches:
            return other
        return Box(
            min(self.column, other.column),
            min(self.row, other.row),
            max(self.column_end, other.column_end),
            max(self.row_end, other.row_end),
        )

    def within(self, other: "Box") -> tuple[slice, slice]:
        """Where its rows and columns are in the other's, which holds it."""
        rows, columns = self.shape
        row, column = self.row - other.row, self.column - other.column
        return slice(row, row + rows), slice(column, column + columns)


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The patches in a box: patch (row i, column j) has its middle at ``pitch_m`` * (box.column + j + 0.5,
    box.row + i + 0.5) of the surface's frame. ``inside`` (rows, columns): whether there is a surface at its middle;
    ``areas`` (rows, columns) m^2 of the surface itself, by its slope there, 0 where there is none. ``ends``: the
    surface has an edge of its own, and all of it is in the box.
    """

    surface: Surface
    pitch_m: float
    box: Box
    inside: NDArray[np.bool_]
    areas: Floats
    ends: bool

    @staticmethod
    def over(surface: Surface, pitch_m: float, box: Box | None = None) -> "Grid":
        """The grid over a box, or over all of a surface that ends (`bounds`); of another without a box it is empty."""
        ends = bounds(surface)
        if ends is not None:
            box = patches_between(ends, pitch_m)
        box = box or Box(0, 0, 0, 0)
        inside, areas = _areas(surface, pitch_m, box)
        return Grid(surface, pitch_m, box, inside, areas, ends is not None)

    @property
    def x_m(self) -> Floats:
        """(columns,) of the middles."""
        return self._middles_m(self.box.column, self.box.column_end)

    @property
    def y_m(self) -> Floats:
        """(rows,) of the middles."""
        return self._middles_m(self.box.row, self.box.row_end)

    def _middles_m(self, first: int, end: int) -> Floats:
        return (np.arange(first, end, dtype=np.float64) + 0.5) * self.pitch_m

    @property
    def middles(self) -> Floats:
        """(rows, columns, 2) m."""
        return np.stack(np.meshgrid(self.x_m, self.y_m), axis=-1)

    @property
    def area_m2(self) -> float:
        """Of the surface in the box; of one that does not end, of what of it was needed."""
        return float(self.areas.sum())


def bounds(surface: Surface) -> Floats | None:
    """Least and greatest x, y (2, 2) m of a surface that ends: by its edge or where its heights do; else None."""
    corners = surface.edge
    found = None if not len(corners) else np.array([corners.min(axis=0), corners.max(axis=0)])
    if isinstance(surface.shape, Heights):
        first, last = _known(surface.shape)
        found = np.array([first, last]) if found is None else np.clip(found, first, last)
    return found


def _known(heights: Heights) -> tuple[Floats, Floats]:
    """Least and greatest x, y of the nodes that are there."""
    there = np.argwhere(np.isfinite(heights.values))
    if not len(there):
        return heights.origin, heights.origin
    return heights.origin + there.min(axis=0) * heights.step, heights.origin + there.max(axis=0) * heights.step


def patches_between(least_and_most: Floats, pitch_m: float) -> Box:
    """The box of all patches between least and greatest x, y (2, 2) m."""
    (column, row), (column_end, row_end) = (
        np.floor(least_and_most[0] / pitch_m),
        np.floor(least_and_most[1] / pitch_m) + 1,
    )
    return Box(int(column), int(row), int(column_end), int(row_end))


def rounded(box: Box) -> Box:
    """The box out to whole blocks, so that a grid that grows does so seldom."""
    return Box(
        *(math.floor(first / _BLOCK) * _BLOCK for first in box[:2]),
        *(math.ceil(last / _BLOCK) * _BLOCK for last in box[2:]),
    )


def pitch_for(surface: Surface, radius_m: float, finest: float, most: int) -> float:
    """From patch to patch, m: a tool's radius over ``finest``, or so much that all of a surface that ends is in at most
    about ``most`` patches.
    """
    pitch, ends = radius_m / finest, bounds(surface)
    if ends is None:
        return pitch
    width, height = ends[1] - ends[0]
    return max(pitch, math.sqrt(width * height / most))


def _areas(surface: Surface, pitch_m: float, box: Box) -> tuple[NDArray[np.bool_], Floats]:
    rows, columns = box.shape
    x, y = np.meshgrid(np.arange(box.column, box.column_end) + 0.5, np.arange(box.row, box.row_end) + 0.5)
    middles = np.column_stack([x.ravel(), y.ravel()]) * pitch_m
    inside, areas = np.zeros(len(middles), np.bool_), np.zeros(len(middles))
    for at in range(0, len(middles), _SLICE):
        ground = surface.ground(middles[at : at + _SLICE])
        inside[at : at + _SLICE] = ground.inside
        with np.errstate(invalid="ignore"):
            stretch = np.sqrt(1.0 + (ground.slopes**2).sum(axis=1))
        areas[at : at + _SLICE] = np.where(ground.inside, stretch * pitch_m**2, 0.0)
    return inside.reshape(rows, columns), areas.reshape(rows, columns)
