"""From four spots to six: taken for four LEDs of a robot, they say where its other two are."""

from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.identity.neighbours import first_from
from asterism.server.pose.fit import LEDS
from asterism.server.segmentation.order import ascending

HEIGHT_RATIO, RADIUS_RATIO = 0.2, 0.4  # least ratio of heights and of radii among the spots of a robot


class ByX(NamedTuple):
    """The spots from left to right: ``order`` (n,) their rows, ``xs`` (n,) ideal px."""

    order: Any
    xs: Any


class Four(NamedTuple):
    """Four ``spots`` (4,) taken for four ``leds`` (4,), and then ``labels`` (6,), the spot of every LED, -1: none. The
    rest is scratch: the homography from plate to spots ``h`` and its factors (3, 3).
    """

    spots: Any
    leds: Any
    labels: Any
    h: Any
    left: Any
    right: Any


@compiled
def by_x(flat):
    """`ByX` of spots (n, 2)."""
    order = ascending(flat[:, 0])
    return ByX(order, flat[order, 0])


@compiled
def room_for_four():
    """Empty `Four`."""
    spots, leds, labels = np.empty(4, np.int64), np.empty(4, np.int64), np.empty(LEDS, np.int64)
    return Four(spots, leds, labels, np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)))


@compiled
def _basis(points, order, out):
    """The projective basis (3, 3) of four points: columns scaled so that they sum to the fourth."""
    x0, y0 = points[order[0], 0], points[order[0], 1]
    x1, y1 = points[order[1], 0], points[order[1], 1]
    x2, y2 = points[order[2], 0], points[order[2], 1]
    x3, y3 = points[order[3], 0], points[order[3], 1]
    det = x0 * (y1 - y2) - y0 * (x1 - x2) + (x1 * y2 - x2 * y1)
    if abs(det) < 1e-15:
        return False
    l0 = (x3 * (y1 - y2) - y3 * (x1 - x2) + (x1 * y2 - x2 * y1)) / det
    l1 = (x0 * (y3 - y2) - y0 * (x3 - x2) + (x3 * y2 - x2 * y3)) / det
    l2 = 1.0 - l0 - l1
    if abs(l0) < 1e-6 or abs(l1) < 1e-6 or abs(l2) < 1e-6:
        return False
    out[0, 0], out[0, 1], out[0, 2] = l0 * x0, l1 * x1, l2 * x2
    out[1, 0], out[1, 1], out[1, 2] = l0 * y0, l1 * y1, l2 * y2
    out[2, 0], out[2, 1], out[2, 2] = l0, l1, l2
    return True


@compiled
def _homography4(source, source_order, target, target_order, h, left, right):
    """The exact homography h (3, 3) of four points (rows of ``source`` and ``target`` in the given orders)."""
    if not _basis(source, source_order, right) or not _basis(target, target_order, left):
        return False
    # h = left @ adjugate(right)
    for i in range(3):
        for j in range(3):
            a, b = (j + 1) % 3, (j + 2) % 3
            total = 0.0
            for k in range(3):
                c, d = (k + 1) % 3, (k + 2) % 3
                total += left[i, k] * (right[a, c] * right[b, d] - right[a, d] * right[b, c])
            h[i, j] = total
    if abs(h[2, 2]) < 1e-15:
        return False
    h /= h[2, 2]
    return True


@compiled
def complete(spots, layout, leds, four, along, reach):
    """Take the four spots of ``four`` for the ``leds`` (4,) of a robot with that ``layout`` (6, 3), and look for its
    other two within ``reach`` px of where the homography of the four puts them.

    ``spots`` are `Spots`, ``along`` the same `ByX`. Fills the labels of ``four`` and returns how many LEDs then have a
    spot (0: these four cannot be).
    """
    flat, free, heights, radii = spots.flat, spots.free, spots.heights, spots.radii
    labels, h, xs = four.labels, four.h, along.xs
    labels[:] = -1
    low, high, small, large = np.inf, 0.0, np.inf, 0.0
    for m in range(4):
        spot = four.spots[m]
        four.leds[m] = leds[m]
        labels[leds[m]] = spot
        low, high = min(low, heights[spot]), max(high, heights[spot])
        small, large = min(small, radii[spot]), max(large, radii[spot])
    if small < RADIUS_RATIO * large:
        return 0
    if not _homography4(layout, four.leds, flat, four.spots, h, four.left, four.right):
        return 0
    found = 4
    for led in range(LEDS):
        if labels[led] >= 0:
            continue
        x, y = layout[led, 0], layout[led, 1]
        w = h[2, 0] * x + h[2, 1] * y + 1.0
        if w < 0.3:
            continue
        px = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
        py = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
        best, best2 = -1, reach * reach
        place = first_from(xs, px - reach)
        while place < xs.shape[0] and xs[place] <= px + reach:
            spot = along.order[place]
            place += 1
            away2 = (flat[spot, 0] - px) ** 2 + (flat[spot, 1] - py) ** 2
            if not (away2 < best2 and free[spot]):
                continue
            taken = False
            for other in range(LEDS):
                taken |= labels[other] == spot
            if not taken and (
                heights[spot] >= HEIGHT_RATIO * high
                and low >= HEIGHT_RATIO * heights[spot]
                and radii[spot] >= RADIUS_RATIO * large
                and small >= RADIUS_RATIO * radii[spot]
            ):
                best, best2 = spot, away2
        if best >= 0:
            labels[led] = best
            found += 1
    return found
