"""From four spots to six: taken for four LEDs of a robot, they say where its other two are."""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.identity.neighbours import first_from
from asterism.server.pose.fit import LEDS

HEIGHT_RATIO, RADIUS_RATIO = 0.2, 0.4  # least ratio of heights and of radii among the spots of a robot
LEAST_DEPTH = 0.1  # of the four's: nothing is looked for nearer than that


class Four(NamedTuple):
    """Four ``spots`` (4,) taken for four LEDs, and then ``labels`` (6,), the spot of every LED, -1: none.

    ``frame`` (3, 3), axes of the plane in which the four are seen (`neighbours.touch`).
    """

    spots: Any
    labels: Any
    frame: Any


@compiled
def room_for_four():
    """Empty `Four`."""
    return Four(np.empty(4, np.int64), np.empty(LEDS, np.int64), np.empty((3, 3)))


class _Range(NamedTuple):
    """From the dimmest to the brightest, and from the smallest to the largest, of the four spots."""

    low: float
    high: float
    small: float
    large: float


@compiled
def _range(spots, four):
    """The `_Range` of the four."""
    low, high, small, large = np.inf, 0.0, np.inf, 0.0
    for m in range(4):
        height, radius = spots.heights[four.spots[m]], spots.radii[four.spots[m]]
        low, high = min(low, height), max(high, height)
        small, large = min(small, radius), max(large, radius)
    return _Range(low, high, small, large)


@compiled
def _is_like(spots, spot, those):
    """Whether a spot may be an LED of the robot whose four others are in that `_Range`."""
    height, radius = spots.heights[spot], spots.radii[spot]
    return (
        height >= HEIGHT_RATIO * those.high
        and those.low >= HEIGHT_RATIO * height
        and radius >= RADIUS_RATIO * those.large
        and those.small >= RADIUS_RATIO * radius
    )


@compiled
def _nearest_like(spots, directions, at, labels, those, reach):
    """The free spot like ``those`` nearest to the unit direction ``at``, within the chord ``reach``, that is no label
    yet; -1 if there is none.
    """
    units, order, xs = directions.units, directions.order, directions.xs
    best, best2 = -1, reach * reach
    place = first_from(xs, at[0] - reach)
    while place < xs.shape[0] and xs[place] <= at[0] + reach:
        spot = order[place]
        place += 1
        away2 = (units[spot, 0] - at[0]) ** 2 + (units[spot, 1] - at[1]) ** 2 + (units[spot, 2] - at[2]) ** 2
        if not (away2 < best2 and spots.free[spot]):
            continue
        taken = False
        for other in range(LEDS):
            taken |= labels[other] == spot
        if not taken and _is_like(spots, spot, those):
            best, best2 = spot, away2
    return best


@compiled
def complete(spots, directions, layout, leds, h, four, reach):
    """Take the four spots of ``four`` for the ``leds`` (4,) of a robot with that ``layout`` (6, 3), and look for its
    other two within the chord ``reach`` of where the map ``h`` (3, 3) from the plate to their plane puts them.

    ``spots`` are `Spots`, with their `Directions`. Fills the labels of ``four`` and returns how many LEDs then have a
    spot (0: these four cannot be).
    """
    labels, frame, those = four.labels, four.frame, _range(spots, four)
    if those.small < RADIUS_RATIO * those.large:
        return 0
    labels[:] = -1
    for m in range(4):
        labels[leds[m]] = four.spots[m]
    found = 4
    for led in range(LEDS):
        if labels[led] >= 0:
            continue
        x, y = layout[led, 0], layout[led, 1]
        w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        if w < LEAST_DEPTH:
            continue
        u, v = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w, (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
        length = math.sqrt(u * u + v * v + 1.0)
        at = (
            (u * frame[0, 0] + v * frame[1, 0] + frame[2, 0]) / length,
            (u * frame[0, 1] + v * frame[1, 1] + frame[2, 1]) / length,
            (u * frame[0, 2] + v * frame[1, 2] + frame[2, 2]) / length,
        )
        labels[led] = _nearest_like(spots, directions, at, labels, those, reach)
        found += int(labels[led] >= 0)
    return found
