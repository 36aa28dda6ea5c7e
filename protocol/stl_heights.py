"""A drawing's triangles as a grid of heights: the topmost sheet that faces up, as seen from the frame's +z.

The triangles are drawn on a fine grid, bent as their neighbours tell (`facet_bends`). Of every 2nd, 4th, ... of its
nodes that grid is kept which is the coarsest from which the others follow, and without losing more than a hundredth of
the surface at its edges. How far it is from the flat triangles, because of facets, steps and grooves, is in the sigmas
of the nodes around.
"""

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.facet_bends import bent, facet_bends
from asterism.protocol.geometry import Floats
from asterism.protocol.heights_file import LARGEST_M, MOST_NODES
from asterism.protocol.raster import Raster, rastered
from asterism.protocol.surface import STEEPEST, Heights, between_nodes

SMALLEST_M = 0.005  # of what a robot drives on, along x or y
_COARSEST = 32  # nodes of the fine grid from one to the next of the coarsest
_ENOUGH_M = 1e-6  # so far off a coarser grid may be ...
_OF_FACETS = 0.5  # ... or such a share of what the facets around are off, ...
_MOSTLY = 0.999  # ... at this share of the places
_LOST = 0.01  # of the surface, at edges, holes and walls
_DOWN = 0.01  # of what is seen from +z may face down
_NAMES = ("x", "y", "z")

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def stl_heights(triangles: Floats, name: str) -> Heights:
    """The grid of heights of triangles (n, 3, 3) m; ``name`` is what sentences call them.

    Raises InputError: in mm, too small, no triangle that faces up, or inside out.
    """
    _refuse_size(triangles, name)
    up, steep = _facing(triangles)
    if not (up & ~steep).any():
        raise InputError(f"{name}: no triangle of it faces +z, {_turned(triangles)}")
    # Those that face up are drawn last: where two lie on one another they count.
    order = np.concatenate([np.flatnonzero(~up), np.flatnonzero(up)])
    ordered = triangles[order]
    low = ordered[:, :, :2].min(axis=(0, 1))
    extent = ordered[:, :, :2].max(axis=(0, 1)) - low
    cells = 2 * _cells(extent)
    step = extent / cells
    raster = rastered(ordered, low, step, (int(cells[0]) + 1, int(cells[1]) + 1))
    flat = _facing_up(raster, up[order], steep[order], triangles, low, step, name)
    fine = flat + _above(raster.which, ordered, facet_bends(ordered, (up & ~steep)[order]), low, step)
    return _coarsest(fine, flat, _walls(flat, step), low, step)


def _above(which: Ints, triangles: Floats, bends: Floats, low: Floats, step: Floats) -> Floats:
    """How far the surface is above the flat triangle at every node, of the triangle that is seen there."""
    above = np.zeros(which.shape)
    bends_there = (which >= 0) & (bends != 0.0).any(axis=1)[which]
    place = low + step * np.argwhere(bends_there)
    of = which[bends_there]
    a, b, c = triangles[of, :, :2].transpose(1, 0, 2)
    ab, ac, at = b - a, c - a, place - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    u = (at[:, 0] * ac[:, 1] - at[:, 1] * ac[:, 0]) / area
    v = (ab[:, 0] * at[:, 1] - ab[:, 1] * at[:, 0]) / area
    above[bends_there] = bent(u, v, bends[of])
    return above


def _refuse_size(triangles: Floats, name: str) -> None:
    extent = np.ptp(triangles, axis=(0, 1))
    shown = " x ".join(f"{length:.3g}" for length in extent)
    most = float(np.abs(triangles).max())
    if extent[:2].max() > LARGEST_M or most > 100.0:
        raise InputError(
            f"{name}: is {shown} m large and reaches {most:.3g} m from its origin, expected at most "
            f"{LARGEST_M:g} m and 100 m; is it in mm? Then add `scale: 0.001` beside `stl`"
        )
    if extent[:2].max() < SMALLEST_M:
        raise InputError(
            f"{name}: is {shown} m large, expected {SMALLEST_M:g} m at least; is it in m already? Then leave out "
            "`scale`"
        )


def _facing(triangles: Floats) -> tuple[Bools, Bools]:
    """Which triangles' outside is seen from +z, and which are too steep to be a height."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    up = normals[:, 2] > 0.0
    return up, np.hypot(normals[:, 0], normals[:, 1]) > STEEPEST * np.abs(normals[:, 2])


def _turned(triangles: Floats) -> str:
    """What to do with a drawing that lies or stands otherwise."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2.0
    areas = np.array([np.maximum(sign * normals[:, axis], 0.0).sum() for axis in range(3) for sign in (1, -1)])
    best = int(areas.argmax())
    where = f"{'+-'[best % 2]}{_NAMES[best // 2]}"
    return (
        f"most of it faces {where}; turn it in the program that wrote it so that +z points out of the material"
        if best != 4
        else "expected a surface whose +z points out of the material"
    )


