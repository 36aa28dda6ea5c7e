"""The spots that are searched, and which are near which: lists of nearest neighbours, and the spot at a place."""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.segmentation.order import ascending


class Spots(NamedTuple):
    """What is searched. ``flat`` (n, 2) ideal px, y up; ``rays`` (n, 2) the same as x / z, y / z (y down);
    ``variances`` (n,) of the rays; ``heights`` (n,); ``radii`` (n,) px; ``free`` (n,): not yet a robot's.
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


@compiled
def nearest_neighbours(spots, ranks, reaches, least_height, least_radius, most):
    """The `Neighbours` of all free `Spots`: up to ``most`` free ones that rank after the spot and are like it.

    ``ranks`` (n,) are different numbers; a neighbour is at most ``reaches`` (n,) px away, its height at least
    ``least_height`` of the spot's, of the two radii the smaller at least ``least_radius`` of the larger.
    """
    flat, usable, heights, radii = spots.flat, spots.free, spots.heights, spots.radii
    n = flat.shape[0]
    lists, counts = np.empty((n, most), np.int32), np.zeros(n, np.int32)
    order = ascending(flat[:, 0])
    distances = np.empty(most)
    for place in range(n):
        i = order[place]
        counts[i] = 0
        if not usable[i]:
            continue
        count = 0
        left, right = place - 1, place + 1
        while left >= 0 or right < n:
            # The next candidate by horizontal distance, from either side.
            gap_left = flat[i, 0] - flat[order[left], 0] if left >= 0 else np.inf
            gap_right = flat[order[right], 0] - flat[i, 0] if right < n else np.inf
            if gap_left <= gap_right:
                j, gap = order[left], gap_left
                left -= 1
            else:
                j, gap = order[right], gap_right
                right += 1
            limit = distances[count - 1] if count == most else reaches[i]
            if gap > limit:
                break
            if not usable[j] or ranks[j] < ranks[i] or heights[j] < least_height * heights[i]:
                continue
            if min(radii[i], radii[j]) < least_radius * max(radii[i], radii[j]):
                continue
            distance = math.hypot(flat[j, 0] - flat[i, 0], flat[j, 1] - flat[i, 1])
            if distance > limit:
                continue
            k = count if count < most else most - 1
            while k > 0 and distances[k - 1] > distance:
                distances[k] = distances[k - 1]
                lists[i, k] = lists[i, k - 1]
                k -= 1
            distances[k] = distance
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
