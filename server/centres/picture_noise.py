"""How much noise a picture has beyond the sensor's, told by all its spots together: compression leaves errors.

JPEG and H.264 round whole blocks of frequencies: errors at a spot's edge that hang together over several pixels, so
that chi squared per pixel does not say how far the centre scatters. What does is the chi squared of the residuals' odd
harmonics (`oddness`): a shift is itself odd and about as smooth. Over its degrees of freedom (some 26 a spot) it is the
ratio of the centre's true variance to that of sensor noise, on average over spots: 1.6, 2.9, 12 at JPEG 95, 85, 60,
where centres scatter by 1.5, 2.6, 12 times their variance. All spots of a picture suffer alike, but for what else leans
on a few: the median is pooled, and shrunk to 1 as far as so few spots would show it by chance (James and Stein's
factor, 1 - error^2 / (ratio - 1)^2). Spots that the ellipse alone explains have a ratio of 1, so that clean pictures do
too.

Compression errors differ from spot to spot by more than chi squared does: their spread, from the median down to the
lower quartile (other light only raises), says what is still usual.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.spot_table import ANGLE, FATE, SEMI_A, SEMI_B, UNEXPLAINED

OUT = 14  # entries of what an estimator tells of a spot, as `edge_model.fit_edge_model`
LEAST_SPOTS = 5  # fewer do not tell the picture's noise from what leans on themselves
# Beyond this ratio, or where a quarter of the spots have less than this share of it, it is light on most spots
# (mirrors, lamps), not noise of the picture: JPEG 85 is 3.
NOISIEST, COMMON = 3.5, 0.6
ERROR = 0.35  # of the median of ratios, times the root of their number: 1.25 sqrt(2 / 26)
# From the median to the lower quartile chance takes a ratio by a fifth: what is more is the picture's unevenness.
USUAL_SPREAD, UNEVENNESS = 1.25, 2.0
LIKE = 0.15  # spots are of one shape whose semi-axes differ by no more, a share, and whose axes, rad
LONG = 1.2  # semi-axis over the other, from which on an ellipse's angle can be told
COMPANY = 3  # others of one shape: that of robots' LEDs, no accident


class PictureNoise(NamedTuple):
    """The centres' variance over what sensor noise makes it, at least 1; and how many times more than that is usual."""

    ratio: float
    uneven: float


@compiled
def picture_noise(spots, outs):
    """The noise that ``outs`` (n, OUT), as `edge_model.fit_edge_model` fills them, show in all ``spots`` together."""
    ratios = np.empty(spots.shape[0])
    count = 0
    for k in range(spots.shape[0]):
        if spots[k, FATE] == UNEXPLAINED:
            freedom = outs[k, 10] + outs[k, 12]
            ratio = (outs[k, 9] + outs[k, 11]) / freedom if freedom > 0.0 else 1.0
            ratios[count] = 1.0 + outs[k, 13] * (ratio - 1.0)
            count += 1
    if count < LEAST_SPOTS:
        return PictureNoise(1.0, 1.0)
    ratios = np.sort(ratios[:count])
    median, low = ratios[(count - 1) // 2], ratios[count // 4]
    excess = median - 1.0
    if excess <= 0.0 or median > NOISIEST or low < COMMON * median:
        return PictureNoise(1.0, 1.0)
    ratio = 1.0 + excess * max(1.0 - ERROR * ERROR / (count * excess * excess), 0.0)
    spread = max(median / max(low, 1e-9) / USUAL_SPREAD, 1.0)
    # A few spots tell no spread: none is then granted.
    return PictureNoise(ratio, min(spread, ratio) ** UNEVENNESS)


@compiled
def _alike(one, other):
    """Whether two spots are of one shape."""
    for axis in (SEMI_A, SEMI_B):
        if abs(one[axis] - other[axis]) > LIKE * max(one[axis], other[axis]):
            return False
    if one[SEMI_A] < LONG * one[SEMI_B]:
        return True
    # An axis has no direction.
    return abs(math.sin(one[ANGLE] - other[ANGLE])) < LIKE


@compiled
def accompanied(spots, outs, k):
    """Whether other spots share the shape of spot ``k``, and explain as little of their light by an ellipse.

    LEDs of one robot do that whose images are drawn out by its motion; two lights that run into one do not.
    """
    count = 0
    for i in range(spots.shape[0]):
        if i != k and spots[i, FATE] == UNEXPLAINED and outs[i, 6] > 0.5 * outs[k, 6] and _alike(spots[k], spots[i]):
            count += 1
    return count >= COMPANY
