"""Centre of a spot as its light's mean under a Gaussian weight as large as the spot: of LEDs that are no discs.

What an LED with chip and reflector cup shows has no one edge: a model of a disc settles on one part of it or another,
by the pixels' phase and the distance, and its centre scatters along the LED's axis by several times its noise. The mean
c under a weight g, sum g(x - c) (x - c) I(x) = 0, changes as smoothly as the image does. Far parts count little, which
keeps noise and other light out, and with g about as wide as the spot it is near the best that noise allows. Source:
windowed centroids, Bertin and Arnouts, "SExtractor", A&AS 117 (1996), XWIN_IMAGE; the width from the weighted moments
as adaptive ones have it (Bernstein and Jarvis, AJ 123, 2002): a Gaussian of variance S seen under a weight of variance
s has the variance m = 1 / (1 / S + 1 / s), and its mean is found S / s + 1 times as far off as the weighted mean says.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.centres.near_spots import MOST_NEIGHBOURS, in_order, neighbours_of
from asterism.server.centres.window import NEIGHBOUR_MARGIN_PX
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.spot_table import (
    LEVEL,
    SEMI_A,
    SLOPE_X,
    SLOPE_Y,
    WX0,
    WX1,
    WY0,
    WY1,
    X,
    Y,
)

# The weight's variance over that of the spot: a wider one lets noise in, a narrower one is surer of a part than of the
# whole. Of LEDs of six builds (tests/measure/offset.py) and of discs 1.25 times as wide is within 10 % of the best.
WIDER = 1.25**2
LEAST, MOST = 0.64, 36.0  # px^2, of a spot's variance: sharper is no lens, wider no LED
STEPS = 25
NEAR_ENOUGH = 1e-4  # px
FARTHEST = 0.5  # of the larger semi-axis, and one pixel, from where the spot was found


class Rises(NamedTuple):
    """A window's heights above its background ``grey`` (h, w), 0 where a neighbour is; its middle in the image, px."""

    grey: Any
    middle_x: float
    middle_y: float


@compiled
def _rises(image, spot, neighbours):
    """The `Rises` of a spot's window."""
    x0, x1, y0, y1 = int(spot[WX0]), int(spot[WX1]), int(spot[WY0]), int(spot[WY1])
    middle_x, middle_y = 0.5 * (x0 + x1 - 1), 0.5 * (y0 + y1 - 1)
    grey = np.empty((y1 - y0, x1 - x0))
    for y in range(y0, y1):
        for x in range(x0, x1):
            plane = spot[LEVEL] + spot[SLOPE_X] * (x - middle_x) + spot[SLOPE_Y] * (y - middle_y)
            grey[y - y0, x - x0] = image[y, x] - plane
            for near in neighbours:
                if math.hypot(x - near[0], y - near[1]) < near[2] + NEIGHBOUR_MARGIN_PX:
                    grey[y - y0, x - x0] = 0.0
    return Rises(grey, middle_x, middle_y)


@compiled_sums
def _row_sums(row, weights, places):
    """Sums of a row's weighted light and its first and second moments."""
    s = sx = sxx = 0.0
    for k in range(row.shape[0]):
        q = row[k] * weights[k]
        qx = q * places[k]
        s += q
        sx += qx
        sxx += qx * places[k]
    return s, sx, sxx


@compiled
def _moments(rises, x, y, variance, columns):
    """Weighted light, first moments about (x, y), told from the middle, and the mean of the second ones, px^2.

    ``columns`` (2, w) is room for every column's weight and place.
    """
    height, width = rises.grey.shape
    weights, places = columns[0], columns[1]
    for k in range(width):
        places[k] = k - 0.5 * (width - 1) - x
        weights[k] = math.exp(-0.5 * places[k] ** 2 / variance)
    s = sx = sy = second = 0.0
    for k in range(height):
        v = k - 0.5 * (height - 1) - y
        weight = math.exp(-0.5 * v * v / variance)
        row, row_x, row_xx = _row_sums(rises.grey[k], weights, places)
        s += weight * row
        sx += weight * row_x
        sy += weight * v * row
        second += weight * (row_xx + v * v * row)
    return s, sx, sy, 0.5 * second


@compiled
def _weighted_mean(rises, x, y, variance):
    """The weighted mean from a start (x, y) px, told from the middle, and a spot's variance; whether there is one."""
    columns = np.empty((2, rises.grey.shape[1]))
    weight = WIDER * min(max(variance, LEAST), MOST)
    for _ in range(STEPS):
        s, sx, sy, second = _moments(rises, x, y, weight, columns)
        if s <= 0.0 or second <= 0.0:
            return x, y, False
        spot = min(max(1.0 / max(s / second - 1.0 / weight, 1.0 / MOST), LEAST), MOST)
        far = (spot / weight + 1.0) / s
        x, y = x + far * sx, y + far * sy
        moved = far * (abs(sx) + abs(sy)) + abs(math.sqrt(WIDER * spot) - math.sqrt(weight))
        weight = WIDER * spot
        if moved < NEAR_ENOUGH:
            return x, y, True
    return x, y, True


@compiled
def weigh_spots(image, spots, robots, centres):
    """Centre spots anew by their light's weighted mean; returns how many.

    ``robots`` (m, 6) are the rows of the spots of every robot's LEDs in the spot table ``spots``, -1 for those not
    seen; ``centres`` (n, 2) px are changed where the mean lies in the spot.
    """
    changed = 0
    order, places, widest = in_order(spots)
    neighbours, other = np.empty((MOST_NEIGHBOURS, 3)), np.empty(6)
    for k in robots.ravel():
        if k < 0:
            continue
        spot = spots[k]
        count = neighbours_of(spots, order, places[k], widest, neighbours, other)
        rises = _rises(image, spot, neighbours[:count])
        x, y = centres[k, 0] - rises.middle_x, centres[k, 1] - rises.middle_y
        x, y, found = _weighted_mean(rises, x, y, 0.25 * spot[SEMI_A] ** 2 + LEAST)
        x, y = x + rises.middle_x, y + rises.middle_y
        if found and math.hypot(x - spot[X], y - spot[Y]) < FARTHEST * spot[SEMI_A] + 1.0:
            centres[k, 0], centres[k, 1] = x, y
            changed += 1
    return changed
