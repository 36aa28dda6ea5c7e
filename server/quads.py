"""Four points under an affine map: what stays the same, and a table of it for every four LEDs of every robot.

Four coplanar points have two affine invariants. Where they are convex: at what fractions (s, t) their diagonals cross;
where one lies inside the triangle of the others: its barycentric coordinates. A perspective image changes them
little, so a table over cells of these numbers turns four spots into the few robots and labels they can be.
Points are given in a right-handed plane (x right, y up), and orientation counts: a mirror image has other numbers.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled

CELLS = 40  # along each invariant
TOLERANCE = 0.05  # how far perspective may move an invariant (extent / distance up to 0.2)


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


class QuadTable:
    """For both kinds: entries (robot, four LEDs), their invariants, and which entries each cell holds (CSR)."""

    def __init__(self, layouts: Floats) -> None:
        """``layouts`` (robots, 6, 2 or 3): the LEDs in their planes."""
        entries: tuple[list[list[int]], list[list[int]]] = ([], [])
        values: tuple[list[tuple[float, float]], list[tuple[float, float]]] = ([], [])
        order, pair = np.empty(4, np.int64), np.empty(2)
        for robot, layout in enumerate(layouts):
            for leds in itertools.combinations(range(layout.shape[0]), 4):
                kind, _ = invariants(np.ascontiguousarray(layout[list(leds), :2]), order, pair)
                if kind < 0:
                    continue
                ring = [leds[k] for k in order]
                if kind == 0:
                    s, t = float(pair[0]), float(pair[1])
                    for _ in range(4):
                        entries[0].append([robot, *ring])
                        values[0].append((s, t))
                        ring = ring[1:] + ring[:1]
                        s, t = t, 1.0 - s
                else:
                    hull, weights = ring[:3], [float(pair[0]), float(pair[1]), 1.0 - float(pair[0] + pair[1])]
                    for _ in range(3):
                        entries[1].append([robot, *hull, ring[3]])
                        values[1].append((weights[0], weights[1]))
                        hull, weights = hull[1:] + hull[:1], weights[1:] + weights[:1]
        self.convex = _cells(entries[0], values[0])
        self.concave = _cells(entries[1], values[1])


Cells = tuple[NDArray[np.int32], Floats, NDArray[np.int32], NDArray[np.int32]]


def _cells(entries: list[list[int]], values: list[tuple[float, float]]) -> Cells:
    """Entries (n, 5), values (n, 2), and for every cell where its list of entries begins, and the lists."""
    held: list[list[int]] = [[] for _ in range(CELLS * CELLS)]
    for number, (a, b) in enumerate(values):
        for i in range(_cell(a - TOLERANCE), _cell(a + TOLERANCE) + 1):
            for j in range(_cell(b - TOLERANCE), _cell(b + TOLERANCE) + 1):
                held[i * CELLS + j].append(number)
    starts = np.zeros(CELLS * CELLS + 1, np.int32)
    starts[1:] = np.cumsum([len(numbers) for numbers in held])
    return (
        np.array(entries, np.int32).reshape(-1, 5),
        np.array(values, np.float64).reshape(-1, 2),
        starts,
        np.array([number for numbers in held for number in numbers], np.int32),
    )


def _cell(value: float) -> int:
    return min(max(int(value * CELLS), 0), CELLS - 1)
