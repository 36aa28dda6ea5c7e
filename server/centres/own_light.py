"""How far light that leans on a single LED, and differently on the others of its robot, may have moved its centre.

Two things beside a spot tell of it. A ring at the foot of its profile has a dipole (`common_light`), that would move
the centre by c if the light went on as it is under the spot: what of c is neither the robot's in common nor noise. And
the surroundings are rougher than elsewhere in the picture: texture, the edges of lamps and plates in a polished floor.
Light that varies by t grey levels RMS, over lengths like the spot's own size, has a dipole of about t at its edge, and
moves the centre by up to t sqrt(2 pi) blur / HEIGHT. What goes on under the spot is not seen; the shift is a share of
these, for a spot that was centred alone and for one that was centred together with what leans on it (`leaning_spots`),
which explains the dipole, but takes texture for lights. These shares are those that make squared errors what
covariances say over rendered spots of 2 to 4.5 px and 60 to 200 grey: mirror images, whole and cut off, at 0.5 to 3.2
radii and of 3 to 60 % of the light, glows of 1 to 40 %, edges and strips of 2 to 60 grey, texture of 0.5 to 15 grey
over 1.2 to 6 px, and mixtures. Clean spots are widened by 3 %, by chance.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.server.centres.edge_steps import BLUR_PX
from asterism.server.compiled import compiled
from asterism.server.segmentation.spot_table import FATE, HEIGHT, LEVEL, NOISE, SHOULDER, UNEXPLAINED

ALONE_RING, ALONE_ROUGH = 1.1, 0.83  # shares, of a spot that was centred alone
TOGETHER_ROUGH = 1.25  # and of one that was centred together with what leans on it
RING_EXCESS = 8.0  # squared length over the variance along an axis, up to which a ring's dipole is noise
# Variance over that of usual surroundings, up to which these are no rougher. Slight compression makes surroundings
# uneven: where the median is more than so many times the lower quartile, as many times more is usual.
ROUGH_EXCESS, UNEVEN = 1.8, 1.3
SHOT = 0.035  # variance per grey level by which brighter surroundings may be noisier
LEAST_VARIANCE = 0.1  # of surroundings: rounding


class Ring(NamedTuple):
    """By how much the dipole of a spot's ring would move its centre, px; its variance along an axis, px^2; whether
    there is enough of a ring to tell.
    """

    x: float
    y: float
    variance: float
    is_told: bool


@compiled
def usual_surroundings(spots):
    """The variance of the surroundings of a picture's ``spots``, at grey level 0: the median, and up to how many times
    as much is usual.
    """
    floors = np.empty(spots.shape[0])
    count = 0
    for k in range(spots.shape[0]):
        if spots[k, FATE] == UNEXPLAINED:
            floors[count] = spots[k, NOISE] ** 2 - SHOT * spots[k, LEVEL]
            count += 1
    if count == 0:
        return 0.0, ROUGH_EXCESS
    floors = np.sort(floors[:count])
    median, quarter = floors[(count - 1) // 2], floors[count // 4]
    uneven = max(median, LEAST_VARIANCE) / (UNEVEN * max(quarter, LEAST_VARIANCE))
    return median, ROUGH_EXCESS * max(uneven, 1.0)


@compiled
def widen(spot, ring, floor, excess, covariance):
    """Widen the ``covariance`` (3,) xx, xy, yy px^2 of a spot by what leans on it alone; whether there is any.

    ``spot`` is its row of the spot table, ``ring`` (3,) the shift x, y, px, that its ring tells, its robot's common one
    subtracted, and its variance; ``floor`` and ``excess`` as `usual_surroundings` tells them.
    """
    usual = max(floor + SHOT * spot[LEVEL], LEAST_VARIANCE)
    rough = max(spot[NOISE] ** 2 - excess * usual, 0.0)
    rough *= 2.0 * math.pi * (BLUR_PX / spot[HEIGHT]) ** 2
    if spot[SHOULDER] ** 2 > covariance[0]:
        more = TOGETHER_ROUGH**2 * rough
    else:
        aside = max(ring[0] ** 2 + ring[1] ** 2 - RING_EXCESS * ring[2], 0.0)
        more = ALONE_RING**2 * aside + ALONE_ROUGH**2 * rough
    covariance[0] += more
    covariance[2] += more
    return more > 0.0
