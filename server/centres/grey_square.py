"""Centre of a spot as the grey-square-weighted mean of its bilinearly interpolated pixels: the thesis' estimator.

x = sum(z^2 x) / sum(z^2) over the points of a four times finer grid at which z, the grey level above the local
background, exceeds 30 % of the spot's height. Squaring favours the middle of the spot, where the signal is best.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.spot_table import (
    HEIGHT,
    LEVEL,
    NOISE,
    SLOPE_X,
    SLOPE_Y,
    WX0,
    WX1,
    WY0,
    WY1,
    X,
    Y,
)

FINER = 4
THRESHOLD = 0.3
PHASE_ERROR_PX = 0.006  # what the threshold's crossing of pixels leaves, measured over sub-pixel phases


@compiled
def fit_grey_square(image, spot, neighbours, gain, out):
    """The grey-square centre of one spot; arguments and ``out`` as in `edge_model.fit_edge_model`.

    The covariance is that of the weighted mean under the pixels' own noise, plus the error of the sub-pixel phase.
    The entries of ``out`` after it are zero: this estimator does not tell of other light.
    """
    height, width = image.shape
    x0, x1 = max(int(spot[WX0]), 0), min(int(spot[WX1]), width)
    y0, y1 = max(int(spot[WY0]), 0), min(int(spot[WY1]), height)
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    rows, cols = y1 - y0, x1 - x0
    z = np.empty((rows, cols))
    for i in range(rows):
        for j in range(cols):
            x, y = x0 + j, y0 + i
            plane = spot[LEVEL] + spot[SLOPE_X] * (x - middle_x) + spot[SLOPE_Y] * (y - middle_y)
            z[i, j] = image[y, x] - plane
            mine = (x - spot[X]) ** 2 + (y - spot[Y]) ** 2
            for k in range(neighbours.shape[0]):
                away = math.sqrt((x - neighbours[k, 0]) ** 2 + (y - neighbours[k, 1]) ** 2) - neighbours[k, 2]
                if away < 1.0 and mine > away * away:
                    z[i, j] = 0.0
    limit = THRESHOLD * spot[HEIGHT]
    s = sx = sy = 0.0
    for i in range((rows - 1) * FINER + 1):
        y = i / FINER
        i0 = min(int(y), rows - 2)
        fy = y - i0
        for j in range((cols - 1) * FINER + 1):
            x = j / FINER
            j0 = min(int(x), cols - 2)
            fx = x - j0
            upper = z[i0, j0] + fx * (z[i0, j0 + 1] - z[i0, j0])
            lower = z[i0 + 1, j0] + fx * (z[i0 + 1, j0 + 1] - z[i0 + 1, j0])
            value = upper + fy * (lower - upper)
            if value > limit:
                s += value * value
                sx += value * value * x
                sy += value * value * y
    out[:] = 0.0
    if s <= 0.0:
        out[0], out[1], out[2], out[4] = spot[X], spot[Y], 1.0, 1.0
        return
    cx, cy = sx / s, sy / s
    total = vxx = vxy = vyy = 0.0
    for i in range(rows):
        for j in range(cols):
            if z[i, j] > limit:
                variance = spot[NOISE] ** 2 + gain * z[i, j]
                pull = 4.0 * z[i, j] ** 2 * variance
                total += z[i, j] ** 2
                vxx += pull * (j - cx) ** 2
                vxy += pull * (j - cx) * (i - cy)
                vyy += pull * (i - cy) ** 2
    total = max(total, 1e-9)
    out[0], out[1] = x0 + cx, y0 + cy
    out[2] = vxx / total**2 + PHASE_ERROR_PX**2
    out[3] = vxy / total**2
    out[4] = vyy / total**2 + PHASE_ERROR_PX**2
