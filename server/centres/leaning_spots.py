"""Spots that other light leans on, centred anew together with that light."""

import math

import numpy as np

from asterism.server.centres.centre import GAIN
from asterism.server.centres.edge_steps import BLUR_PX
from asterism.server.centres.leaning import fit_leaning
from asterism.server.centres.near_spots import MOST_NEIGHBOURS, in_order, neighbours_of
from asterism.server.compiled import compiled
from asterism.server.segmentation.spot_table import ANGLE, MISFIT, SEMI_A, SEMI_B, SHOULDER

# The light beside a spot is no exact ellipse: by how much more than noise the centre scatters, variances, and where a
# third light was needed; then it is off by a share of how far it was moved, too. So rendered (see `own_light`).
LEANING_ERROR_PX = 0.003
INEXACT, THIRD_INEXACT, THIRD_MOVED = 1.9, 3.5, 0.3
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
def _take(out, centre, covariance):
    """Write the fit's ``out`` of a spot as its ``centre`` and ``covariance``."""
    doubt, inexact = (LEANING_ERROR_PX * out[5]) ** 2, INEXACT
    if out[6] > 2.0:
        doubt += THIRD_MOVED**2 * ((out[0] - centre[0]) ** 2 + (out[1] - centre[1]) ** 2)
        inexact = THIRD_INEXACT
    centre[0], centre[1] = out[0], out[1]
    covariance[0], covariance[1], covariance[2] = inexact * out[2] + doubt, inexact * out[3], inexact * out[4] + doubt


@compiled
def refine_leaning(image, spots, robots, centres, covariances):
    """Centre the spots anew that other light leans on, together with that light.

    ``robots`` (m, 6) are the rows of the spots of every robot's LEDs, -1 for those not seen.

    ``centres`` and ``covariances`` as `refine_centres` left them are changed where the fit succeeds, and the latter
    widened where nothing explains the spot; returns how many were changed.
    """
    changed = 0
    order, places, widest = in_order(spots)
    neighbours, apart = np.empty((MOST_NEIGHBOURS, 3)), np.empty((MOST_NEIGHBOURS, 3))
    other, out = np.empty(6), np.empty(7)
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
            _take(out, centres[k], covariances[k])
            changed += 1
        elif spot[MISFIT] > NO_SPOT:
            covariances[k, 0] += (ANYWHERE * spot[SEMI_A]) ** 2
            covariances[k, 2] += (ANYWHERE * spot[SEMI_A]) ** 2
            changed += 1
    return changed
