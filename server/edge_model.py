"""Centre of a spot by fitting a blurred ellipse to its pixels: the default estimator.

Model: grey level = plane + rise * Phi(d / blur), with d the signed distance of the pixel to the ellipse (positive
inside), Phi the normal distribution function and blur that of point spread and pixel together. d = (r - r^2) / |grad|,
with r = sqrt(u^2/a^2 + v^2/b^2) and grad half the gradient of r^2, is exact for circles, where the usual first-order
distance (1 - r^2) / (2 |grad|) leaves errors of 1 % of the rise. All start from the spot's moments; centre, slopes of
the plane, its level, the rise, semi-axes, angle and blur are refined by Fisher scoring, every pixel weighted with its
own variance (read noise plus shot noise).

An ellipse looks the same from both sides of its centre: what shifts it (centre, slopes) is odd, what does not (level,
rise, axes, angle, blur) is even, and sums over odd times even terms vanish. So the parameters fall into two blocks, and
the centre's covariance needs the odd one only: it owns up to the slopes, and the rest costs it nothing.
"""

import math

import numpy as np

from asterism.server.compiled import compiled, compiled_sums
from asterism.server.planar import cholesky_solve
from asterism.server.spots import (
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
TURN_SIGMA = 0.2  # rad; a circle has no angle
ITERATIONS = 3
SATURATED_ITERATIONS = 6  # where the top is cut off, rise and size are found from the flanks alone
MANY_SATURATED = 0.05  # share of the spot's pixels
NEAR_PX = 3.0  # outside the edge, within which pixels tell where it is
LONGEST_STEP_PX = 0.7
EVENNESS = 0.004  # of a spot's light: how uneven the model's own error leaves what is outside the ellipse, one sigma
NEIGHBOUR_MARGIN_PX = 1.0  # pixels nearer than this to another spot are left out
MODEL_ERROR = 0.05  # of the rise: how far the model may be off without anything being wrong
STRANGE_LIGHT = 3.0  # sigmas above the model beyond which a pixel's light is somebody else's
OUTSIDE = -1.0  # sigmas of blur from the edge, from where on light counts as beside the spot
SATURATED = 255.0
REACH = 4.5  # sigmas of blur beyond which the edge is over

# Parameters: the odd block's sums come first.
CX, CY, SX, SY, BASE, RISE, SIZE_A, SIZE_B, BLUR, TURN = range(10)
PARAMETERS = 10
# Sums over the pixels.
(
    N_XX, N_XY, N_YY, N_XU, N_XV, N_YU, N_YV, N_UU, N_UV, N_VV, R_X, R_Y, R_U, R_V,
    M_LL, M_LR, M_LA, M_LB, M_LW, M_RR, M_RA, M_RB, M_RW, M_AA, M_AB, M_AW, M_BB, M_BW, M_WW,
    M_LT, M_RT, M_AT, M_BT, M_WT, M_TT, Q_L, Q_R, Q_A, Q_B, Q_W, Q_T,
    CHI2, COUNT, SIDE_X, SIDE_Y, SIDE_VARIANCE, LIT_1, LIT_2, LIT_READ, LIT_FOUND,
) = range(50)  # fmt: skip
SUMS = 50
LIT_PARAMETERS = 8.0  # of the ten parameters, those that lit pixels determine


@compiled_sums
def add_up(xs, ys, values, n, p, a, b, angle, around, floor, gain, strange, sums):
    """Fill ``sums`` (SUMS,) over ``n`` pixels of the model with parameters ``p`` (10,): information, score, misfit.

    ``xs``, ``ys`` px from the window's middle; ``a``, ``b`` semi-axes px and ``angle`` at the start; ``around`` (3,)
    level and slopes of the spot's surroundings, above which light outside the ellipse is looked for; ``strange``: leave
    out pixels with more light than the model can be wrong by. The normal distribution function is a polynomial
    (least squares on Chebyshev nodes, 4e-6), the exponential a power of one (1e-4 of itself at the far end): what wide
    registers are good at.
    """
    far_level, far_x, far_y = around[0], around[1], around[2]
    cx, cy, slope_x, slope_y, level, rise, blur = p[CX], p[CY], p[SX], p[SY], p[BASE], p[RISE], p[BLUR]
    a, b = a * p[SIZE_A], b * p[SIZE_B]
    cos, sin = math.cos(angle + p[TURN]), math.sin(angle + p[TURN])
    per_a2, per_b2, per_blur = 1.0 / (a * a), 1.0 / (b * b), 1.0 / blur
    loose = (MODEL_ERROR * rise) ** 2
    limit = STRANGE_LIGHT * STRANGE_LIGHT if strange else 1e18
    n_xx = n_xy = n_yy = n_xu = n_xv = n_yu = n_yv = n_uu = n_uv = n_vv = r_x = r_y = r_u = r_v = 0.0
    m_ll = m_lr = m_la = m_lb = m_lw = m_rr = m_ra = m_rb = m_rw = m_aa = m_ab = m_aw = m_bb = m_bw = m_ww = 0.0
    m_lt = m_rt = m_at = m_bt = m_wt = m_tt = q_l = q_r = q_a = q_b = q_w = q_t = 0.0
    chi2 = count = side_x = side_y = side_variance = lit_1 = lit_2 = lit_read = lit_found = 0.0
    for i in range(n):
        dx, dy = xs[i] - cx, ys[i] - cy
        u, v = cos * dx + sin * dy, cos * dy - sin * dx
        pu, pv = u * per_a2, v * per_b2
        slope2 = pu * pu + pv * pv + 1e-12
        reach2 = u * pu + v * pv + 1e-12
        # Roots and quotients are what takes the time: two of each are made to do.
        reach = math.sqrt(reach2)
        per_both = 1.0 / math.sqrt(slope2 * reach2)
        per_slope = reach * per_both
        distance = (reach - reach2) * per_slope
        t = min(max(distance * per_blur, -REACH), REACH)
        r = t * t * (1.0 / (REACH * REACH))
        f = 5.52169579 - 0.946988853 * r
        f = f * r - 14.3616313
        f = f * r + 22.1794949
        f = f * r - 22.9223258
        f = f * r + 16.997319
        f = f * r - 9.46363688
        f = f * r + 4.05310171
        f = f * r - 1.3448406
        f = f * r + 0.398921712
        step = 0.5 + t * f
        # The density: the sixteenth power of a polynomial for the exponential.
        s = t * t * (0.5 / 16.0)
        e = 1.0 - s * (1.0 - s * (0.5 - s * (1.0 / 6.0 - s * (1.0 / 24.0 - s * (1.0 / 120.0)))))
        e = e * e
        e = e * e
        e = e * e
        e = 0.3989422804014327 * e * e
        bell = e if abs(t) < REACH else 0.0
        lit = rise * step
        told = level + slope_x * dx + slope_y * dy + lit
        value = values[i]
        residual = value - told
        variance = floor + gain * lit
        # Beyond the sensor's ceiling a pixel says no more than the model does.
        cut = value >= SATURATED and told >= SATURATED - 3.0
        odd = residual > 0.0 and residual * residual > limit * (variance + loose)
        w = 0.0 if cut or odd else 1.0 / variance
        steep = rise * bell * per_blur
        outward, bend = per_both - 2.0 * per_slope, distance * per_slope * per_slope
        du, dv = pu * (outward - bend * per_a2), pv * (outward - bend * per_b2)
        away_x, away_y = dv * sin - du * cos, -du * sin - dv * cos  # of unit length, outwards
        gx, gy = steep * away_x, steep * away_y
        outside = t < OUTSIDE
        beside = value - far_level - far_x * xs[i] - far_y * ys[i] - lit if outside else 0.0
        side_x += beside * away_x
        side_y += beside * away_y
        side_variance += 0.5 * variance if outside else 0.0
        ga = steep * pu * (2.0 * bend * pu - outward * u)
        gb = steep * pv * (2.0 * bend * pv - outward * v)
        gw = -steep * t
        gt = steep * (du * v - dv * u)
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
        wr, wa, wb, ww, wt = w * step, w * ga, w * gb, w * gw, w * gt
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
        m_lt += wt
        m_rt += wt * step
        m_at += wt * ga
        m_bt += wt * gb
        m_wt += wt * gw
        m_tt += wt * gt
        q_l += w * residual
        q_r += wr * residual
        q_a += wa * residual
        q_b += wb * residual
        q_w += ww * residual
        q_t += wt * residual
        chi2 += w * residual * residual
        count += 1.0 if w > 0.0 else 0.0
        wl = w * w * lit
        lit_1 += w * lit
        lit_2 += wl * lit
        lit_read += wl * floor
        lit_found += wl * residual * residual
    sums[N_XX], sums[N_XY], sums[N_YY] = n_xx, n_xy, n_yy
    sums[N_XU], sums[N_XV], sums[N_YU], sums[N_YV] = n_xu, n_xv, n_yu, n_yv
    sums[N_UU], sums[N_UV], sums[N_VV] = n_uu, n_uv, n_vv
    sums[R_X], sums[R_Y], sums[R_U], sums[R_V] = r_x, r_y, r_u, r_v
    sums[M_LL], sums[M_LR], sums[M_LA], sums[M_LB], sums[M_LW] = m_ll, m_lr, m_la, m_lb, m_lw
    sums[M_RR], sums[M_RA], sums[M_RB], sums[M_RW] = m_rr, m_ra, m_rb, m_rw
    sums[M_AA], sums[M_AB], sums[M_AW], sums[M_BB], sums[M_BW], sums[M_WW] = m_aa, m_ab, m_aw, m_bb, m_bw, m_ww
    sums[M_LT], sums[M_RT], sums[M_AT], sums[M_BT], sums[M_WT], sums[M_TT] = m_lt, m_rt, m_at, m_bt, m_wt, m_tt
    sums[Q_L], sums[Q_R], sums[Q_A], sums[Q_B], sums[Q_W], sums[Q_T] = q_l, q_r, q_a, q_b, q_w, q_t
    sums[CHI2], sums[COUNT] = chi2, count
    sums[SIDE_X], sums[SIDE_Y], sums[SIDE_VARIANCE] = side_x, side_y, side_variance
    sums[LIT_1], sums[LIT_2], sums[LIT_READ], sums[LIT_FOUND] = lit_1, lit_2, lit_read, lit_found


@compiled
def _centre_block(sums):
    """Information and score of the centre with the slopes eliminated: xx, xy, yy, x, y."""
    uu, uv, vv = sums[N_UU] + 1e-9, sums[N_UV], sums[N_VV] + 1e-9
    per_det = 1.0 / (uu * vv - uv * uv)
    ux, uy, vx, vy = sums[N_XU], sums[N_YU], sums[N_XV], sums[N_YV]
    # Rows of N_cs N_ss^-1.
    xu, xv = (ux * vv - vx * uv) * per_det, (vx * uu - ux * uv) * per_det
    yu, yv = (uy * vv - vy * uv) * per_det, (vy * uu - uy * uv) * per_det
    return (
        sums[N_XX] - xu * ux - xv * vx,
        sums[N_XY] - xu * uy - xv * vy,
        sums[N_YY] - yu * uy - yv * vy,
        sums[R_X] - xu * sums[R_U] - xv * sums[R_V],
        sums[R_Y] - yu * sums[R_U] - yv * sums[R_V],
    )


@compiled
def _improve(sums, p, start_rise, m, q):
    """One scoring step of all parameters; False if the centre cannot be told."""
    xx, xy, yy, rx, ry = _centre_block(sums)
    det = xx * yy - xy * xy
    if not det > 1e-12 * xx * yy:
        return False
    step_x = min(max((yy * rx - xy * ry) / det, -LONGEST_STEP_PX), LONGEST_STEP_PX)
    step_y = min(max((xx * ry - xy * rx) / det, -LONGEST_STEP_PX), LONGEST_STEP_PX)
    uu, uv, vv = sums[N_UU] + 1e-9, sums[N_UV], sums[N_VV] + 1e-9
    ru = sums[R_U] - sums[N_XU] * step_x - sums[N_YU] * step_y
    rv = sums[R_V] - sums[N_XV] * step_x - sums[N_YV] * step_y
    per_det = 1.0 / (uu * vv - uv * uv)
    p[CX] += step_x
    p[CY] += step_y
    p[SX] += (vv * ru - uv * rv) * per_det
    p[SY] += (uu * rv - uv * ru) * per_det
    # The plane is told at the spot's centre, which has moved.
    p[BASE] += p[SX] * step_x + p[SY] * step_y
    m[0, 0], m[1, 0], m[2, 0], m[3, 0], m[4, 0] = sums[M_LL], sums[M_LR], sums[M_LA], sums[M_LB], sums[M_LW]
    m[1, 1], m[2, 1], m[3, 1], m[4, 1] = sums[M_RR], sums[M_RA], sums[M_RB], sums[M_RW]
    m[2, 2], m[3, 2], m[4, 2] = sums[M_AA], sums[M_AB], sums[M_AW]
    m[3, 3], m[4, 3], m[4, 4] = sums[M_BB], sums[M_BW], sums[M_WW]
    m[5, 0], m[5, 1], m[5, 2] = sums[M_LT], sums[M_RT], sums[M_AT]
    m[5, 3], m[5, 4], m[5, 5] = sums[M_BT], sums[M_WT], sums[M_TT]
    # What the moments and the expected blur say; sizes are derived by their logarithms.
    size_information, blur_information = 1.0 / SIZE_SIGMA**2, 1.0 / BLUR_SIGMA**2
    m[2, 2] += size_information
    m[3, 3] += size_information
    m[4, 4] += blur_information
    m[5, 5] += 1.0 / TURN_SIGMA**2
    q[0], q[1] = sums[Q_L], sums[Q_R]
    q[2] = sums[Q_A] - size_information * math.log(p[SIZE_A])
    q[3] = sums[Q_B] - size_information * math.log(p[SIZE_B])
    q[4] = sums[Q_W] - blur_information * (p[BLUR] - BLUR_PX)
    q[5] = sums[Q_T] - p[TURN] / TURN_SIGMA**2
    for k in range(6):
        m[k, k] *= 1.0 + 1e-9
    if cholesky_solve(m, q):
        p[BASE] += q[0]
        p[RISE] = min(max(p[RISE] + q[1], 0.6 * start_rise), 6.0 * start_rise)
        p[SIZE_A] *= math.exp(min(max(q[2], -0.2), 0.2))
        p[SIZE_B] *= math.exp(min(max(q[3], -0.2), 0.2))
        p[BLUR] = min(max(p[BLUR] + q[4], 0.45), 1.8)
        p[TURN] += min(max(q[5], -0.2), 0.2)
    return True


@compiled
def gather_pixels(image, spot, neighbours, pixels):
    """The spot's pixels without its neighbours', those near its edge first: how many are near, and how many in all.

    ``pixels`` (3, capacity) receives places from the window's middle, px, and grey levels.
    """
    height, width = image.shape
    x0, x1 = max(int(spot[WX0]), 0), min(int(spot[WX1]), width)
    y0, y1 = max(int(spot[WY0]), 0), min(int(spot[WY1]), height)
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    near2 = (spot[SEMI_A] + NEAR_PX) ** 2
    near, far = 0, pixels.shape[1]
    for y in range(y0, y1):
        for x in range(x0, x1):
            taken = False
            for k in range(neighbours.shape[0]):
                away2 = (x - neighbours[k, 0]) ** 2 + (y - neighbours[k, 1]) ** 2
                taken |= away2 < (neighbours[k, 2] + NEIGHBOUR_MARGIN_PX) ** 2
            if taken:
                continue
            if (x - spot[X]) ** 2 + (y - spot[Y]) ** 2 < near2:
                place = near
                near += 1
            else:
                far -= 1
                place = far
            pixels[0, place], pixels[1, place], pixels[2, place] = x - middle_x, y - middle_y, image[y, x]
    count = near
    for place in range(far, pixels.shape[1]):
        for k in range(3):
            pixels[k, count] = pixels[k, place]
        count += 1
    return near, count


@compiled
def fit_edge_model(image, spot, neighbours, gain, pixels, sums, out):
    """Refine the centre of one spot.

    ``spot`` is a row of the spot table; ``neighbours`` (k, 3) the x, y and radius (px) of spots nearby; ``gain`` grey
    levels of variance per grey level of light; ``pixels`` (3, capacity) and ``sums`` (SUMS,) are scratch. ``out``
    (9,) receives x, y, the covariance xx, xy, yy (px^2) for that gain, how far, in sigmas, the light outside the
    ellipse lies to one side (noise and a wrong shape leave it even, other light beside the spot does not), chi
    squared per degree of freedom, and what the residuals say of the sensor's gain: numerator and denominator.
    """
    xs, ys, values = pixels[0], pixels[1], pixels[2]
    near, n = gather_pixels(image, spot, neighbours, pixels)
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    floor = spot[NOISE] * spot[NOISE] + 0.02
    p, m, q, around = np.zeros(PARAMETERS), np.empty((6, 6)), np.empty(6), np.empty(3)
    around[0], around[1], around[2] = spot[LEVEL], spot[SLOPE_X], spot[SLOPE_Y]
    p[CX], p[CY] = spot[X] - middle_x, spot[Y] - middle_y
    p[SX], p[SY] = spot[SLOPE_X], spot[SLOPE_Y]
    p[BASE] = spot[LEVEL] + p[SX] * p[CX] + p[SY] * p[CY]
    p[RISE], p[SIZE_A], p[SIZE_B], p[BLUR] = spot[HEIGHT], 1.0, 1.0, BLUR_PX
    iterations = SATURATED_ITERATIONS if spot[SATURATED_SHARE] > MANY_SATURATED else ITERATIONS
    told = True
    for trial in range(iterations):
        # Away from the edge there is little to learn: only the last step looks at it.
        used = n if trial == iterations - 1 else near
        add_up(xs, ys, values, used, p, spot[SEMI_A], spot[SEMI_B], spot[ANGLE], around, floor, gain, trial > 0, sums)
        told = _improve(sums, p, spot[HEIGHT], m, q)
        if not told:
            break
    xx, xy, yy, _, _ = _centre_block(sums)
    det = xx * yy - xy * xy
    a = spot[SEMI_A]
    if not told or not det > 0.0 or math.hypot(p[CX] + middle_x - spot[X], p[CY] + middle_y - spot[Y]) > 1.0 + a:
        # No pixel tells where the edge is: the coarse centre, and what that may be worth.
        out[:] = 0.0
        out[0], out[1], out[2], out[4], out[6] = spot[X], spot[Y], a * a, a * a, 1.0
        return
    out[0], out[1] = p[CX] + middle_x, p[CY] + middle_y
    out[2], out[3], out[4] = yy / det, -xy / det, xx / det
    usual = sums[SIDE_VARIANCE] + (EVENNESS * p[RISE] * math.pi * a * spot[SEMI_B]) ** 2
    out[5] = math.sqrt((sums[SIDE_X] ** 2 + sums[SIDE_Y] ** 2) / max(usual, 1e-9))
    out[6] = sums[CHI2] / max(sums[COUNT] - PARAMETERS, 1.0)
    # Squared residuals grow with the light by the gain. The fit has taken some of them: as many as lit pixels
    # determine parameters, of the pixels that are lit.
    lit_pixels = sums[LIT_1] * sums[LIT_1] / max(sums[LIT_2], 1e-12)
    left = max(1.0 - LIT_PARAMETERS / max(lit_pixels, 1e-9), 0.3)
    out[7], out[8] = sums[LIT_FOUND] / left - sums[LIT_READ], sums[LIT_2]
