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
    order, xs = directions.order, directions.xs
    ys, zs = directions.units[order, 1], directions.units[order, 2]
    heights, radii, places = spots.heights[order], spots.radii[order], ranks[order]
    n = xs.shape[0]
    for place in range(n):
        if not spots.free[order[place]]:
            places[place] = -1  # before everybody's
    lists, counts = np.empty((n, most), np.int64), np.zeros(n, np.int64)
    chords2 = np.empty(most)
    for place in range(n):
        if places[place] < 0:
            continue
        x, y, z, rank, radius = xs[place], ys[place], zs[place], places[place], radii[place]
        least, row, count = alike[0] * heights[place], lists[order[place]], 0
        for side in range(2):
            step = 1 if side else -1
            at = place + step
            while 0 <= at < n:
                limit2 = chords2[count - 1] if count == most else reach * reach
                gap2 = (xs[at] - x) ** 2
                if gap2 > limit2:
                    break
                chord2 = gap2 + (ys[at] - y) ** 2 + (zs[at] - z) ** 2
                # All at once: the processor cannot guess what each of these says.
                likely = (places[at] > rank) & (heights[at] >= least) & (chord2 <= limit2)
                if likely and min(radius, radii[at]) >= alike[1] * max(radius, radii[at]):
                    count = _insert(order[at], chord2, count, row, chords2)
                at += step
        counts[order[place]] = count
    return Neighbours(lists, counts)


@compiled
def _insert(spot, chord2, count, row, chords2):
    """Put a spot among the nearest ``row`` (most,) by its squared chord, in place of the last where there is no room;
    returns how many there are then.
    """
    most = row.shape[0]
    k = count if count < most else most - 1
    while k > 0 and chords2[k - 1] > chord2:
        chords2[k] = chords2[k - 1]
        row[k] = row[k - 1]
        k -= 1
    chords2[k] = chord2
    row[k] = spot
    return min(count + 1, most)


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
