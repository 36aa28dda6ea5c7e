"""A surface that light neither confirms nor denies counts less: its variance is raised to what is seen of it.

By as much as costs little where the surface is right all the same: one in twenty is seen beyond 2 sigma.
"""

import math

from asterism.server.compiled import compiled

DOUBTED, TILT_DOUBTED = (
    2.0,
    6.2,
)  # sigmas, and chi squared, of one right surface in twenty: from there on it counts less
COVER = 2.0  # what is seen beyond that is so many of the sigmas that the surface is given
LOSS = 0.1  # of the pose's variance that doubting a right surface may cost


@compiled
def _doubted(more, likely, light, bound):
    """How much of ``more`` variance a surface is given that is in doubt: what that costs where it is right all the
    same, the pull of light's error times how ``likely`` it is, is no more than LOSS of the pose's own, ``bound``.
    """
    lost = more * more * likely / light
    return more * min(1.0, LOSS * bound / lost) if lost > 0.0 else more


@compiled
def doubt(mean, together, variance, light):
    """What is to be added to the variance of a surface, m^2, that light saw off by ``mean``, ``together`` its variance,
    in the last frames; ``variance`` is the surface's own, ``light`` that of this frame.
    """
    more = (mean * mean - DOUBTED**2 * together) / COVER**2
    if more <= 0.0:
        return 0.0
    likely = math.exp(-0.5 * mean * mean / together)
    return _doubted(more, likely, light, variance * light / (variance + light))


@compiled
def doubt_tilt(tilted, tilt, variance):
    """The same, rad^2, of a normal that light's ``tilt`` denies by a chi squared of ``tilted``."""
    if tilted <= TILT_DOUBTED or not variance < math.inf:
        return 0.0
    light = tilt * tilt / tilted
    more = (1.0 - TILT_DOUBTED / tilted) * tilt * tilt / COVER**2
    return _doubted(more, math.exp(-0.5 * tilted), light, variance * light / (variance + light))
