"""Sums over a spot's pixels that the fit of the blurred ellipse (`edge_model`) is made of.

They are the bulk of the time: they are taken in single precision, whose rounding moves a centre by less than 1e-5 px,
over pixels padded to whole registers.
"""

from typing import Any, NamedTuple

from asterism.server.centres.blurred_ellipse import REACH32, distance_to_ellipse, normal
from asterism.server.compiled import compiled_sums
from asterism.server.segmentation.pixels import COUNTS, GREY, HALF, LANES, ONE, PX, PY, TWO, ZERO, f32
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
    floor, gain, loose = (
        f32(fitted.floor + (fitted.softness * p[RISE]) ** 2),
        f32(fitted.gain),
        f32((MODEL_ERROR * p[RISE]) ** 2),
    )
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
        w = weight(values[i], told, floor + gain * lit, counts[i], loose, limit)
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
        w = weight(values[i], told, variance, counts[i], loose, limit)
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
