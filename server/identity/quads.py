"""Four points under an affine map: what stays the same, and a table of it for every four LEDs of every robot.

Four coplanar points have two affine invariants. Where they are convex: at what fractions (s, t) their diagonals cross;
where one lies inside the triangle of the others: its barycentric coordinates. A perspective image changes them
little, so a table over cells of these numbers turns four spots into the few robots and labels they can be.
Points are given in a right-handed plane (x right, y up), and orientation counts: a mirror image has other numbers.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled

CELLS = 40  # along each invariant
TOLERANCE = 0.05  # how far perspective may move an invariant (extent / distance up to 0.2)
NEGLECTED, LEAST_SLACK = 0.3, 0.004  # what `look_up` neglects: of the movement, and at all
MOST_MATCHES = 64  # of four spots
SMALLEST_QUAD_PX2 = 30.0  # twice the area: smaller ones say nothing


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


# Columns of an entry's numbers: its invariants (2); what makes of four spots' x or y a row of the affine map from the
# plate that fits them best (2 x 4, 1 / m); what two depth differences are taken between (2 + 2, m), and their
# weights (2); see `look_up`.
NUMBERS = 16


class QuadTable(NamedTuple):
    """Entries (robot, four LEDs), first the convex, then the concave, and which of them each cell holds (CSR).

    ``entries`` (n, 5), their ``numbers`` (n, NUMBERS), where the list of every cell ``starts`` (2 CELLS^2 + 1,), and
    the lists that are ``held``.
    """

    entries: Any
    numbers: Floats
    starts: Any
    held: Any

    @staticmethod
    def of(layouts: Floats) -> "QuadTable":
        """That of ``layouts`` (robots, 6, 2 or 3): the LEDs in their planes."""
        entries: list[list[int]] = []
        numbers: list[Floats] = []
        held: list[list[int]] = [[] for _ in range(2 * CELLS * CELLS)]
        order, pair = np.empty(4, np.int64), np.empty(2)
        for robot, layout in enumerate(layouts[:, :, :2]):
            for leds in itertools.combinations(range(layout.shape[0]), 4):
                kind, _ = invariants(np.ascontiguousarray(layout[list(leds)]), order, pair)
                if kind < 0:
                    continue
                ring = [leds[k] for k in order]
                for turned, s, t in _turns(kind, ring, float(pair[0]), float(pair[1])):
                    for i in range(_cell(s - TOLERANCE), _cell(s + TOLERANCE) + 1):
                        for j in range(_cell(t - TOLERANCE), _cell(t + TOLERANCE) + 1):
                            held[(kind * CELLS + i) * CELLS + j].append(len(entries))
                    entries.append([robot, *turned])
                    numbers.append(_numbers(kind, layout[turned], s, t))
        starts = np.zeros(len(held) + 1, np.int32)
        starts[1:] = np.cumsum([len(cell) for cell in held])
        return QuadTable(
            np.array(entries, np.int32).reshape(-1, 5),
            np.array(numbers).reshape(-1, NUMBERS),
            starts,
            np.array([entry for cell in held for entry in cell], np.int32),
        )


class View(NamedTuple):
    """How a plate may be seen: at a scale from ``least_scale`` to ``most_scale`` px / m, tilted by no more than the
    angle with cosine ``most_tilt``, by a camera with ``focal`` px; its spots may be ``slack_px`` off.
    """

    focal: float
    least_scale: float
    most_scale: float
    most_tilt: float
    slack_px: float


class LookedUp(NamedTuple):
    """Four spots ``four`` (4, 2), ideal px, y up; the entries of the table that they may be, ``matches`` (m,), and the
    ``order`` (4,) of the spots that belongs to them; ``values`` (2,), their invariants.
    """

    four: Any
    order: Any
    values: Any
    matches: Any


@compiled
def room_to_look_up():
    """Empty `LookedUp`."""
    return LookedUp(np.empty((4, 2)), np.empty(4, np.int64), np.empty(2), np.empty(MOST_MATCHES, np.int64))


@compiled
def look_up(room, table, view):
    """Which entries of the `QuadTable` the four spots in ``room`` (`LookedUp`) may be in that `View`: not mirrored, and
    with invariants that differ from the entry's as the tilt demands.

    Fills the rest of ``room``, and returns how many entries there are.

    The affine map from plate to spots is their weak perspective: its singular values are focal / depth and that times
    the cosine of the tilt; the gradient g of the relative depth over the plate lies along the second singular
    vector, up to its sign. In perspective a point's weight in a sum is multiplied by its relative depth, so the
    crossing fraction s of a diagonal d moves by s (1 - s) g d, and a barycentric coordinate w by w g (corner - inner
    point).
    """
    four, order, values, matches, numbers = room.four, room.order, room.values, room.matches, table.numbers
    kind, area = invariants(four, order, values)
    if kind < 0 or area < SMALLEST_QUAD_PX2:
        return 0
    s, t = values[0], values[1]
    row, column = int(s * CELLS), int(t * CELLS)
    if not (0 <= row < CELLS and 0 <= column < CELLS):
        return 0
    ax, ay, bx, by = four[order[0], 0], four[order[0], 1], four[order[1], 0], four[order[1], 1]
    cx, cy, dx, dy = four[order[2], 0], four[order[2], 1], four[order[3], 0], four[order[3], 1]
    # The flatter the quad, the more its invariants suffer from what spots are off.
    slack = (
        LEAST_SLACK
        + 1.5 * view.slack_px * math.sqrt(max((bx - ax) ** 2 + (by - ay) ** 2, (cx - ax) ** 2 + (cy - ay) ** 2)) / area
    )
    least2, most2, per_focal2, wide2 = (
        view.least_scale**2,
        view.most_scale**2,
        1.0 / view.focal**2,
        (1.0 + NEGLECTED) ** 2,
    )
    cell = (kind * CELLS + row) * CELLS + column
    count = 0
    for place in range(table.starts[cell], table.starts[cell + 1]):
        entry = table.held[place]
        off0, off1 = s - numbers[entry, 0], t - numbers[entry, 1]
        if abs(off0) > TOLERANCE or abs(off1) > TOLERANCE:
            continue
        u0, u1, u2, u3 = numbers[entry, 2], numbers[entry, 3], numbers[entry, 4], numbers[entry, 5]
        v0, v1, v2, v3 = numbers[entry, 6], numbers[entry, 7], numbers[entry, 8], numbers[entry, 9]
        g00, g01 = ax * u0 + bx * u1 + cx * u2 + dx * u3, ax * v0 + bx * v1 + cx * v2 + dx * v3
        g10, g11 = ay * u0 + by * u1 + cy * u2 + dy * u3, ay * v0 + by * v1 + cy * v2 + dy * v3
        size = g00 * g11 - g01 * g10
        m00, m01, m11 = g00 * g00 + g10 * g10, g00 * g01 + g10 * g11, g01 * g01 + g11 * g11
        both = m00 + m11
        if size <= 0.0 or both < least2 or both > 2.0 * most2:
            continue
        large2 = 0.5 * (both + math.sqrt(max(both * both - 4.0 * size * size, 0.0)))
        if large2 < least2 or large2 > most2 or size < 0.8 * view.most_tilt * large2:
            continue
        # n = focal^2 g g^T: what the image of an untilted plate has more.
        n00, n01, n11 = large2 - m00, -m01, large2 - m11
        d0x, d0y, d1x, d1y = numbers[entry, 10], numbers[entry, 11], numbers[entry, 12], numbers[entry, 13]
        # The squares of the movements, their product, and whether the invariants have moved so, either way.
        q0 = per_focal2 * numbers[entry, 14] ** 2 * (n00 * d0x * d0x + 2.0 * n01 * d0x * d0y + n11 * d0y * d0y)
        q1 = per_focal2 * numbers[entry, 15] ** 2 * (n00 * d1x * d1x + 2.0 * n01 * d1x * d1y + n11 * d1y * d1y)
        far0, far1 = max(abs(off0) - slack, 0.0), max(abs(off1) - slack, 0.0)
        if far0 * far0 > wide2 * q0 or far1 * far1 > wide2 * q1:
            continue
        moved0, moved1 = math.sqrt(max(q0, 0.0)), math.sqrt(max(q1, 0.0))
        slack0, slack1 = slack + NEGLECTED * moved0, slack + NEGLECTED * moved1
        if n00 * d0x * d1x + n01 * (d0x * d1y + d0y * d1x) + n11 * d0y * d1y < 0.0:
            moved1 = -moved1
        if count < matches.shape[0] and (
            (abs(off0 - moved0) <= slack0 and abs(off1 - moved1) <= slack1)
            or (abs(off0 + moved0) <= slack0 and abs(off1 + moved1) <= slack1)
        ):
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


def _numbers(kind: int, points: Floats, s: float, t: float) -> Floats:
    """A row of the table's numbers for four LEDs (4, 2) with invariants ``s`` and ``t``."""
    a, b, c, d = points
    affine = np.linalg.pinv(points - points.mean(axis=0)).ravel()
    if kind == 0:
        return np.concatenate([[s, t], affine, c - a, d - b, [s * (1.0 - s), t * (1.0 - t)]])
    return np.concatenate([[s, t], affine, a - d, b - d, [s, t]])


def _cell(value: float) -> int:
    return min(max(int(value * CELLS), 0), CELLS - 1)
