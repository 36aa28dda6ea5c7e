"""Spots that other light leans on, centred anew together with that light."""

import numpy as np

from asterism.server.centres.centre import GAIN
from asterism.server.centres.edge_steps import BLUR_PX
from asterism.server.centres.leaning import fit_leaning
from asterism.server.centres.near_spots import MOST_NEIGHBOURS, neighbours_of
from asterism.server.compiled import compiled
from asterism.server.segmentation.order import ascending
from asterism.server.segmentation.spot_table import MISFIT, SEMI_A, SHOULDER, X

LEANING_ERROR_PX = 0.003  # the light beside a spot is no exact ellipse
# Chi squared per degree of freedom beyond which a spot that two lights do not explain either is no LED's alone: its
# LED is somewhere in it, this share of its semi-axis off, one sigma.
NO_SPOT, ANYWHERE = 4.0, 0.5


@compiled
def refine_leaning(image, spots, rows, centres, covariances):
    """Centre the spots of ``rows`` that other light leans on anew, together with that light.

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
    for k in rows:
        spot = spots[k]
        if spot[SHOULDER] == 0.0:
            continue
        count = neighbours_of(spots, order, places[k], widest, neighbours, other)
        n_apart = 0
        for i in range(count):
            if neighbours[i, 0] != other[0] or neighbours[i, 1] != other[1]:
                apart[n_apart] = neighbours[i]
                n_apart += 1
        if fit_leaning(image, spot, other, apart[:n_apart], BLUR_PX, GAIN, out):
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
