"""What the spots of a compressed picture are off by beyond what they tell, from the residuals of all its robots.

H.264 draws a block from the picture before, moved by whole quarters of a pixel, and rounds what is left of the
difference away: a spot is then perfect, but off by up to an eighth of a pixel. Its own pixels do not say so; errors of
a robot's LEDs, which lie in different blocks, are independent, and leave residuals against its rigid constellation.
Six residuals of one robot say little of a variance, all robots of the picture more. Of a robot with n spots 2 n
residuals keep 2 n - 6 degrees of freedom, so that what every spot has beyond its own variance v is

    s^2 = sum over robots (sum r^2 - (2 n - 6) mean v) / sum over robots (2 n - 6).
"""

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.solve import Solutions

POSE = 6  # degrees of freedom that a pose takes


def common_noise(solutions: Solutions, assignment: NDArray[np.int64], covariances: Floats) -> float:
    """Variance, px^2, of a coordinate that every spot has beyond its own: 0 or more.

    ``assignment`` (m, 6) are the rows in ``covariances`` (n, 3) px^2 of the spots of the m robots' LEDs, -1 for those
    not seen.
    """
    beyond = freedom = 0.0
    for k in range(len(assignment)):
        which = int(np.argmin(solutions.costs[k]))
        rows = assignment[k][assignment[k] >= 0]
        if solutions.costs[k, which] >= NO_SOLUTION or 2 * len(rows) <= POSE:
            continue
        free = 2 * len(rows) - POSE
        beyond += float(np.sum(np.square(solutions.residuals[k, which]))) - free * float(
            np.mean(covariances[rows][:, ::2])
        )
        freedom += free
    return max(beyond / freedom, 0.0) if freedom > 0.0 else 0.0
