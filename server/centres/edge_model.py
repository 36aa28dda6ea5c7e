"""Centre of a spot by fitting a blurred ellipse to its pixels: the default estimator.

Model: grey level = plane + rise * Phi(d / blur), with d the signed distance of the pixel to the ellipse (positive
inside), Phi the normal distribution function and blur that of point spread and pixel together. d = (r - r^2) / |grad|,
with r = sqrt(u^2/a^2 + v^2/b^2) and grad half the gradient of r^2, is exact for circles, where the usual first-order
distance (1 - r^2) / (2 |grad|) leaves errors of 1 % of the rise. All start from the spot's moments, which alone tell
the angle; centre, slopes of the plane, its level, the rise, semi-axes and blur are refined by Fisher scoring, every
pixel weighted with its own variance (read noise plus shot noise).

An ellipse looks the same from both sides of its centre: what shifts it (centre, slopes) is odd, what does not (level,
rise, axes, blur) is even, and sums over odd times even terms vanish. So the parameters fall into two blocks, and the
centre's covariance needs the odd one only: it owns up to the slopes, and the rest costs it nothing. First both
are refined on the pixels near the edge; the last step, on all pixels, is the odd block's. Where the residuals say that
the model is not quite right, or where the top is cut off, the spot gets an even profile of its own (`even_profile`)
before that step is repeated, and the covariance is widened by how odd the rest is (`oddness`), not by how large.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.centres.edge_steps import BLUR_PX, improve_centre, improve_shape
from asterism.server.centres.edge_sums import (
    BASE,
    BLUR,
    CHI2,
    COUNT,
    CX,
    CY,
    LIT_1,
    LIT_2,
    LIT_FOUND,
    LIT_READ,
    PARAMETERS,
    RISE,
    SIDE_VARIANCE,
    SIDE_X,
    SIDE_Y,
    SIZE_A,
    SIZE_B,
    SUMS,
    SX,
    SY,
    Fitted,
    add_up_centre,
    add_up_shape,
    edge_rows,
)
from asterism.server.centres.even_profile import add_up_freed, even_room, lay_out, learn_profile, subtract_profile
from asterism.server.centres.oddness import Moved, Odd, judge, take_step
from asterism.server.centres.window import gather_near, gather_pixels
from asterism.server.compiled import compiled
from asterism.server.segmentation.pixels import room_for
from asterism.server.segmentation.spot_table import (
    ANGLE,
    HEIGHT,
    LEVEL,
    NOISE,
    SATURATED_SHARE,
    SEMI_A,
    SEMI_B,
    SLOPE_X,
    SLOPE_Y,
    WX0,
    WX1,
    WY0,
    WY1,
    X,
    Y,
)

# Where the fit starts, so that mostly one step of the shape suffices: by how much the moments find semi-axes too large,
# the least share of them, and a blur between those of the simulator and of the tests' renderings, as the fit finds it.
TOO_LARGE_PX, LEAST_SIZE, START_BLUR_PX = 0.28, 0.6, 0.9
SHAPE_STEPS = 6  # at most
# Where the top is cut off, rise and size are found from the flanks alone, and they should not follow the wings.
SATURATED_SHAPE_STEPS, LEAST_SATURATED_STEPS, SOFTNESS = 10, 4, 0.02
MANY_SATURATED = 0.05  # share of the spot's pixels
EVENNESS = 0.004  # of a spot's light: how uneven the model's own error leaves what is outside the ellipse, one sigma
LIT_PARAMETERS = 7.0  # that lit pixels determine; with a profile of the spot's own
LIT_PROFILE_PARAMETERS = 14.0
FREE_FROM = 1.3  # chi squared per degree of freedom from which on the spot gets a profile of its own
FREE_RAMP = 0.3  # more, from which on it counts in full


class EdgeRoom(NamedTuple):
    """Room for the fit of a spot: ``pixels`` of its window and those ``near`` its edge as in `pixels.room_for`,
    ``rows`` as in `edge_sums.edge_rows`, ``sums`` (SUMS,), the model's parameters ``p`` (PARAMETERS,), ``m`` (6, 5) and
    ``q`` (5,), a step of its shape, and `even_profile.EvenRoom`.
    """

    pixels: Any
    near: Any
    rows: Any
    sums: Any
    p: Any
    m: Any
    q: Any
    even: Any


class Freed(NamedTuple):
    """The odd block after its last step: the centre's information with the slopes eliminated, and whether it can be
    told; what is left, as `oddness.judge` tells it; the parameters that lit pixels have determined.
    """

    xx: float
    xy: float
    yy: float
    told: bool
    odd: Odd
    parameters: float


@compiled
def edge_room(cells):
    """Empty `EdgeRoom` for windows of so many pixels."""
    return EdgeRoom(
        room_for(cells),
        room_for(cells),
        edge_rows(),
        np.empty(SUMS),
        np.empty(PARAMETERS),
        np.empty((6, 5)),
        np.empty(5),
        even_room(cells),
    )


@compiled
def _start(spot, gain, p):
    """Fill ``p`` with what the moments say; the spot as `Fitted`."""
    saturated = spot[SATURATED_SHARE] > MANY_SATURATED
    p[CX], p[CY] = spot[X] - 0.5 * (spot[WX0] + spot[WX1] - 1.0), spot[Y] - 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    p[SX], p[SY] = spot[SLOPE_X], spot[SLOPE_Y]
    p[BASE] = spot[LEVEL] + p[SX] * p[CX] + p[SY] * p[CY]
    p[RISE], p[SIZE_A], p[SIZE_B], p[BLUR] = spot[HEIGHT], 1.0, 1.0, BLUR_PX
    a, b = spot[SEMI_A], spot[SEMI_B]
    if not saturated:
        p[SIZE_A], p[SIZE_B] = max(1.0 - TOO_LARGE_PX / a, LEAST_SIZE), max(1.0 - TOO_LARGE_PX / b, LEAST_SIZE)
        p[BLUR] = START_BLUR_PX
        # A Gaussian blur leaves a disc no more of its height in its middle.
        p[RISE] /= 1.0 - math.exp(-0.5 * a * b * p[SIZE_A] * p[SIZE_B] / (START_BLUR_PX * START_BLUR_PX))
    floor = spot[NOISE] * spot[NOISE] + 0.02
    softness = SOFTNESS if saturated else 0.0
    return Fitted(spot, math.cos(spot[ANGLE]), math.sin(spot[ANGLE]), floor, gain, softness)


@compiled
def _fit_shape(near, p, fitted, room):
    """Refine all parameters on the first ``near`` pixels, until steps are short."""
    saturated = fitted.softness > 0.0
    least = LEAST_SATURATED_STEPS if saturated else 1
    for trial in range(SATURATED_SHAPE_STEPS if saturated else SHAPE_STEPS):
        add_up_shape(room.near, near, p, fitted, trial > 0, room.rows, room.sums)
        improve_centre(room.sums, p)
        long = improve_shape(room.sums, p, fitted.spot[HEIGHT], room.m, room.q)
        if not long and trial + 1 >= least:
            break


@compiled
def _free(n, p, fitted, room):
    """Give the spot an even profile of its own, and step the odd block again, on all ``n`` pixels: `Freed`."""
    sums, even = room.sums, room.even
    lay_out(room.pixels, n, p, fitted, even.rows)
    turn, determined = learn_profile(even.rows, n, p[RISE], even)
    subtract_profile(even.rows, n, p, turn, even.score)
    add_up_freed(room.pixels, n, p, even.rows, sums)
    x, y, u, v = p[CX], p[CY], p[SX], p[SY]
    xx, xy, yy, told = improve_centre(sums, p)
    moved = Moved(p[CX] - x, p[CY] - y, p[SX] - u, p[SY] - v)
    take_step(room.pixels, n, p, moved, even.rows)
    odd = judge(even.rows, n, p, fitted.floor, determined, sums)
    return Freed(xx, xy, yy, told, odd, LIT_PROFILE_PARAMETERS)


@compiled
def fit_edge_model(image, spot, neighbours, gain, room, out):
    """Refine the centre of one spot.

    ``spot`` is a row of the spot table; ``neighbours`` (k, 3) the x, y and radius (px) of spots nearby; ``gain`` grey
    levels of variance per grey level of light; ``room`` an `EdgeRoom` for its window. ``out`` (14,) receives x, y, the
    covariance xx, xy, yy (px^2) for that gain, how far, in sigmas, the light outside the ellipse lies to one side
    (noise and a wrong shape leave it even, other light beside the spot does not), chi squared per degree of freedom
    (of what is not even, where that was large), what the residuals say of the sensor's gain, numerator and denominator,
    `oddness.Odd`'s chi squared and degrees of freedom, of the dipoles and of the finer harmonics, and how much they
    count, from 0 where the ellipse alone explains the spot to 1.
    """
    sums, p = room.sums, room.p
    near, n = gather_near(image, spot, neighbours, room.near), gather_pixels(image, spot, neighbours, room.pixels)
    fitted = _start(spot, gain, p)
    _fit_shape(near, p, fitted, room)
    # Away from the edge there is little to learn, but of other light: only the last step looks at it.
    add_up_centre(room.pixels, n, p, fitted, room.rows, sums)
    xx, xy, yy, told = improve_centre(sums, p)
    misfit = sums[CHI2] / max(sums[COUNT] - PARAMETERS, 1.0)
    fit = Freed(xx, xy, yy, told, Odd(misfit, 0.0, 0.0, 0.0, 0.0), LIT_PARAMETERS)
    share = 0.0
    if misfit > FREE_FROM or fitted.softness > 0.0:
        # From none to all of it, so that noise next to the limit makes no two verdicts.
        share = 1.0 if fitted.softness > 0.0 else min((misfit - FREE_FROM) / FREE_RAMP, 1.0)
        x, y = p[CX], p[CY]
        fit = _free(n, p, fitted, room)
        p[CX], p[CY] = x + share * (p[CX] - x), y + share * (p[CY] - y)
    det = fit.xx * fit.yy - fit.xy * fit.xy
    x, y = p[CX] + 0.5 * (spot[WX0] + spot[WX1] - 1.0), p[CY] + 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    a, b = spot[SEMI_A], spot[SEMI_B]
    if not fit.told or not det > 0.0 or math.hypot(x - spot[X], y - spot[Y]) > 1.0 + a:
        # No pixel tells where the edge is: the coarse centre, and what that may be worth.
        out[:] = 0.0
        out[0], out[1], out[2], out[4], out[6] = spot[X], spot[Y], a * a, a * a, 1.0
        return
    out[0], out[1] = x, y
    out[2], out[3], out[4] = fit.yy / det, -fit.xy / det, fit.xx / det
    usual = sums[SIDE_VARIANCE] + (EVENNESS * p[RISE] * math.pi * a * b) ** 2
    out[5] = math.sqrt((sums[SIDE_X] ** 2 + sums[SIDE_Y] ** 2) / max(usual, 1e-9))
    out[6] = fit.odd.misfit
    # Squared residuals grow with the light by the gain. The fit has taken some of them: as many as lit pixels
    # determine parameters, of the pixels that are lit.
    lit_pixels = sums[LIT_1] * sums[LIT_1] / max(sums[LIT_2], 1e-12)
    left = max(1.0 - fit.parameters / max(lit_pixels, 1e-9), 0.3)
    out[7], out[8] = sums[LIT_FOUND] / left - sums[LIT_READ], sums[LIT_2]
    out[9], out[10] = fit.odd.dipoles, fit.odd.dipoles_freedom
    out[11], out[12], out[13] = fit.odd.finer, fit.odd.finer_freedom, share
