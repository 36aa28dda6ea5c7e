"""Sums over a spot's pixels that the fit of the blurred ellipse (`edge_model`) is made of.

They are the bulk of the time: they are taken in single precision, whose rounding moves a centre by less than 1e-5 px,
over pixels padded to whole registers. The model of every pixel is laid out first, then added up: all at once is more
than the processor has registers for.
"""

from typing import Any, NamedTuple

import numpy as np

from asterism.server.centres.blurred_ellipse import REACH32, distance_to_ellipse, normal
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.pixels import COUNTS, GREY, HALF, LANES, ONE, PX, PY, TWO, ZERO, f32, index
from asterism.server.segmentation.spot_table import LEVEL, SEMI_A, SEMI_B, SLOPE_X, SLOPE_Y

MODEL_ERROR = 0.05  # of the rise: how far the model may be off without anything being wrong
STRANGE_LIGHT = 3.0  # sigmas above the model beyond which a pixel's light is somebody else's
OUTSIDE = -1.0  # sigmas of blur from the edge, from where on light counts as beside the spot
SATURATED = 255.0

CX, CY, SX, SY, BASE, RISE, SIZE_A, SIZE_B, BLUR = range(9)
PARAMETERS = 9

# Sums over the pixels. M_: information of the even block (level, rise, log a, log b, blur), Q_: its score; N_: of the
# odd block (x, y, slopes u, v), R_: its score.
(
    N_XX, N_XY, N_YY, R_X, R_Y,
    M_LL, M_LR, M_LA, M_LB, M_LW, M_RR, M_RA, M_RB, M_RW, M_AA, M_AB, M_AW, M_BB, M_BW, M_WW, Q_L, Q_R, Q_A, Q_B, Q_W,
    N_XU, N_XV, N_YU, N_YV, N_UU, N_UV, N_VV, R_U, R_V,
    CHI2, COUNT, SIDE_X, SIDE_Y, SIDE_VARIANCE, LIT_1, LIT_2, LIT_READ, LIT_FOUND,
) = range(43)  # fmt: skip
SUMS = 43
SHAPE_SUMS = CHI2  # the first so many are those of both blocks

# Pixels are taken strip by strip: what they give are rows of so many. Most windows are one strip.
STRIP = 17 * LANES
ROWS = 8
# Where the rows begin: weight, residual and the model's derivatives.
WEIGHT, LEFT, BY_X, BY_Y, BY_RISE, BY_A, BY_B, BY_BLUR = (index(row * STRIP) for row in range(ROWS))

OUTSIDE32 = f32(OUTSIDE)
CEILING, NEAR_CEILING = f32(SATURATED), f32(SATURATED - 3.0)


class Fitted(NamedTuple):
    """The spot that is fitted: its row ``spot`` of the spot table; ``cos`` and ``sin`` of its angle; ``floor`` and
    ``gain`` make the pixels' variances, floor + gain * light; ``softness`` is the share of the rise that the model
    is off by while the shape is sought, one sigma.
    """

    spot: Any
    cos: float
    sin: float
    floor: float
    gain: float
    softness: float


@compiled_sums
def weight(value, told, variance, counts, loose, limit):
    """Weight of a pixel's residual: none beyond the sensor's ceiling, none with more light than the model can be wrong
    by (``loose``, a variance) and ``limit`` (squared sigmas) allow.
    """
    residual = value - told
    # Beyond the ceiling a pixel says no more than the model does.
    cut = value >= CEILING and told >= NEAR_CEILING
    odd = residual > ZERO and residual * residual > limit * (variance + loose)
    return ZERO if cut or odd else counts / variance


@compiled
def edge_rows():
    """Room for what the pixels of a strip give: flat, so that it is known where rows lie, and that none overlap."""
    return np.empty(ROWS * STRIP, np.float32)


@compiled
def add_up_shape(pixels, n, p, fitted, strange, rows, sums):
    """Information and score of the even and of the odd block over the first ``n`` of ``pixels``.

    ``p`` (PARAMETERS,) are the model's; ``strange``: leave out pixels with more light than the model can be wrong by;
    ``rows`` are `edge_rows`. Fills M_, Q_, N_ and R_ of ``sums`` (SUMS,).
    """
    sums[:SHAPE_SUMS] = 0.0
    for start in range(0, n, STRIP):
        count = min(n - start, STRIP)
        _lay_out_shape(pixels, start, count, p, fitted, strange, rows)
        _add_up_odd(pixels, start, count, p, rows, sums)
        _add_up_even(count, rows, sums)


