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
are refined on the pixels near the edge; the last step, on all pixels, is the odd block's.

Sums over pixels are the bulk of the time: they are taken in single precision, whose rounding moves a centre by less
than 1e-5 px, over pixels padded to whole registers.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.centres.blurred_ellipse import REACH32, distance_to_ellipse, normal
from asterism.server.centres.window import gather_pixels
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.pose.planar import cholesky_solve
from asterism.server.segmentation.pixels import COUNTS, GREY, HALF, LANES, ONE, PX, PY, TWO, ZERO, f32, room_for
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

BLUR_PX = 0.85  # expected blur; the fit finds the spot's own
BLUR_SIGMA = 0.15  # how far the fit may go from the expected blur and from the size that the moments say, softly
SIZE_SIGMA = 0.1
# Where the fit starts, so that mostly one step of the shape suffices: by how much the moments find semi-axes too large,
# the least share of them, and a blur between those of the simulator and of the tests' renderings, as the fit finds it.
TOO_LARGE_PX, LEAST_SIZE, START_BLUR_PX = 0.28, 0.6, 0.9
LONG_STEP = 0.06, 0.1, 0.1  # of log size, blur (px) and rise (share), after which another step is needed
SHAPE_STEPS = 3  # at most
SATURATED_SHAPE_STEPS = 6  # where the top is cut off, rise and size are found from the flanks alone
MANY_SATURATED = 0.05  # share of the spot's pixels
LONGEST_STEP_PX = 0.7
EVENNESS = 0.004  # of a spot's light: how uneven the model's own error leaves what is outside the ellipse, one sigma
MODEL_ERROR = 0.05  # of the rise: how far the model may be off without anything being wrong
STRANGE_LIGHT = 3.0  # sigmas above the model beyond which a pixel's light is somebody else's
OUTSIDE = -1.0  # sigmas of blur from the edge, from where on light counts as beside the spot
SATURATED = 255.0

CX, CY, SX, SY, BASE, RISE, SIZE_A, SIZE_B, BLUR = range(9)
PARAMETERS = 9
LIT_PARAMETERS = 7.0  # of them, those that lit pixels determine

# Sums over the pixels. M_: information of the even block (level, rise, log a, log b, blur), Q_: its score; N_: of the
# odd block (x, y, slopes u, v), R_: its score.
(
    N_XX, N_XY, N_YY, R_X, R_Y,
    M_LL, M_LR, M_LA, M_LB, M_LW, M_RR, M_RA, M_RB, M_RW, M_AA, M_AB, M_AW, M_BB, M_BW, M_WW, Q_L, Q_R, Q_A, Q_B, Q_W,
    N_XU, N_XV, N_YU, N_YV, N_UU, N_UV, N_VV, R_U, R_V,
    CHI2, COUNT, SIDE_X, SIDE_Y, SIDE_VARIANCE, LIT_1, LIT_2, LIT_READ, LIT_FOUND,
) = range(43)  # fmt: skip
SUMS = 43

OUTSIDE32 = f32(OUTSIDE)
CEILING, NEAR_CEILING = f32(SATURATED), f32(SATURATED - 3.0)


class Fitted(NamedTuple):
    """The spot that is fitted: its row ``spot`` of the spot table; ``cos`` and ``sin`` of its angle; ``floor`` and
    ``gain`` make the pixels' variances, floor + gain * light.
    """

    spot: Any
    cos: float
    sin: float
    floor: float
    gain: float


class EdgeRoom(NamedTuple):
    """Room for the fit of a spot: ``pixels`` of its window as in `pixels.room_for`, ``sums`` (SUMS,), the model's
    parameters ``p`` (PARAMETERS,), and ``m`` (5, 5) and ``q`` (5,), a step of its shape.
    """

    pixels: Any
    sums: Any
    p: Any
    m: Any
    q: Any


@compiled
def edge_room(cells):
    """Empty `EdgeRoom` for windows of so many pixels."""
    return EdgeRoom(room_for(cells), np.empty(SUMS), np.empty(PARAMETERS), np.empty((5, 5)), np.empty(5))


@compiled_sums
def _weight(value, told, variance, counts, loose, limit):
    """Weight of a pixel's residual: none beyond the sensor's ceiling, none with more light than the model can be wrong
    by (``loose``, a variance) and ``limit`` (squared sigmas) allow.
    """
    residual = value - told
    # Beyond the ceiling a pixel says no more than the model does.
    cut = value >= CEILING and told >= NEAR_CEILING
    odd = residual > ZERO and residual * residual > limit * (variance + loose)
    return ZERO if cut or odd else counts / variance


