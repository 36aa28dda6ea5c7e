"""How far off the rig has robots' LEDs, from what the spots say of them: a variance for each robot, by its evidence.

The spots tell the shape of a constellation and, of several robots, their sizes to each other; what they do not tell is
one size for all, which is off as the shape is.
"""

import numpy as np

from asterism.protocol.geometry import Floats

SIGMAS_M = np.geomspace(2e-7, 5e-3, 60)  # that are tried, all alike likely before


def misfit2_of(information: Floats, right: Floats) -> float:
    """The variance of an LED's coordinate, m^2: its mean over all that may be.

    ``information`` (18, 18) and ``right`` (18,) are the normal equations of the LEDs' errors, by the spots alone, with
    all else eliminated. The likelihood of a variance v is that of errors N(0, v) which are seen with noise.
    """
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 0.0)
    along2 = (vectors.T @ right) ** 2
    variances = SIGMAS_M[:, None] ** 2
    logs = -0.5 * np.log1p(variances * values) + 0.5 * along2 * variances / (1.0 + variances * values)
    told = logs.sum(axis=1)
    weights = np.exp(told - told.max())
    return float((weights * SIGMAS_M**2).sum() / weights.sum())