def _cells(extent: Floats) -> NDArray[np.int64]:
    """How many cells the finest grid that is allowed has along x and y: multiples of half the coarsest's."""
    unit = _COARSEST // 2
    extent = np.maximum(extent, 1e-9)
    step = float(np.sqrt(extent.prod() / MOST_NODES))
    cells = np.maximum(np.floor(extent / step / unit).astype(np.int64), 1) * unit
    while (cells + 1).prod() > MOST_NODES:
        cells[int(cells.argmax())] -= unit
    return cells


def _facing_up(
    raster: Raster, up: Bools, steep: Bools, triangles: Floats, low: Floats, step: Floats, name: str
) -> Floats:
    """Heights of the nodes whose topmost triangle faces up and is not too steep, nan elsewhere."""
    there = raster.which >= 0
    down = there & ~up[raster.which]
    share = float(down.sum()) / max(int(there.sum()), 1)
    if share > 0.5:
        raise InputError(
            f"{name}: {share:.0%} of what is seen of it from +z faces down: its triangles are inside out, or z points "
            "into the material; flip their normals in the program that wrote it, or turn it over"
        )
    if share > _DOWN:
        x, y = low + step * np.argwhere(down)[0]
        raise InputError(
            f"{name}: {share:.1%} of what is seen of it from +z faces down, for example at ({x:.4g}, {y:.4g}): not all "
            "its triangles have their outside on the same side; make its normals consistent in the program that wrote "
            "it"
        )
    if not there.any():
        raise InputError(f"{name}: nothing of it is seen from +z, {_turned(triangles)}")
    return np.where(there & ~down & ~steep[raster.which], raster.height, np.nan)


def _walls(fine: Floats, step: Floats) -> tuple[Bools, Bools]:
    """Between which nodes and the next along x (nx - 1, ny) and along y (nx, ny - 1) there is a wall or nothing."""
    along = []
    for axis in range(2):
        rise = np.abs(np.diff(fine, axis=axis))
        along.append(np.logical_not(rise <= STEEPEST * step[axis]))
    return along[0], along[1]


def _coarsest(fine: Floats, flat: Floats, walls: tuple[Bools, Bools], low: Floats, step: Floats) -> Heights:
    there = int(np.isfinite(fine).sum())
    around = np.kron(_mean_squares(fine - flat, _COARSEST), np.ones((_COARSEST, _COARSEST)))
    enough = np.maximum(_ENOUGH_M, _OF_FACETS * np.sqrt(np.pad(around, ((0, 1), (0, 1)), mode="edge")))
    every = _COARSEST
    while True:
        values = _without_walls(fine, walls, every)
        dense = between_nodes(values, every)
        known = np.isfinite(dense) & np.isfinite(fine)
        good = np.abs(dense - fine)[known] <= enough[known]
        if every == 2 or (len(good) >= (1.0 - _LOST) * there and good.mean() >= _MOSTLY):
            return Heights(low, step * every, values, _sigmas(dense - flat, every))
        every //= 2


def _without_walls(fine: Floats, walls: tuple[Bools, Bools], every: int) -> Floats:
    """Every so many nodes; where there is a wall or a hole in a cell between four, the lowest of them is left out."""
    values: Floats = fine[::every, ::every].copy()
    nx, ny = values.shape[0] - 1, values.shape[1] - 1
    along_x = np.logical_or.reduce(walls[0].reshape(nx, every, -1), axis=1)
    along_y = np.logical_or.reduce(walls[1].reshape(-1, ny, every), axis=2)
    cells = _touching(along_x, every, 1) | _touching(along_y, every, 0)
    corners = np.stack([values[:-1, :-1], values[1:, :-1], values[:-1, 1:], values[1:, 1:]])
    lowest = corners.argmin(axis=0)  # of a nan its own
    i, j = np.nonzero(cells & np.isfinite(corners).all(axis=0))
    which = lowest[i, j]
    values[i + which % 2, j + which // 2] = np.nan
    return values


def _touching(lines: Bools, every: int, axis: int) -> Bools:
    """Whether any of the ``every`` + 1 lines of fine nodes of a cell is so, along an axis."""
    count = (lines.shape[axis] - 1) // every
    starts = np.arange(count) * every
    inner = np.logical_or.reduceat(np.delete(lines, -1, axis=axis), starts, axis=axis)
    ends: Bools = np.logical_or(inner, np.take(lines, starts + every, axis=axis))
    return ends


def _sigmas(off: Floats, every: int) -> Floats:
    """Of every node, the worst RMS among the cells around it of how far the grid is off (at the fine nodes)."""
    mean = np.pad(_mean_squares(off, every), 1)
    worst = np.max([mean[:-1, :-1], mean[1:, :-1], mean[:-1, 1:], mean[1:, 1:]], axis=0)
    sigmas: Floats = np.sqrt(worst)
    return sigmas


def _mean_squares(off: Floats, every: int) -> Floats:
    """Of every cell of so many fine nodes along x and y, the mean square of those that are numbers."""
    nx, ny = (off.shape[0] - 1) // every, (off.shape[1] - 1) // every
    squares = (off[:-1, :-1] ** 2).reshape(nx, every, ny, every)
    known = np.isfinite(squares)
    mean: Floats = np.where(known, squares, 0.0).sum(axis=(1, 3)) / np.maximum(known.sum(axis=(1, 3)), 1)
    return mean