@compiled_sums
def add_up_shape(pixels, n, p, fitted, strange, sums):
    """Information and score of the even and of the odd block over the first ``n`` of ``pixels``.

    ``p`` (PARAMETERS,) are the model's; ``strange``: leave out pixels with more light than the model can be wrong by.
    Fills M_, Q_, N_ and R_ of ``sums`` (SUMS,).
    """
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    cx, cy, slope_x, slope_y = f32(p[CX]), f32(p[CY]), f32(p[SX]), f32(p[SY])
    level, rise, per_blur = f32(p[BASE]), f32(p[RISE]), f32(1.0 / p[BLUR])
    spot = fitted.spot
    a, b = spot[SEMI_A] * p[SIZE_A], spot[SEMI_B] * p[SIZE_B]
    per_a2, per_b2 = f32(1.0 / (a * a)), f32(1.0 / (b * b))
    cos, sin = f32(fitted.cos), f32(fitted.sin)
    floor, gain, loose = f32(fitted.floor), f32(fitted.gain), f32((MODEL_ERROR * p[RISE]) ** 2)
    limit = f32(STRANGE_LIGHT * STRANGE_LIGHT if strange else 1e18)
    n_xx = n_xy = n_yy = n_xu = n_xv = n_yu = n_yv = n_uu = n_uv = n_vv = r_x = r_y = r_u = r_v = ZERO
    m_ll = m_lr = m_la = m_lb = m_lw = m_rr = m_ra = m_rb = m_rw = m_aa = m_ab = m_aw = m_bb = m_bw = m_ww = ZERO
    q_l = q_r = q_a = q_b = q_w = ZERO
    for i in range(n // LANES * LANES):
        dx, dy = xs[i] - cx, ys[i] - cy
        u, v, pu, pv, distance, outward, bend = distance_to_ellipse(dx, dy, cos, sin, per_a2, per_b2)
        t = min(max(distance * per_blur, -REACH32), REACH32)
        step, bell = normal(t)
        lit = rise * step
        told = level + slope_x * dx + slope_y * dy + lit
        w = _weight(values[i], told, floor + gain * lit, counts[i], loose, limit)
        residual = values[i] - told
        steep = rise * bell * per_blur
        du, dv = pu * (outward - bend * per_a2), pv * (outward - bend * per_b2)
        gx, gy = steep * (dv * sin - du * cos), -steep * (du * sin + dv * cos)
        ga = steep * pu * (TWO * bend * pu - outward * u)
        gb = steep * pv * (TWO * bend * pv - outward * v)
        gw = -steep * t
        wx, wy, wu, wv = w * gx, w * gy, w * dx, w * dy
        wr, wa, wb, ww = w * step, w * ga, w * gb, w * gw
        n_xx += wx * gx
        n_xy += wx * gy
        n_yy += wy * gy
        n_xu += wx * dx
        n_xv += wx * dy
        n_yu += wy * dx
        n_yv += wy * dy
        n_uu += wu * dx
        n_uv += wu * dy
        n_vv += wv * dy
        r_x += wx * residual
        r_y += wy * residual
        r_u += wu * residual
        r_v += wv * residual
        m_ll += w
        m_lr += wr
        m_la += wa
        m_lb += wb
        m_lw += ww
        m_rr += wr * step
        m_ra += wr * ga
        m_rb += wr * gb
        m_rw += wr * gw
        m_aa += wa * ga
        m_ab += wa * gb
        m_aw += wa * gw
        m_bb += wb * gb
        m_bw += wb * gw
        m_ww += ww * gw
        q_l += w * residual
        q_r += wr * residual
        q_a += wa * residual
        q_b += wb * residual
        q_w += ww * residual
    sums[N_XX], sums[N_XY], sums[N_YY] = n_xx, n_xy, n_yy
    sums[N_XU], sums[N_XV], sums[N_YU], sums[N_YV] = n_xu, n_xv, n_yu, n_yv
    sums[N_UU], sums[N_UV], sums[N_VV] = n_uu, n_uv, n_vv
    sums[R_X], sums[R_Y], sums[R_U], sums[R_V] = r_x, r_y, r_u, r_v
    sums[M_LL], sums[M_LR], sums[M_LA], sums[M_LB], sums[M_LW] = m_ll, m_lr, m_la, m_lb, m_lw
    sums[M_RR], sums[M_RA], sums[M_RB], sums[M_RW] = m_rr, m_ra, m_rb, m_rw
    sums[M_AA], sums[M_AB], sums[M_AW], sums[M_BB], sums[M_BW], sums[M_WW] = m_aa, m_ab, m_aw, m_bb, m_bw, m_ww
    sums[Q_L], sums[Q_R], sums[Q_A], sums[Q_B], sums[Q_W] = q_l, q_r, q_a, q_b, q_w


@compiled_sums
def add_up_centre(pixels, n, p, fitted, sums):
    """Information and score of the odd block and of the level, the misfit, and light to one side, over ``n`` pixels.

    Arguments as in `add_up_shape`. Fills N_, R_, M_LL, Q_L, and all from CHI2 on, of ``sums`` (SUMS,). Light outside
    the ellipse is looked for above the spot's surroundings.
    """
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    spot = fitted.spot
    far_level, far_x, far_y = f32(spot[LEVEL]), f32(spot[SLOPE_X]), f32(spot[SLOPE_Y])
    cx, cy, slope_x, slope_y = f32(p[CX]), f32(p[CY]), f32(p[SX]), f32(p[SY])
    level, rise, per_blur = f32(p[BASE]), f32(p[RISE]), f32(1.0 / p[BLUR])
    a, b = spot[SEMI_A] * p[SIZE_A], spot[SEMI_B] * p[SIZE_B]
    per_a2, per_b2 = f32(1.0 / (a * a)), f32(1.0 / (b * b))
    cos, sin = f32(fitted.cos), f32(fitted.sin)
    floor, gain, loose = f32(fitted.floor), f32(fitted.gain), f32((MODEL_ERROR * p[RISE]) ** 2)
    limit = f32(STRANGE_LIGHT * STRANGE_LIGHT)
    n_xx = n_xy = n_yy = n_xu = n_xv = n_yu = n_yv = n_uu = n_uv = n_vv = r_x = r_y = r_u = r_v = ZERO
    m_ll = q_l = chi2 = count = side_x = side_y = side_variance = lit_1 = lit_2 = lit_read = lit_found = ZERO
    for i in range(n // LANES * LANES):
        dx, dy = xs[i] - cx, ys[i] - cy
        _, _, pu, pv, distance, outward, bend = distance_to_ellipse(dx, dy, cos, sin, per_a2, per_b2)
        t = min(max(distance * per_blur, -REACH32), REACH32)
        step, bell = normal(t)
        lit = rise * step
        told = level + slope_x * dx + slope_y * dy + lit
        variance = floor + gain * lit
        w = _weight(values[i], told, variance, counts[i], loose, limit)
        residual = values[i] - told
        steep = rise * bell * per_blur
        du, dv = pu * (outward - bend * per_a2), pv * (outward - bend * per_b2)
        away_x, away_y = dv * sin - du * cos, -du * sin - dv * cos  # of unit length, outwards
        gx, gy = steep * away_x, steep * away_y
        outside = counts[i] if t < OUTSIDE32 else ZERO
        beside = outside * (values[i] - far_level - far_x * xs[i] - far_y * ys[i] - lit)
        side_x += beside * away_x
        side_y += beside * away_y
        side_variance += outside * HALF * variance
        wx, wy, wu, wv = w * gx, w * gy, w * dx, w * dy
        n_xx += wx * gx
        n_xy += wx * gy
        n_yy += wy * gy
        n_xu += wx * dx
        n_xv += wx * dy
        n_yu += wy * dx
        n_yv += wy * dy
        n_uu += wu * dx
        n_uv += wu * dy
        n_vv += wv * dy
        r_x += wx * residual
        r_y += wy * residual
        r_u += wu * residual
        r_v += wv * residual
        m_ll += w
        q_l += w * residual
        chi2 += w * residual * residual
        count += ONE if w > ZERO else ZERO
        wl = w * w * lit
        lit_1 += w * lit
        lit_2 += wl * lit
        lit_read += wl * floor
        lit_found += wl * residual * residual
    sums[N_XX], sums[N_XY], sums[N_YY] = n_xx, n_xy, n_yy
    sums[N_XU], sums[N_XV], sums[N_YU], sums[N_YV] = n_xu, n_xv, n_yu, n_yv
    sums[N_UU], sums[N_UV], sums[N_VV] = n_uu, n_uv, n_vv
    sums[R_X], sums[R_Y], sums[R_U], sums[R_V] = r_x, r_y, r_u, r_v
    sums[M_LL], sums[Q_L], sums[CHI2], sums[COUNT] = m_ll, q_l, chi2, count
    sums[SIDE_X], sums[SIDE_Y], sums[SIDE_VARIANCE] = side_x, side_y, side_variance
    sums[LIT_1], sums[LIT_2], sums[LIT_READ], sums[LIT_FOUND] = lit_1, lit_2, lit_read, lit_found


@compiled
def _solve2(xx, xy, yy, rx, ry):
    """The step of the centre, px, no longer than is reasonable, and whether the centre can be told at all."""
    det = xx * yy - xy * xy
    if not det > 1e-12 * xx * yy:
        return 0.0, 0.0, False
    step_x, step_y = (yy * rx - xy * ry) / det, (xx * ry - xy * rx) / det
    return (
        min(max(step_x, -LONGEST_STEP_PX), LONGEST_STEP_PX),
        min(max(step_y, -LONGEST_STEP_PX), LONGEST_STEP_PX),
        True,
    )


@compiled
def _improve_shape(sums, p, start_rise, m, q):
    """One scoring step of the even block; whether it was so long that there should be another."""
    m[0, 0], m[1, 0], m[2, 0], m[3, 0], m[4, 0] = sums[M_LL], sums[M_LR], sums[M_LA], sums[M_LB], sums[M_LW]
    m[1, 1], m[2, 1], m[3, 1], m[4, 1] = sums[M_RR], sums[M_RA], sums[M_RB], sums[M_RW]
    m[2, 2], m[3, 2], m[4, 2] = sums[M_AA], sums[M_AB], sums[M_AW]
    m[3, 3], m[4, 3], m[4, 4] = sums[M_BB], sums[M_BW], sums[M_WW]
    # What the moments and the expected blur say; sizes are derived by their logarithms.
    size_information, blur_information = 1.0 / SIZE_SIGMA**2, 1.0 / BLUR_SIGMA**2
    m[2, 2] += size_information
    m[3, 3] += size_information
    m[4, 4] += blur_information
    q[0], q[1] = sums[Q_L], sums[Q_R]
    q[2] = sums[Q_A] - size_information * math.log(p[SIZE_A])
    q[3] = sums[Q_B] - size_information * math.log(p[SIZE_B])
    q[4] = sums[Q_W] - blur_information * (p[BLUR] - BLUR_PX)
    for k in range(5):
        m[k, k] *= 1.0 + 1e-9
    if cholesky_solve(m, q):
        p[BASE] += q[0]
        p[RISE] = min(max(p[RISE] + q[1], 0.6 * start_rise), 6.0 * start_rise)
        p[SIZE_A] *= math.exp(min(max(q[2], -0.2), 0.2))
        p[SIZE_B] *= math.exp(min(max(q[3], -0.2), 0.2))
        p[BLUR] = min(max(p[BLUR] + q[4], 0.45), 1.8)
    size, blur, rise = LONG_STEP
    return max(abs(q[2]), abs(q[3])) > size or abs(q[4]) > blur or abs(q[1]) > rise * start_rise


@compiled
def _improve_centre(sums, p):
    """One scoring step of the odd block.

    Returns the centre's information xx, xy, yy with the slopes eliminated, and whether the centre can be told.
    """
    uu, uv, vv = sums[N_UU] + 1e-9, sums[N_UV], sums[N_VV] + 1e-9
    per_det = 1.0 / (uu * vv - uv * uv)
    ux, uy, vx, vy = sums[N_XU], sums[N_YU], sums[N_XV], sums[N_YV]
    # Rows of N_cs N_ss^-1.
    xu, xv = (ux * vv - vx * uv) * per_det, (vx * uu - ux * uv) * per_det
    yu, yv = (uy * vv - vy * uv) * per_det, (vy * uu - uy * uv) * per_det
    xx, xy = sums[N_XX] - xu * ux - xv * vx, sums[N_XY] - xu * uy - xv * vy
    yy = sums[N_YY] - yu * uy - yv * vy
    rx = sums[R_X] - xu * sums[R_U] - xv * sums[R_V]
    ry = sums[R_Y] - yu * sums[R_U] - yv * sums[R_V]
    step_x, step_y, told = _solve2(xx, xy, yy, rx, ry)
    ru = sums[R_U] - ux * step_x - uy * step_y
    rv = sums[R_V] - vx * step_x - vy * step_y
    p[CX] += step_x
    p[CY] += step_y
    p[SX] += (vv * ru - uv * rv) * per_det
    p[SY] += (uu * rv - uv * ru) * per_det
    # The plane is told at the spot's centre, which has moved.
    p[BASE] += p[SX] * step_x + p[SY] * step_y
    return xx, xy, yy, told


@compiled
def fit_edge_model(image, spot, neighbours, gain, room, out):
    """Refine the centre of one spot.

    ``spot`` is a row of the spot table; ``neighbours`` (k, 3) the x, y and radius (px) of spots nearby; ``gain`` grey
    levels of variance per grey level of light; ``room`` an `EdgeRoom` for its window. ``out`` (9,) receives x, y, the
    covariance xx, xy, yy (px^2) for that gain, how far, in sigmas, the light outside the ellipse lies to one side
    (noise and a wrong shape leave it even, other light beside the spot does not), chi squared per degree of freedom,
    and what the residuals say of the sensor's gain: numerator and denominator.
    """
    pixels, sums, p = room.pixels, room.sums, room.p
    near, n = gather_pixels(image, spot, neighbours, pixels)
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    floor = spot[NOISE] * spot[NOISE] + 0.02
    fitted = Fitted(spot, math.cos(spot[ANGLE]), math.sin(spot[ANGLE]), floor, gain)
    p[CX], p[CY] = spot[X] - middle_x, spot[Y] - middle_y
    p[SX], p[SY] = spot[SLOPE_X], spot[SLOPE_Y]
    p[BASE] = spot[LEVEL] + p[SX] * p[CX] + p[SY] * p[CY]
    p[RISE], p[SIZE_A], p[SIZE_B], p[BLUR] = spot[HEIGHT], 1.0, 1.0, BLUR_PX
    a, b = spot[SEMI_A], spot[SEMI_B]
    saturated = spot[SATURATED_SHARE] > MANY_SATURATED
    steps = SATURATED_SHAPE_STEPS if saturated else SHAPE_STEPS
    if not saturated:
        p[SIZE_A], p[SIZE_B] = max(1.0 - TOO_LARGE_PX / a, LEAST_SIZE), max(1.0 - TOO_LARGE_PX / b, LEAST_SIZE)
        p[BLUR] = START_BLUR_PX
        # A Gaussian blur leaves a disc no more of its height in its middle.
        p[RISE] /= 1.0 - math.exp(-0.5 * a * b * p[SIZE_A] * p[SIZE_B] / (START_BLUR_PX * START_BLUR_PX))
    for trial in range(steps):
        add_up_shape(pixels, near, p, fitted, trial > 0, sums)
        _improve_centre(sums, p)
        if not _improve_shape(sums, p, spot[HEIGHT], room.m, room.q) and not saturated:
            break
    # Away from the edge there is little to learn, but of other light: only the last step looks at it.
    add_up_centre(pixels, n, p, fitted, sums)
    xx, xy, yy, told = _improve_centre(sums, p)
    det = xx * yy - xy * xy
    if not told or not det > 0.0 or math.hypot(p[CX] + middle_x - spot[X], p[CY] + middle_y - spot[Y]) > 1.0 + a:
        # No pixel tells where the edge is: the coarse centre, and what that may be worth.
        out[:] = 0.0
        out[0], out[1], out[2], out[4], out[6] = spot[X], spot[Y], a * a, a * a, 1.0
        return
    out[0], out[1] = p[CX] + middle_x, p[CY] + middle_y
    out[2], out[3], out[4] = yy / det, -xy / det, xx / det
    usual = sums[SIDE_VARIANCE] + (EVENNESS * p[RISE] * math.pi * a * b) ** 2
    out[5] = math.sqrt((sums[SIDE_X] ** 2 + sums[SIDE_Y] ** 2) / max(usual, 1e-9))
    out[6] = sums[CHI2] / max(sums[COUNT] - PARAMETERS, 1.0)
    # Squared residuals grow with the light by the gain. The fit has taken some of them: as many as lit pixels
    # determine parameters, of the pixels that are lit.
    lit_pixels = sums[LIT_1] * sums[LIT_1] / max(sums[LIT_2], 1e-12)
    left = max(1.0 - LIT_PARAMETERS / max(lit_pixels, 1e-9), 0.3)
    out[7], out[8] = sums[LIT_FOUND] / left - sums[LIT_READ], sums[LIT_2]