@compiled
def add_up_centre(pixels, n, p, fitted, rows, sums):
    """Information and score of the odd block, the misfit, and light to one side, over ``n`` pixels.

    Arguments as in `add_up_shape`. Fills N_, R_, and all from CHI2 on, of ``sums`` (SUMS,). Light outside the ellipse
    is looked for above the spot's surroundings.
    """
    sums[:] = 0.0
    for start in range(0, n, STRIP):
        count = min(n - start, STRIP)
        _lay_out_centre(pixels, start, count, p, fitted, rows, sums)
        _add_up_odd(pixels, start, count, p, rows, sums)


@compiled_sums
def _lay_out_shape(pixels, start, count, p, fitted, strange, rows):
    """Fill ``rows`` with what ``count`` pixels from ``start`` on give for a step of the shape."""
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    cx, cy, slope_x, slope_y = f32(p[CX]), f32(p[CY]), f32(p[SX]), f32(p[SY])
    level, rise, per_blur = f32(p[BASE]), f32(p[RISE]), f32(1.0 / p[BLUR])
    spot = fitted.spot
    a, b = spot[SEMI_A] * p[SIZE_A], spot[SEMI_B] * p[SIZE_B]
    per_a2, per_b2 = f32(1.0 / (a * a)), f32(1.0 / (b * b))
    cos, sin = f32(fitted.cos), f32(fitted.sin)
    floor, gain, loose = (
        f32(fitted.floor + (fitted.softness * p[RISE]) ** 2),
        f32(fitted.gain),
        f32((MODEL_ERROR * p[RISE]) ** 2),
    )
    limit = f32(STRANGE_LIGHT * STRANGE_LIGHT if strange else 1e18)
    steepest = rise * per_blur
    for i in range(count // LANES * LANES):
        k, j = index(start + i), index(i)
        dx, dy = xs[k] - cx, ys[k] - cy
        u, v, pu, pv, distance, outward, bend = distance_to_ellipse(dx, dy, cos, sin, per_a2, per_b2)
        t = min(max(distance * per_blur, -REACH32), REACH32)
        step, bell = normal(t)
        lit = rise * step
        told = level + slope_x * dx + slope_y * dy + lit
        steep = steepest * bell
        du, dv = pu * (outward - bend * per_a2), pv * (outward - bend * per_b2)
        rows[j + WEIGHT] = weight(values[k], told, floor + gain * lit, counts[k], loose, limit)
        rows[j + LEFT] = values[k] - told
        rows[j + BY_X], rows[j + BY_Y] = steep * (dv * sin - du * cos), -steep * (du * sin + dv * cos)
        rows[j + BY_RISE] = step
        rows[j + BY_A] = steep * pu * (TWO * bend * pu - outward * u)
        rows[j + BY_B] = steep * pv * (TWO * bend * pv - outward * v)
        rows[j + BY_BLUR] = -steep * t


@compiled_sums
def _lay_out_centre(pixels, start, count, p, fitted, rows, sums):
    """Fill ``rows`` with what ``count`` pixels from ``start`` on give for a step of the centre, and add up the rest."""
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    spot = fitted.spot
    far_level, far_x, far_y = f32(spot[LEVEL]), f32(spot[SLOPE_X]), f32(spot[SLOPE_Y])
    cx, cy, slope_x, slope_y = f32(p[CX]), f32(p[CY]), f32(p[SX]), f32(p[SY])
    level, rise, per_blur = f32(p[BASE]), f32(p[RISE]), f32(1.0 / p[BLUR])
    a, b = spot[SEMI_A] * p[SIZE_A], spot[SEMI_B] * p[SIZE_B]
    per_a2, per_b2 = f32(1.0 / (a * a)), f32(1.0 / (b * b))
    cos, sin = f32(fitted.cos), f32(fitted.sin)
    floor, gain, loose = f32(fitted.floor), f32(fitted.gain), f32((MODEL_ERROR * p[RISE]) ** 2)
    limit, steepest = f32(STRANGE_LIGHT * STRANGE_LIGHT), rise * per_blur
    chi2 = counted = side_x = side_y = side_variance = lit_1 = lit_2 = lit_read = lit_found = ZERO
    for i in range(count // LANES * LANES):
        k, j = index(start + i), index(i)
        dx, dy = xs[k] - cx, ys[k] - cy
        _, _, pu, pv, distance, outward, bend = distance_to_ellipse(dx, dy, cos, sin, per_a2, per_b2)
        t = min(max(distance * per_blur, -REACH32), REACH32)
        step, bell = normal(t)
        lit = rise * step
        told = level + slope_x * dx + slope_y * dy + lit
        variance = floor + gain * lit
        w = weight(values[k], told, variance, counts[k], loose, limit)
        residual = values[k] - told
        steep = steepest * bell
        du, dv = pu * (outward - bend * per_a2), pv * (outward - bend * per_b2)
        away_x, away_y = dv * sin - du * cos, -du * sin - dv * cos  # of unit length, outwards
        outside = counts[k] if t < OUTSIDE32 else ZERO
        beside = outside * (values[k] - far_level - far_x * xs[k] - far_y * ys[k] - lit)
        side_x += beside * away_x
        side_y += beside * away_y
        side_variance += outside * variance
        wr, wl = w * residual, w * lit
        chi2 += wr * residual
        counted += ONE if w > ZERO else ZERO
        lit_1 += wl
        lit_2 += wl * wl
        lit_read += wl * w
        lit_found += wr * wr * lit
        rows[j + WEIGHT], rows[j + LEFT] = w, residual
        rows[j + BY_X], rows[j + BY_Y] = steep * away_x, steep * away_y
    sums[CHI2] += chi2
    sums[COUNT] += counted
    sums[SIDE_X] += side_x
    sums[SIDE_Y] += side_y
    sums[SIDE_VARIANCE] += HALF * side_variance
    sums[LIT_1] += lit_1
    sums[LIT_2] += lit_2
    sums[LIT_READ] += floor * lit_read
    sums[LIT_FOUND] += lit_found


@compiled_sums
def _add_up_odd(pixels, start, count, p, rows, sums):
    """Add information and score of the odd block, of ``count`` pixels from ``start`` on, to N_ and R_ of ``sums``."""
    xs, ys = pixels[PX], pixels[PY]
    cx, cy = f32(p[CX]), f32(p[CY])
    n_xx = n_xy = n_yy = n_xu = n_xv = n_yu = n_yv = n_uu = n_uv = n_vv = r_x = r_y = r_u = r_v = ZERO
    for i in range(count // LANES * LANES):
        k, j = index(start + i), index(i)
        dx, dy, w, left = xs[k] - cx, ys[k] - cy, rows[j + WEIGHT], rows[j + LEFT]
        gx, gy = rows[j + BY_X], rows[j + BY_Y]
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
        r_x += wx * left
        r_y += wy * left
        r_u += wu * left
        r_v += wv * left
    for at, more in (
        (N_XX, n_xx), (N_XY, n_xy), (N_YY, n_yy), (N_XU, n_xu), (N_XV, n_xv), (N_YU, n_yu), (N_YV, n_yv),
        (N_UU, n_uu), (N_UV, n_uv), (N_VV, n_vv), (R_X, r_x), (R_Y, r_y), (R_U, r_u), (R_V, r_v),
    ):  # fmt: skip
        sums[at] += more


@compiled_sums
def _add_up_even(count, rows, sums):
    """Add information and score of the even block, of ``count`` pixels, to M_ and Q_ of ``sums``."""
    m_ll = m_lr = m_la = m_lb = m_lw = m_rr = m_ra = m_rb = m_rw = m_aa = m_ab = m_aw = m_bb = m_bw = m_ww = ZERO
    q_l = q_r = q_a = q_b = q_w = ZERO
    for i in range(count // LANES * LANES):
        j = index(i)
        w, left = rows[j + WEIGHT], rows[j + LEFT]
        by_rise, by_a, by_b, by_blur = rows[j + BY_RISE], rows[j + BY_A], rows[j + BY_B], rows[j + BY_BLUR]
        wr, wa, wb, ww = w * by_rise, w * by_a, w * by_b, w * by_blur
        m_ll += w
        m_lr += wr
        m_la += wa
        m_lb += wb
        m_lw += ww
        m_rr += wr * by_rise
        m_ra += wr * by_a
        m_rb += wr * by_b
        m_rw += wr * by_blur
        m_aa += wa * by_a
        m_ab += wa * by_b
        m_aw += wa * by_blur
        m_bb += wb * by_b
        m_bw += wb * by_blur
        m_ww += ww * by_blur
        q_l += w * left
        q_r += wr * left
        q_a += wa * left
        q_b += wb * left
        q_w += ww * left
    for at, more in (
        (M_LL, m_ll), (M_LR, m_lr), (M_LA, m_la), (M_LB, m_lb), (M_LW, m_lw), (M_RR, m_rr), (M_RA, m_ra), (M_RB, m_rb),
        (M_RW, m_rw), (M_AA, m_aa), (M_AB, m_ab), (M_AW, m_aw), (M_BB, m_bb), (M_BW, m_bw), (M_WW, m_ww),
        (Q_L, q_l), (Q_R, q_r), (Q_A, q_a), (Q_B, q_b), (Q_W, q_w),
    ):  # fmt: skip
        sums[at] += more
