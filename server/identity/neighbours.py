"""The spots that are searched, where they are on the sphere of directions, and which are near which.

Distances are chords between unit directions, so that what is near is so anywhere in the image of any lens, where ideal
pixels on a plane are stretched beyond measure towards its edge.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.segmentation.order import ascending


class Spots(NamedTuple):
    """What is searched. ``flat`` (n, 2) ideal px, y up; ``rays`` (n, 2) the same as x / z, y / z (y down);
    ``variances`` (n,) of the rays; ``heights`` (n,); ``radii`` (n,) px; ``free`` (n,): not yet a robot's. In the cold
    search ``flat`` and ``variances`` are those of directions (`sphere.lay_flat`).
    """

    flat: Floats
    rays: Floats
    variances: Floats
    heights: Floats
    radii: Floats
    free: Any


class Neighbours(NamedTuple):
    """Of every spot its nearest ones in order of distance: ``lists`` (n, most), of which ``counts`` (n,) are filled."""

    lists: Any
    counts: Any


class Directions(NamedTuple):
    """Where the spots are: ``units`` (n, 3), x right, y up, z forward; their ``order`` (n,) from left to right, and so
    ordered their ``xs`` (n,).
    """

    units: Floats
    order: Any
    xs: Any


@compiled
def directions_of(rays):
    """The `Directions` of ``rays`` (n, 2) = x / z, y / z, y down."""
    n = rays.shape[0]
    units = np.empty((n, 3))
    for i in range(n):
        x, y = rays[i, 0], -rays[i, 1]
        length = math.sqrt(x * x + y * y + 1.0)
        units[i, 0], units[i, 1], units[i, 2] = x / length, y / length, 1.0 / length
    order = ascending(units[:, 0])
    return Directions(units, order, units[order, 0])


@compiled
def apart2(units, i, j):
    """The square of the chord between two directions."""
    return (units[i, 0] - units[j, 0]) ** 2 + (units[i, 1] - units[j, 1]) ** 2 + (units[i, 2] - units[j, 2]) ** 2


@compiled
def nearest_neighbours(spots, directions, ranks, reach, alike, most):
    """The `Neighbours` of all free `Spots`: up to ``most`` free ones that rank after the spot and are like it.

    ``ranks`` (n,) are different numbers; a neighbour's chord is at most ``reach``; ``alike`` (2,): its height is at
    least that share of the spot's, of the two radii the smaller at least that share of the larger.
    """
    usable, heights, radii = spots.free, spots.heights, spots.radii
    units, order = directions.units, directions.order
    n = heights.shape[0]
    lists, counts = np.empty((n, most), np.int64), np.zeros(n, np.int64)
    chords2 = np.empty(most)
    for place in range(n):
        i = order[place]
        if not usable[i]:
            continue
        count = 0
        left, right = place - 1, place + 1
        while left >= 0 or right < n:
            # The next candidate from left to right, on either side.
            gap_left = units[i, 0] - units[order[left], 0] if left >= 0 else np.inf
            gap_right = units[order[right], 0] - units[i, 0] if right < n else np.inf
            if gap_left <= gap_right:
                j, gap = order[left], gap_left
                left -= 1
            else:
                j, gap = order[right], gap_right
                right += 1
            limit2 = chords2[count - 1] if count == most else reach * reach
            if gap * gap > limit2:
                break
            if not usable[j] or ranks[j] < ranks[i] or heights[j] < alike[0] * heights[i]:
                continue
            chord2 = apart2(units, i, j)
            if chord2 > limit2 or min(radii[i], radii[j]) < alike[1] * max(radii[i], radii[j]):
                continue
            k = count if count < most else most - 1
            while k > 0 and chords2[k - 1] > chord2:
                chords2[k] = chords2[k - 1]
                lists[i, k] = lists[i, k - 1]
                k -= 1
            chords2[k] = chord2
            lists[i, k] = j
            count = min(count + 1, most)
        counts[i] = count
    return Neighbours(lists, counts)


@compiled
def first_from(xs, x):
    """The first place in the ascending ``xs`` (n,) whose value is not below ``x``."""
    low, high = 0, xs.shape[0]
    while low < high:
        middle = (low + high) // 2
        if xs[middle] < x:
            low = middle + 1
        else:
            high = middle
    return low
