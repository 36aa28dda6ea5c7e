"""Triangles seen from +z, on a grid: how high the topmost is at every node, and whether it faces up."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats

Ints = NDArray[np.int64]
_AT_ONCE = 1 << 20  # nodes
_EDGE_ON = 1e-9  # of its longest side squared: a triangle of less area is a wall
_OVERLAP = 2e-3  # of a step: triangles reach so far beyond their sides, so that no crack between two is a hole


class Raster(NamedTuple):
    """Of every node (nx, ny) of a grid: the topmost ``height``, nan where there is no triangle, and the triangle
    ``which`` it is of, -1 for none.
    """

    height: Floats
    which: Ints


def rastered(triangles: Floats, origin: Floats, step: Floats, shape: tuple[int, int]) -> Raster:
    """The triangles (n, 3, 3) at the nodes origin (2,) + (i, j) step (2,); of equally high ones the last counts.

    Row by row of nodes at the same x: where a triangle's sides cross the row, its nodes lie between.
    """
    height, which = np.full(shape[0] * shape[1], -np.inf), np.full(shape[0] * shape[1], -1)
    place = (triangles[:, :, :2] - origin) / step
    ab, ac = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    area = np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    seen = area > _EDGE_ON * np.maximum((ab**2).sum(axis=1), (ac**2).sum(axis=1))
    first = np.clip(np.ceil(place[:, :, 0].min(axis=1) - _OVERLAP), 0, shape[0]).astype(np.int64)
    last = np.clip(np.floor(place[:, :, 0].max(axis=1) + _OVERLAP), -1, shape[0] - 1).astype(np.int64)
    rows = np.where(seen, np.maximum(last - first + 1, 0), 0)
    ends = np.cumsum(rows)
    start = 0
    while start < len(rows):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + _AT_ONCE // 4, side="right")))
        _draw(triangles, place, first, rows, np.arange(start, stop), shape, height, which)
        start = stop
    height[np.isneginf(height)] = np.nan
    return Raster(height.reshape(shape), which.reshape(shape))


def _draw(
    triangles: Floats, place: Floats, first: Ints, rows: Ints, some: Ints, shape: tuple[int, int], height: Floats,
    which: Ints,
) -> None:  # fmt: skip
    """Draw ``some`` of the triangles."""
    of, nth = _spread(rows[some])
    of = some[of]
    i = first[of] + nth
    corners = place[of]
    low, high = _crossed(corners, i)
    j0 = np.clip(np.ceil(low - _OVERLAP), 0, shape[1]).astype(np.int64)
    j1 = np.clip(np.floor(high + _OVERLAP), -1, shape[1] - 1).astype(np.int64)
    counts = np.maximum(j1 - j0 + 1, 0)
    kept = counts > 0
    of, i, j0, counts = of[kept], i[kept], j0[kept], counts[kept]
    ends = np.cumsum(counts)
    start = 0
    while start < len(counts):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + _AT_ONCE, side="right")))
        row, nth = _spread(counts[start:stop])
        row += start
        _put(triangles, place, of[row], i[row], j0[row] + nth, shape, height, which)
        start = stop


def _crossed(corners: Floats, i: Ints) -> tuple[Floats, Floats]:
    """From where to where a row of nodes at i (n,) crosses triangles (n, 3, 2), in steps; low > high: it does not."""
    left, right = corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
    inset = np.minimum(_OVERLAP, 0.5 * (right - left))  # at its outermost corner a row would cross nothing of a side
    x = np.clip(i.astype(np.float64), left + inset, right - inset)
    low, high = np.full(len(i), np.inf), np.full(len(i), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        (x0, y0), (x1, y1) = corners[:, a].T, corners[:, b].T
        touched = (np.minimum(x0, x1) <= x) & (x <= np.maximum(x0, x1))
        with np.errstate(all="ignore"):
            t = np.where(x1 != x0, (x - x0) / (x1 - x0), 0.0)
        y = y0 + t * (y1 - y0)
        flat = x0 == x1
        low = np.where(touched, np.minimum(low, np.where(flat, np.minimum(y0, y1), y)), low)
        high = np.where(touched, np.maximum(high, np.where(flat, np.maximum(y0, y1), y)), high)
    return low, high


def _put(
    triangles: Floats, place: Floats, of: Ints, i: Ints, j: Ints, shape: tuple[int, int], height: Floats, which: Ints,
) -> None:  # fmt: skip
    (ax, ay), (bx, by), (cx, cy) = place[of].transpose(1, 2, 0)
    za, zb, zc = triangles[of, :, 2].T
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    u = ((i - ax) * (cy - ay) - (cx - ax) * (j - ay)) / area
    v = ((bx - ax) * (j - ay) - (i - ax) * (by - ay)) / area
    z = za + u * (zb - za) + v * (zc - za)
    # A sliver's plane leads nowhere beyond its sides.
    z = np.clip(z, np.minimum(np.minimum(za, zb), zc), np.maximum(np.maximum(za, zb), zc))
    node = i * shape[1] + j
    np.maximum.at(height, node, z)
    top = z >= height[node]
    which[node[top]] = of[top]


def _spread(counts: Ints) -> tuple[Ints, Ints]:
    """Of counts [2, 3]: whose each of their sum is, [0, 0, 1, 1, 1], and the how manieth of it, [0, 1, 0, 1, 2]."""
    of = np.repeat(np.arange(len(counts)), counts)
    return of, np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
