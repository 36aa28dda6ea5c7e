"""Centre of a spot as the centroid of its profile, clipped from below and above: the plainest estimator that holds.

x = sum(q x) / sum(q) with q the grey level above the local background, cut at a low level, so that noise and other
light far from the spot do not pull, and at a high one, so that the top, flat or saturated, adds none of its noise.
Source: thresholded centre of gravity, as in Thomas et al., "Comparison of centroid computation algorithms in a
Shack-Hartmann sensor", MNRAS 371 (2006); the covariance is first-order error propagation of q.
"""

import numpy as np

from asterism.server.centres.window import gather_pixels
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.pixels import COUNTS, GREY, PX, PY
from asterism.server.segmentation.spot_table import (
    HEIGHT,
    LEVEL,
    NOISE,
    SATURATED_SHARE,
    SLOPE_X,
    SLOPE_Y,
    WX0,
    WX1,
    WY0,
    WY1,
    X,
    Y,
)

CLIP = (0.05, 0.9)  # of the spot's height
CLIP_SIGMAS = 2.5  # and never so low that noise all over the window counts
PHASE_ERROR_PX = 0.0035  # what the sub-pixel phase leaves, measured on renderings of radius 1.5 to 6 px without noise
SATURATED_PHASE_ERROR_PX = 0.012  # and more where the top is cut off, by the share that is: steep flanks hit few pixels


@compiled_sums
def _add_up(pixels, n, spot, gain, sums):
    """Fill ``sums`` (9,): the clipped profile's light and first moments; its noise with first and second moments.

    ``pixels`` are those of `window.gather_pixels`. Only pixels between the two levels vary: noise moves the others
    along their clip level, where it changes nothing.
    """
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    level, slope_x, slope_y = spot[LEVEL], spot[SLOPE_X], spot[SLOPE_Y]
    read = spot[NOISE] * spot[NOISE]
    low, high = max(CLIP[0] * spot[HEIGHT], CLIP_SIGMAS * spot[NOISE]), CLIP[1] * spot[HEIGHT]
    s = sx = sy = v = vx = vy = vxx = vxy = vyy = 0.0
    for i in range(n):
        x, y, counted = xs[i], ys[i], counts[i]
        z = values[i] - (level + slope_x * x + slope_y * y)
        q = counted * max(min(z, high) - low, 0.0)
        variance = counted * (read + gain * z) if low < z < high else 0.0
        s += q
        sx += q * x
        sy += q * y
        v += variance
        vx += variance * x
        vy += variance * y
        vxx += variance * x * x
        vxy += variance * x * y
        vyy += variance * y * y
    sums[0], sums[1], sums[2] = s, sx, sy
    sums[3], sums[4], sums[5], sums[6], sums[7], sums[8] = v, vx, vy, vxx, vxy, vyy


@compiled
def fit_clip(image, spot, neighbours, gain, pixels, out):
    """The clipped centroid of one spot; arguments and ``out`` as in `edge_model.fit_edge_model`.

    The entries of ``out`` after the covariance are zero: this estimator does not tell of other light.
    """
    sums = np.empty(9)
    n = gather_pixels(image, spot, neighbours, pixels)
    _add_up(pixels, n, spot, gain, sums)
    out[:] = 0.0
    s = sums[0]
    if s <= 0.0:
        out[0], out[1], out[2], out[4] = spot[X], spot[Y], 1.0, 1.0
        return
    cx, cy = sums[1] / s, sums[2] / s
    out[0], out[1] = cx + 0.5 * (spot[WX0] + spot[WX1] - 1.0), cy + 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    phase2 = PHASE_ERROR_PX**2 + (SATURATED_PHASE_ERROR_PX * spot[SATURATED_SHARE]) ** 2
    # dx/dz = (x - cx) / s for every pixel that varies.
    out[2] = (sums[6] - 2.0 * cx * sums[4] + cx * cx * sums[3]) / (s * s) + phase2
    out[3] = (sums[7] - cx * sums[5] - cy * sums[4] + cx * cy * sums[3]) / (s * s)
    out[4] = (sums[8] - 2.0 * cy * sums[5] + cy * cy * sums[3]) / (s * s) + phase2
