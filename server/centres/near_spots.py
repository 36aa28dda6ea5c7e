"""The spots near another one: what is left out of its window, and what was split from it."""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.order import ascending
from asterism.server.segmentation.spot_table import (
    ANGLE,
    AT_EDGE,
    FATE,
    HEIGHT,
    SEMI_A,
    SEMI_B,
    TOO_FAINT,
    TOUCHING,
    X,
    Y,
)

NEIGHBOUR_REACH_PX = 9.0  # spots farther apart than this, edge to edge, do not disturb one another
MOST_NEIGHBOURS = 8
TOUCHING_PX = 4.0  # a spot that was split from another is fitted together with it if it is this near
LARGEST_LEANING = 3.0  # and not this many times larger: a lamp is no round Gaussian


@compiled
def in_order(spots):
    """For `neighbours_of`: rows of ``spots`` ordered by x, the place of every row there, the widest semi-axis."""
    order = ascending(spots[:, X])
    places = np.empty(spots.shape[0], np.int64)
    widest = 0.0
    for place in range(order.shape[0]):
        places[order[place]] = place
        widest = max(widest, spots[place, SEMI_A])
    return order, places, widest


@compiled
def neighbours_of(spots, order, place, widest, neighbours, other):
    """Fill ``neighbours`` (k, 3) x, y, radius px with the spots near the one at ``place``; return their count.

    ``other`` (6,) receives x, y, height, semi-axes and angle of the brightest of those that were split from it, if it
    is no lamp; its height is 0 where there is none.
    """
    n = order.shape[0]
    spot = spots[order[place]]
    count = 0
    other[:] = 0.0
    for direction in (-1, 1):
        step = place + direction
        while 0 <= step < n:
            near = spots[order[step]]
            if abs(near[X] - spot[X]) > spot[SEMI_A] + widest + NEIGHBOUR_REACH_PX:
                break
            away = math.hypot(near[X] - spot[X], near[Y] - spot[Y])
            gap = away - spot[SEMI_A] - near[SEMI_A]
            # What the spot lies in the middle of is its background, not its neighbour.
            # Neither are those whose extent is not known: cut off by the edge, or hardly there.
            bright = near[FATE] not in (TOO_FAINT, AT_EDGE)
            if bright and gap < NEIGHBOUR_REACH_PX and away > near[SEMI_A] and count < MOST_NEIGHBOURS:
                neighbours[count, 0], neighbours[count, 1], neighbours[count, 2] = (
                    near[X],
                    near[Y],
                    near[SEMI_A],
                )
                count += 1
                beside = spot[TOUCHING] > 0.0 and near[TOUCHING] > 0.0 and gap < TOUCHING_PX
                if beside and near[HEIGHT] > other[2] and near[SEMI_A] < LARGEST_LEANING * spot[SEMI_A]:
                    other[0], other[1], other[2], other[3] = near[X], near[Y], near[HEIGHT], near[SEMI_A]
                    other[4], other[5] = near[SEMI_B], near[ANGLE]
            step += direction
    return count
