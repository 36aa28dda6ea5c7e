"""Four points under an affine map: what stays the same, and a table of it for every four LEDs of every robot.

Four coplanar points have two affine invariants. Where they are convex: at what fractions (s, t) their diagonals cross;
where one lies inside the triangle of the others: its barycentric coordinates. A perspective image changes them by as
much as the plate is near and tilted, so a table over cells of these numbers, every four LEDs in all cells that they
can be seen in, turns four spots into the robots and labels they may be; `perspective` says exactly which can be.
Points are given in a right-handed plane (x right, y up), and orientation counts: a mirror image has other numbers.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.identity.perspective import MIDDLE, NUMBERS, POINTS, SUMS, explains, numbers_of

CELLS = 40  # along each invariant
SLACKS = (0.01, 0.03)  # what noise may move an invariant, beside perspective: in one table, and in a looser one
LAYERS = (0.15, 0.3, 1.0)  # tables for plates whose depth changes so much, of itself, from LED to LED at most
LEAST_WEIGHT = 0.2  # no LED is nearer than this share of the four's mean depth
MOST_MATCHES = 64  # of four spots


@compiled
def invariants(points, order, values):
    """Kind (0 convex, 1 concave, -1 degenerate) and area of four points (4, 2).

    ``order`` (4,) receives them counter-clockwise (concave: the hull, then the inner one), ``values`` (2,) the
    invariants.
    """
    ax, ay = points[0, 0], points[0, 1]
    bx, by = points[1, 0] - ax, points[1, 1] - ay
    cx, cy = points[2, 0] - ax, points[2, 1] - ay
    dx, dy = points[3, 0] - ax, points[3, 1] - ay
    area = bx * cy - by * cx
    i1, i2 = 1, 2
    if area < 0.0:
        area = -area
        i1, i2 = 2, 1
        bx, by, cx, cy = cx, cy, bx, by
    if area < 1e-12:
        return -1, 0.0
    # Barycentric coordinates of the fourth point in the triangle 0, i1, i2.
    w1 = (dx * cy - dy * cx) / area
    w2 = (bx * dy - by * dx) / area
    w0 = 1.0 - w1 - w2
    outside = int(w0 < 0.0) + int(w1 < 0.0) + int(w2 < 0.0)
    if outside == 0:
        order[0], order[1], order[2], order[3] = 0, i1, i2, 3
        values[0], values[1] = w0, w1
        return 1, area
    if outside == 2:
        # The fourth point lies beyond a corner, which so is inside the triangle of the others.
        if w0 >= 0.0:
            inner, p, q, w, wp = 0, i1, i2, w0, w1
        elif w1 >= 0.0:
            inner, p, q, w, wp = i1, i2, 0, w1, w2
        else:
            inner, p, q, w, wp = i2, 0, i1, w2, w0
        if w < 1e-9:
            return -1, 0.0
        # 3 = w inner + wp p + wq q, so inner = (3 - wp p - wq q) / w.
        order[0], order[1], order[2], order[3] = 3, p, q, inner
        values[0], values[1] = 1.0 / w, -wp / w
        return 1, area * w
    # Convex: the fourth point lies across one edge.
    if w0 < 0.0:
        order[0], order[1], order[2], order[3] = 0, i1, 3, i2
    elif w1 < 0.0:
        order[0], order[1], order[2], order[3] = i1, i2, 3, 0
    else:
        order[0], order[1], order[2], order[3] = i2, 0, 3, i1
    ox, oy = points[order[0], 0], points[order[0], 1]
    ex, ey = points[order[2], 0] - ox, points[order[2], 1] - oy
    fx, fy = points[order[3], 0] - points[order[1], 0], points[order[3], 1] - points[order[1], 1]
    gx, gy = points[order[1], 0] - ox, points[order[1], 1] - oy
    det = ex * fy - ey * fx
    values[0] = (gx * fy - gy * fx) / det
    values[1] = (gx * ey - gy * ex) / det
    return 0, abs(det)


class QuadTable(NamedTuple):
    """Entries (robot, four LEDs) and which of them each cell holds: for each of the SLACKS and LAYERS first the convex
    ones, then the concave ones.

    ``entries`` (n, 5), their ``numbers`` (n, NUMBERS), where the list of every cell ``starts`` (cells + 1,), and the
    lists that are ``held``.
    """

    entries: Any
    numbers: Floats
    starts: Any
    held: Any

    @staticmethod
    def of(layouts: Floats, steepest: Floats) -> "QuadTable":
        """That of ``layouts`` (robots, 6, 2 or 3): the LEDs in their planes, whose depth changes over the plate by at
        most ``steepest`` (robots,), 1 / m, of itself.
        """
        kinds: list[int] = []
        entries: list[list[int]] = []
        numbers: list[Floats] = []
        order, pair = np.empty(4, np.int64), np.empty(2)
        for robot, layout in enumerate(layouts[:, :, :2]):
            for leds in itertools.combinations(range(layout.shape[0]), 4):
                kind, _ = invariants(np.ascontiguousarray(layout[list(leds)]), order, pair)
                if kind < 0:
                    continue
                ring = [leds[k] for k in order]
                for turned, s, t in _turns(kind, ring, float(pair[0]), float(pair[1])):
                    kinds.append(kind)
                    entries.append([robot, *turned])
                    numbers.append(numbers_of(layout[turned], s, t))
        named = np.array(entries, np.int32).reshape(-1, 5)
        told = np.array(numbers).reshape(-1, NUMBERS)
        tables = itertools.product(SLACKS, LAYERS)
        pairs = [_cells(np.array(kinds), told, steepest[named[:, 0]], change, slack) for slack, change in tables]
        cells = np.concatenate([2 * CELLS * CELLS * table + cells for table, (cells, _) in enumerate(pairs)])
        by_cell = np.argsort(cells, kind="stable")
        starts = np.searchsorted(cells[by_cell], np.arange(len(pairs) * 2 * CELLS * CELLS + 1)).astype(np.int32)
        held = np.concatenate([rows for _, rows in pairs])[by_cell].astype(np.int32)
        return QuadTable(named, told, starts, held)


class LookedUp(NamedTuple):
    """Four spots ``four`` (4, 2) in the tangent plane of a `perspective.View`; the entries of the table that they may
    be, ``matches`` (m,), with the maps ``hs`` (m, 3, 3) from the plate to that plane; the ``order`` (4,) of the spots
    that belongs to them, and ``values`` (2,), their invariants.
    """

    four: Any
    order: Any
    values: Any
    matches: Any
    hs: Any
    sums: Any


@compiled
def room_to_look_up():
    """Empty `LookedUp`."""
    order, matches, hs = np.empty(4, np.int64), np.empty(MOST_MATCHES, np.int64), np.empty((MOST_MATCHES, 3, 3))
    return LookedUp(np.empty((4, 2)), order, np.empty(2), matches, hs, np.empty(SUMS))


@compiled
def _layer(four, view):
    """Which of the SLACKS and LAYERS holds a plate seen as the four: along a line seen as long as a, rad, the depth
    changes by a tan(tilt) at most, and what spots are off moves an invariant by about that over a.
    """
    far2 = 0.0
    for i in range(4):
        for j in range(i):
            far2 = max(far2, (four[i, 0] - four[j, 0]) ** 2 + (four[i, 1] - four[j, 1]) ** 2)
    first = len(LAYERS) if 4.0 * view.sigma**2 > SLACKS[0] ** 2 * far2 else 0
    far2 *= 1.0 / view.most_tilt**2 - 1.0
    layer = 0
    while layer < len(LAYERS) - 1 and far2 > LAYERS[layer] ** 2:
        layer += 1
    return first + layer


@compiled
def look_up(room, table, view, wanted):
    """Which entries of the `QuadTable` the four spots in ``room`` (`LookedUp`) may be in that `View`: not mirrored, and
    of robots that are ``wanted`` (robots,).

    Fills the rest of ``room``, and returns how many entries there are.
    """
    four, order, values, matches, hs = room.four, room.order, room.values, room.matches, room.hs
    kind, area = invariants(four, order, values)
    if kind < 0 or area < view.least_area:
        return 0
    row, column = int(values[0] * CELLS), int(values[1] * CELLS)
    if not (0 <= row < CELLS and 0 <= column < CELLS):
        return 0
    cell = ((2 * _layer(four, view) + kind) * CELLS + row) * CELLS + column
    count = 0
    for place in range(table.starts[cell], table.starts[cell + 1]):
        entry = table.held[place]
        if not wanted[table.entries[entry, 0]]:
            continue
        if count < matches.shape[0] and explains(table.numbers[entry], four, order, view, room.sums, hs[count]):
            matches[count] = entry
            count += 1
    return count


def _turns(kind: int, ring: list[int], s: float, t: float) -> Iterator[tuple[list[int], float, float]]:
    """The same four in every order that `invariants` may give them, with their invariants."""
    if kind == 0:
        for _ in range(4):
            yield ring, s, t
            ring, s, t = ring[1:] + ring[:1], t, 1.0 - s
    else:
        hull, weights = ring[:3], [s, t, 1.0 - (s + t)]
        for _ in range(3):
            yield [*hull, ring[3]], weights[0], weights[1]
            hull, weights = hull[1:] + hull[:1], weights[1:] + weights[:1]


def _cells(
    kinds: NDArray[np.int64], numbers: Floats, steepest: Floats, change: float, slack: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells (m,) and which entries they hold (m,): each wherever perspective may move it, and noise by ``slack``.

    Depth changes by no more than ``steepest`` (n,), 1 / m, of itself, and by ``change`` of itself from LED to LED.

    In perspective a point's weight in a sum is multiplied by its relative depth w = 1 + g X. So a crossing fraction s
    of the diagonal from a to c becomes s w(c) / ((1 - s) w(a) + s w(c)), and the barycentric coordinate s of a corner a
    s w(a) / w(inner point). That is tried for gradients g all over a disc, so densely that no cell is missed.
    """
    s, t, points = numbers[:, 0], numbers[:, 1], numbers[:, POINTS:MIDDLE].reshape(-1, 4, 2)
    across = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1).max(axis=(1, 2))
    reach = np.minimum(steepest, min(change, 1.0 - LEAST_WEIGHT) / across)
    steps = math.ceil(0.25 * float((reach * across).max()) / (2.0 * slack))
    offsets = np.linspace(-slack, slack, math.ceil(2.0 * slack * CELLS) + 1)
    entry, touched = np.arange(len(kinds))[:, None, None], np.zeros((len(kinds), CELLS, CELLS), np.bool_)
    for step in range(steps + 1):
        for angle in np.linspace(0.0, 2.0 * math.pi, max(6 * step, 1), endpoint=False):
            g = (reach * step / steps)[:, None] * [math.cos(angle), math.sin(angle)]
            w = 1.0 + np.einsum("nij,nj->ni", points, g)
            crossing = (1.0 - s) * w[:, 0] + s * w[:, 2]
            moved_s = s * np.where(kinds == 0, w[:, 2] / crossing, w[:, 0] / w[:, 3])
            moved_t = t * np.where(kinds == 0, w[:, 3] / crossing, w[:, 1] / w[:, 3])
            rows, columns = _cell(moved_s[:, None] + offsets), _cell(moved_t[:, None] + offsets)
            touched[entry, rows[:, :, None], columns[:, None, :]] = True
    held, row, column = touched.nonzero()
    return (kinds[held] * CELLS + row) * CELLS + column, held


def _cell(values: Floats) -> NDArray[np.int64]:
    return np.clip((values * CELLS).astype(np.int64), 0, CELLS - 1)
