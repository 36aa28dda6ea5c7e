"""How far off the rig has robots' LEDs, from what the spots say of them: a variance for each robot, by its evidence.

The spots tell the shape of a constellation and, of several robots, their sizes to each other; what they do not tell is
one size for all, which is off as the shape is. Robots are mostly measured alike: what the others' LEDs are off by is
likelier than any other value, but no more than that, since one may have been calibrated and the other not.
"""

import numpy as np

from asterism.protocol.geometry import Floats

SIGMAS_M = np.geomspace(2e-7, 5e-3, 80)  # that are tried
ALIKE, ALIKE_SPREAD = 3.0, 0.25  # odds that a robot is as the others are, and one sigma of the logarithm then


def misfit2_of(information: Floats, right: Floats, others2: Floats) -> float:
    """The variance of an LED's coordinate, m^2: its mean over all that may be; ``others2`` are those of other robots.

    ``information`` (n, n) and ``right`` (n,) are the normal equations of the LEDs' errors, by the spots alone, with
    all else eliminated. The likelihood of a variance v is that of errors N(0, v) which are seen with noise.
    """
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 0.0)
    along2 = (vectors.T @ right) ** 2
    variances = SIGMAS_M[:, None] ** 2
    logs = -0.5 * np.log1p(variances * values) + 0.5 * along2 * variances / (1.0 + variances * values)
    told = logs.sum(axis=1)
    before = np.full(len(SIGMAS_M), 1.0 / len(SIGMAS_M))
    for other2 in others2:
        bell = np.exp(-0.5 * (np.log(SIGMAS_M / np.sqrt(other2)) / ALIKE_SPREAD) ** 2)
        before += ALIKE / len(others2) * bell / bell.sum()
    weights = before * np.exp(told - told.max())
    return float((weights * SIGMAS_M**2).sum() / weights.sum())
