"""Hypotheses of a search: which robot's LEDs which spots may be, with the pose that fits them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.pose.fit import CHI2, LEDS, SYSTEMATIC_PX, median_of
from asterism.server.pose.matched import Matched

Ints = NDArray[np.int64]

# Columns of a hypothesis beside its six spots (-1: not visible): robot, LEDs seen, cost in squared sigmas of
# SYSTEMATIC_PX, median height.
ROBOT, SEEN, COST, HEIGHT = range(4)

Found = tuple[int, Ints, Floats, Floats]  # robot, spots, rotation (3, 3) and translation (3,) of T_camera_plane


class Fits(NamedTuple):
    """Room for hypotheses: ``spots`` (m, 6), ``values`` (m, 4), ``rotations`` (m, 3, 3), ``ts`` (m, 3) of
    T_camera_plane; ``filled`` (1,) how many there are.
    """

    spots: Ints
    values: Floats
    rotations: Floats
    ts: Floats
    filled: Ints

    @staticmethod
    def room(most: int) -> "Fits":
        """Room for so many."""
        return Fits(
            np.empty((most, LEDS), np.int64),
            np.empty((most, 4)),
            np.empty((most, 3, 3)),
            np.empty((most, 3)),
            np.zeros(1, np.int64),
        )

    def held(self) -> "Fits":
        """Without the empty room."""
        n = int(self.filled[0])
        return Fits(self.spots[:n], self.values[:n], self.rotations[:n], self.ts[:n], self.filled)


@compiled
def keep(fits, labels, robot, count, cost, height, rotation, t):
    """Add a hypothesis, if it is new and there is room."""
    slot = fits.filled[0]
    for other in range(slot):
        if fits.values[other, ROBOT] == robot:
            same = True
            for led in range(LEDS):
                same &= fits.spots[other, led] == labels[led]
            if same:
                return False
    if slot == fits.spots.shape[0]:
        return False
    fits.spots[slot] = labels
    fits.values[slot, ROBOT], fits.values[slot, SEEN] = robot, count
    fits.values[slot, COST], fits.values[slot, HEIGHT] = cost, height
    fits.rotations[slot] = rotation
    fits.ts[slot] = t
    fits.filled[0] = slot + 1
    return True


def matched_of(found: Sequence[Found]) -> Matched:
    """Those robots as arrays."""
    matched = Matched.room(len(found))
    for k, (robot, labels, rotation, t) in enumerate(found):
        matched.robots[k], matched.assignment[k], matched.rotations[k], matched.ts[k] = robot, labels, rotation, t
    return matched


@compiled
def fill_worse(variances, fits, sigma_px, focal, worse):
    """Fill ``worse`` (m,): which `Fits` of six LEDs do not fit where all else is off by ``sigma_px``; whether any.

    ``variances`` (n,) are those of the spots.
    """
    some = False
    for k in range(worse.shape[0]):
        own = median_of(variances, fits.spots[k])
        cost_px2 = fits.values[k, COST] * SYSTEMATIC_PX**2
        worse[k] = cost_px2 > CHI2[LEDS] * (sigma_px**2 + own * focal**2)
        some |= worse[k]
    return some


@compiled
def medians_of(numbers, labels, medians):
    """Fill ``medians`` (m,) of the numbers (n,) of robots' spots, ``labels`` (m, 6), -1 for LEDs not visible."""
    for k in range(labels.shape[0]):
        medians[k] = median_of(numbers, labels[k])


@compiled
def rivals_of(heights, labels, ratio, medians, usable):
    """Mark the spots, ``usable`` (n,), that may show robots elsewhere: brighter than the dimmest of those that were
    found, and none of a robot's own but where that is much brighter than the robot.

    ``labels`` (m, 6) of the robots and their ``medians`` (m,) of ``heights`` (n,); ``ratio``: what is dimmer than that
    share of another is much dimmer. Returns how many usable spots are much brighter than the dimmest robot.
    """
    dimmest = medians.min()
    for spot in range(heights.shape[0]):
        usable[spot] = heights[spot] > dimmest
    for k in range(labels.shape[0]):
        for led in range(LEDS):
            spot = labels[k, led]
            if spot >= 0:
                # A mirror image may have caught one of the robot's own LEDs.
                usable[spot] = heights[spot] * ratio > medians[k]
    count = 0
    for spot in range(heights.shape[0]):
        count += usable[spot] and heights[spot] * ratio > dimmest
    return count
