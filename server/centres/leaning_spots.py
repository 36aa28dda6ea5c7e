"""Spots that other light leans on, centred anew together with that light."""

import math

import numpy as np

from asterism.server.centres.centre import GAIN
from asterism.server.centres.edge_steps import BLUR_PX
from asterism.server.centres.leaning import fit_leaning
from asterism.server.centres.near_spots import MOST_NEIGHBOURS, neighbours_of
from asterism.server.compiled import compiled
from asterism.server.segmentation.order import ascending
from asterism.server.segmentation.spot_table import ANGLE, MISFIT, SEMI_A, SEMI_B, SHOULDER, X

LEANING_ERROR_PX = 0.003  # the light beside a spot is no exact ellipse
# How well the semi-axes of an LED's spot are known, shares: from others of the robot; from its own moments.
LIKE_SHAPE, UNKNOWN_SHAPE = 0.06, 0.3
# Chi squared per degree of freedom beyond which a spot that two lights do not explain either is no LED's alone: its
# LED is somewhere in it, this share of its semi-axis off, one sigma.
NO_SPOT, ANYWHERE = 4.0, 0.5


@compiled
def _shape_of(spots, rows, spot, shape):
    """Fill ``shape`` (4,) with what the LEDs of a robot look like whose spots are ``rows`` (6,): the mean of those that
    no other light leans on, or the ``spot`` itself.
    """
    count = 0
    shape[:] = 0.0
    for k in rows:
        if k < 0 or spots[k, SHOULDER] > 0.0:
            continue
        count += 1
        shape[0] += spots[k, SEMI_A]
        shape[1] += spots[k, SEMI_B]
        # Axes have no direction: their angle doubled has.
        shape[2] += math.cos(2.0 * spots[k, ANGLE])
        shape[3] += math.sin(2.0 * spots[k, ANGLE])
    if count == 0:
        shape[0], shape[1], shape[2], shape[3] = spot[SEMI_A], spot[SEMI_B], spot[ANGLE], UNKNOWN_SHAPE
        return
    shape[0], shape[1] = shape[0] / count, shape[1] / count
    shape[2], shape[3] = 0.5 * math.atan2(shape[3], shape[2]), LIKE_SHAPE


@compiled
def refine_leaning(image, spots, robots, centres, covariances):
    """Centre the spots anew that other light leans on, together with that light.

    ``robots`` (m, 6) are the rows of the spots of every robot's LEDs, -1 for those not seen.

    ``centres`` and ``covariances`` as `refine_centres` left them are changed where the fit succeeds, and the latter
    widened where nothing explains the spot; returns how many were changed.
    """
    changed = 0
    order = ascending(spots[:, X])
    places = np.empty(spots.shape[0], np.int64)
    widest = 0.0
    for place in range(order.shape[0]):
        places[order[place]] = place
        widest = max(widest, spots[place, SEMI_A])
    neighbours, apart = np.empty((MOST_NEIGHBOURS, 3)), np.empty((MOST_NEIGHBOURS, 3))
    other, out = np.empty(6), np.empty(6)
    shape = np.empty(4)
    for place in range(robots.size):
        rows = robots[place // robots.shape[1]]
        k = rows[place % robots.shape[1]]
        if k < 0 or spots[k, SHOULDER] == 0.0:
            continue
        spot = spots[k]
        _shape_of(spots, rows, spot, shape)
        count = neighbours_of(spots, order, places[k], widest, neighbours, other)
        n_apart = 0
        for i in range(count):
            if neighbours[i, 0] != other[0] or neighbours[i, 1] != other[1]:
                apart[n_apart] = neighbours[i]
                n_apart += 1
        if fit_leaning(image, spot, other, apart[:n_apart], shape, BLUR_PX, GAIN, out):
            centres[k, 0], centres[k, 1] = out[0], out[1]
            covariances[k, 0] = out[2] + (LEANING_ERROR_PX * out[5]) ** 2
            covariances[k, 1] = out[3]
            covariances[k, 2] = out[4] + (LEANING_ERROR_PX * out[5]) ** 2
            changed += 1
        elif spot[MISFIT] > NO_SPOT:
            covariances[k, 0] += (ANYWHERE * spot[SEMI_A]) ** 2
            covariances[k, 2] += (ANYWHERE * spot[SEMI_A]) ** 2
            changed += 1
    return changed
