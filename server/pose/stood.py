"""What light alone says of robots that stand on the surface, and what is found of how they stand (`standing`)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.pose.choose import Choices
from asterism.server.pose.fit import LEDS
from asterism.server.pose.matched import Constellations, Measured
from asterism.server.pose.solve import Solutions

NOWHERE, ON_SURFACE, LIFTED, SUNK, TILTED, BEYOND = range(6)  # NOWHERE: the rig does not have it stand, or it is lost
OFF, OFF_SIGMA, TILT, TILT_SIGMA = range(4)  # columns of `Stood.offs`


class Alone(NamedTuple):
    """What light alone says of m robots, as `solve.solve_robots` and `choose.choose` left it; with the covariances
    ``commons`` (m, 3) of rays that their spots share, ``terms`` (m, 6, 6) of their planes' poses that no spot shows,
    and ``moves`` (m, 3) m, what light is known to have them off by: to be added. All in the camera's frame.
    """

    lens: Floats
    constellations: Constellations
    measured: Measured
    solutions: Solutions
    choices: Choices
    commons: Floats
    terms: Floats
    moves: Floats


class Stood(NamedTuple):
    """How m robots stand: ``standing`` (m,) by the numbers above; ``offs`` (m, 4): how far off the surface light has
    them, m and rad, with sigmas. Of those ON_SURFACE, in the parent frame as `Choices`: ``odds``, ``positions``,
    ``quaternions``, ``covariances``; ``by_spots`` (m, 6, 6), the part of these that comes from single spots' errors;
    ``residuals`` (m, 6, 2) px.
    """

    standing: NDArray[np.int64]
    offs: Floats
    odds: Floats
    positions: Floats
    quaternions: Floats
    covariances: Floats
    by_spots: Floats
    residuals: Floats

    @staticmethod
    def room(robots: int) -> "Stood":
        """Room for so many robots."""
        m = robots
        return Stood(
            np.zeros(m, np.int64), np.full((m, 4), np.nan), np.empty(m), np.zeros((m, 2, 3)), np.zeros((m, 2, 4)),
            np.empty((m, 6, 6)), np.empty((m, 6, 6)), np.empty((m, LEDS, 2)),
        )  # fmt: skip
