"""Robots matched to spots, what the matching hands to the solver, and the visible LEDs of one of them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.pose.fit import LEDS

LEAST_SIGMA_PX = 0.001  # no centre is known better than this


class Constellations(NamedTuple):
    """The LEDs of robots: ``layouts`` (robots, 6, 3) m in the plane's frame, and what shifts their spots, ``optics``
    (robots, OPTICS) as in `spot_shift`.
    """

    layouts: Floats
    optics: Floats


class Matched(NamedTuple):
    """Robots and their spots: ``robots`` (m,) rows of the `Constellations`; ``assignment`` (m, 6) rows of the spots, -1
    for LEDs not seen; ``rotations`` (m, 3, 3) and ``ts`` (m, 3) of T_camera_plane, m, as the matching found them.
    """

    robots: NDArray[np.int64]
    assignment: NDArray[np.int64]
    rotations: Floats
    ts: Floats

    @staticmethod
    def room(robots: int) -> "Matched":
        """Room for so many."""
        return Matched(
            np.empty(robots, np.int64),
            np.empty((robots, LEDS), np.int64),
            np.empty((robots, 3, 3)),
            np.empty((robots, 3)),
        )

    def first(self, robots: int) -> "Matched":
        """The first so many of them."""
        return Matched(self.robots[:robots], self.assignment[:robots], self.rotations[:robots], self.ts[:robots])


class Measured(NamedTuple):
    """The spots as they were measured: ``rays`` (n, 2) = (x / z, y / z) in the camera's frame, their ``covariances``
    (n, 3) xx, xy, yy, and the spots' ``centres_px`` (n, 2).
    """

    rays: Floats
    covariances: Floats
    centres_px: Floats


class Lit(NamedTuple):
    """The LEDs of one robot that are seen, k of them: ``points`` (k, 3) m in the plane's frame, about their mean;
    ``seen`` (k, 2) their rays without the shifts that are ``applied`` (k, 2); ``information`` (k, 3) xx, xy, yy.
    """

    points: Any
    seen: Any
    applied: Any
    information: Any


@compiled
def lit_room():
    """Room for all LEDs of a robot."""
    return Lit(np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 2)), np.empty((LEDS, 3)))


@compiled
def gather(layout, labels, measured, shifts, extra, focal, room, centre):
    """Fill the ``room`` (`Lit`) with a robot's visible LEDs and ``centre`` (3,) with their mean; how many they are.

    ``layout`` (6, 3) m; ``labels`` (6,) rows of the `Measured`, -1 for LEDs not seen; ``shifts`` (6, 2) to be taken off
    the rays; ``extra`` is added to every ray's variance; ``focal`` px.
    """
    points, seen, applied, information = room.points, room.seen, room.applied, room.information
    rays, covariances = measured.rays, measured.covariances
    count = 0
    centre[:] = 0.0
    floor = (LEAST_SIGMA_PX / focal) ** 2
    for led in range(LEDS):
        spot = labels[led]
        if spot < 0:
            continue
        points[count] = layout[led]
        centre += layout[led]
        for axis in range(2):
            applied[count, axis] = shifts[led, axis]
            seen[count, axis] = rays[spot, axis] - shifts[led, axis]
        xx, xy = covariances[spot, 0] + floor + extra, covariances[spot, 1]
        yy = covariances[spot, 2] + floor + extra
        det = xx * yy - xy * xy
        information[count, 0], information[count, 1], information[count, 2] = yy / det, -xy / det, xx / det
        count += 1
    centre /= count
    for k in range(count):
        points[k] -= centre
    return count


@compiled
def first(lit, count):
    """The first ``count`` of the visible LEDs."""
    return Lit(lit.points[:count], lit.seen[:count], lit.applied[:count], lit.information[:count])
