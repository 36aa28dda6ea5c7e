"""Centre of a spot that other light leans on (a dim mirror image in a polished floor, a lamp's halo): both are fitted.

Model: the blurred ellipse of `edge_model`, its angle fixed, beside a round Gaussian of light, on the spot's background
plane; nine parameters by Levenberg-Marquardt, every pixel weighted with its own variance. The covariance is the
centre's block of the inverse normal matrix, so it owns up to what the second light leaves undetermined.
"""

import math

import numpy as np

from asterism.server.centres.blurred_ellipse import REACH, distance_to_ellipse, gauss, normal
from asterism.server.centres.edge_sums import SATURATED
from asterism.server.centres.window import leave_out
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.pose.planar import cholesky_solve
from asterism.server.segmentation.pixels import LANES, Box, cells_of, gather_box, pad, room_for
from asterism.server.segmentation.spot_table import (
    ANGLE,
    HEIGHT,
    LEVEL,
    NOISE,
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

# Parameters: the ellipse's centre, rise and semi-axes; the other light's centre, height and width (sigma).
PX, PY, RISE, A, B, QX, QY, LIGHT, WIDTH = range(9)
PARAMETERS = 9
ITERATIONS = 12
NEIGHBOUR_MARGIN_PX = 1.0
# Beyond these the model does not hold: misfit, of the spot's height, RMS; chi squared per degree of freedom.
WORST_MISFIT, WORST_SCALE = 0.08, 4.0
PATIENCE, HOPELESS = 4, 4.0  # iterations after which a fit that is so many times too bad is given up
LEAST_LIGHT = 5.0  # sigmas: a second light dimmer than that may not be there


@compiled_sums
def _add_up(pixels, count, spot, blur, gain, p, n, r):
    """Fill the lower triangle of the normal matrix ``n`` (9, 9) and ``r`` (9,) of the model with parameters ``p`` (9,).

    ``pixels`` are ``count`` from `_gather`. Returns chi squared, the squared residuals without weights, and the number
    of pixels that count.
    """
    xs, ys, values, counts = pixels[0], pixels[1], pixels[2], pixels[3]
    level, slope_x, slope_y = spot[LEVEL], spot[SLOPE_X], spot[SLOPE_Y]
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    px, py, rise, qx, qy, light = (
        p[PX] - middle_x,
        p[PY] - middle_y,
        p[RISE],
        p[QX] - middle_x,
        p[QY] - middle_y,
        p[LIGHT],
    )
    cos, sin = math.cos(spot[ANGLE]), math.sin(spot[ANGLE])
    per_a, per_b, per_blur, per_w = 1.0 / p[A], 1.0 / p[B], 1.0 / blur, 1.0 / p[WIDTH]
    per_a2, per_b2, per_w2 = per_a * per_a, per_b * per_b, per_w * per_w
    floor = spot[NOISE] * spot[NOISE] + 0.02
    n_xx = n_yx = n_yy = n_rx = n_ry = n_rr = n_ax = n_ay = n_ar = n_aa = n_bx = n_by = n_br = n_ba = n_bb = 0.0
    n_ux = n_uy = n_ur = n_ua = n_ub = n_uu = n_vx = n_vy = n_vr = n_va = n_vb = n_vu = n_vv = n_lx = n_ly = 0.0
    n_lr = n_la = n_lb = n_lu = n_lv = n_ll = n_wx = n_wy = n_wr = n_wa = n_wb = n_wu = n_wv = n_wl = n_ww = 0.0
    r_x = r_y = r_r = r_a = r_b = r_u = r_v = r_l = r_w = 0.0
    chi2 = plain = number = 0.0
    for i in range(count // LANES * LANES):
        x, y = float(xs[i]), float(ys[i])
        dx, dy = x - px, y - py
        u, v, s, t, distance, outward, bend = distance_to_ellipse(dx, dy, cos, sin, per_a2, per_b2)
        off = min(max(distance * per_blur, -REACH), REACH)
        step, bell = normal(off)
        ex, ey = x - qx, y - qy
        away2 = (ex * ex + ey * ey) * per_w2
        glow = gauss(min(away2, REACH * REACH))
        lit = rise * step + light * glow
        told = level + slope_x * x + slope_y * y + lit
        value = float(values[i])
        residual = value - told
        counted = 0.0 if value >= SATURATED and told >= SATURATED else float(counts[i])
        w = counted / (floor + gain * max(lit, 0.0))
        chi2 += w * residual * residual
        plain += counted * residual * residual
        number += counted
        du, dv = s * (outward - bend * per_a2), t * (outward - bend * per_b2)
        steep = rise * bell * per_blur
        g_x, g_y = steep * (dv * sin - du * cos), -steep * (du * sin + dv * cos)
        g_r = step
        g_a = steep * s * (2.0 * bend * s - outward * u) * per_a
        g_b = steep * t * (2.0 * bend * t - outward * v) * per_b
        shine = light * glow
        g_u, g_v = shine * ex * per_w2, shine * ey * per_w2
        g_l, g_w = glow, shine * away2 * per_w
        weighted = w * g_x
        r_x += weighted * residual
        n_xx += weighted * g_x
        weighted = w * g_y
        r_y += weighted * residual
        n_yx += weighted * g_x
        n_yy += weighted * g_y
        weighted = w * g_r
        r_r += weighted * residual
        n_rx += weighted * g_x
        n_ry += weighted * g_y
        n_rr += weighted * g_r
        weighted = w * g_a
        r_a += weighted * residual
        n_ax += weighted * g_x
        n_ay += weighted * g_y
        n_ar += weighted * g_r
        n_aa += weighted * g_a
        weighted = w * g_b
        r_b += weighted * residual
        n_bx += weighted * g_x
        n_by += weighted * g_y
        n_br += weighted * g_r
        n_ba += weighted * g_a
        n_bb += weighted * g_b
        weighted = w * g_u
        r_u += weighted * residual
        n_ux += weighted * g_x
        n_uy += weighted * g_y
        n_ur += weighted * g_r
        n_ua += weighted * g_a
        n_ub += weighted * g_b
        n_uu += weighted * g_u
        weighted = w * g_v
        r_v += weighted * residual
        n_vx += weighted * g_x
        n_vy += weighted * g_y
        n_vr += weighted * g_r
        n_va += weighted * g_a
        n_vb += weighted * g_b
        n_vu += weighted * g_u
        n_vv += weighted * g_v
        weighted = w * g_l
        r_l += weighted * residual
        n_lx += weighted * g_x
        n_ly += weighted * g_y
        n_lr += weighted * g_r
        n_la += weighted * g_a
        n_lb += weighted * g_b
        n_lu += weighted * g_u
        n_lv += weighted * g_v
        n_ll += weighted * g_l
        weighted = w * g_w
        r_w += weighted * residual
        n_wx += weighted * g_x
        n_wy += weighted * g_y
        n_wr += weighted * g_r
        n_wa += weighted * g_a
        n_wb += weighted * g_b
        n_wu += weighted * g_u
        n_wv += weighted * g_v
        n_wl += weighted * g_l
        n_ww += weighted * g_w
    n[0, 0] = n_xx
    n[1, 0], n[1, 1] = n_yx, n_yy
    n[2, 0], n[2, 1], n[2, 2] = n_rx, n_ry, n_rr
    n[3, 0], n[3, 1], n[3, 2], n[3, 3] = n_ax, n_ay, n_ar, n_aa
    n[4, 0], n[4, 1], n[4, 2], n[4, 3], n[4, 4] = n_bx, n_by, n_br, n_ba, n_bb
    n[5, 0], n[5, 1], n[5, 2], n[5, 3], n[5, 4], n[5, 5] = n_ux, n_uy, n_ur, n_ua, n_ub, n_uu
    n[6, 0], n[6, 1], n[6, 2], n[6, 3], n[6, 4], n[6, 5], n[6, 6] = n_vx, n_vy, n_vr, n_va, n_vb, n_vu, n_vv
    n[7, 0], n[7, 1], n[7, 2], n[7, 3], n[7, 4], n[7, 5], n[7, 6], n[7, 7] = (
        n_lx,
        n_ly,
        n_lr,
        n_la,
        n_lb,
        n_lu,
        n_lv,
        n_ll,
    )
    n[8, 0], n[8, 1], n[8, 2], n[8, 3], n[8, 4], n[8, 5], n[8, 6], n[8, 7], n[8, 8] = (
        n_wx,
        n_wy,
        n_wr,
        n_wa,
        n_wb,
        n_wu,
        n_wv,
        n_wl,
        n_ww,
    )
    r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8] = r_x, r_y, r_r, r_a, r_b, r_u, r_v, r_l, r_w
    return chi2, plain, number


@compiled
def _gather(image, spot, neighbours, box):
    """The pixels of a box, told from the middle of the spot's own; neighbours' do not count."""
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    pixels = room_for(cells_of(box))
    count = pad(pixels, 0, gather_box(image, box, middle_x, middle_y, pixels, 0))
    leave_out(pixels, count, neighbours, middle_x, middle_y)
    return pixels, count


@compiled
def _light_beside(image, spot, neighbours, box):
    """Centre and height of what shines outside the spot's ellipse; height 0 if nothing does."""
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    s = sx = sy = most = 0.0
    for y in range(box.y0, box.y1):
        for x in range(box.x0, box.x1):
            if math.hypot(x - spot[X], y - spot[Y]) < spot[SEMI_A] + 1.0:
                continue
            plane = spot[LEVEL] + spot[SLOPE_X] * (x - middle_x) + spot[SLOPE_Y] * (y - middle_y)
            z = float(image[y, x]) - plane
            if z <= 3.0 * spot[NOISE]:
                continue
            taken = False
            for k in range(neighbours.shape[0]):
                away2 = (x - neighbours[k, 0]) ** 2 + (y - neighbours[k, 1]) ** 2
                taken |= away2 < (neighbours[k, 2] + NEIGHBOUR_MARGIN_PX) ** 2
            if not taken:
                s += z
                sx += z * x
                sy += z * y
                most = max(most, z)
    if s <= 0.0:
        return 0.0, 0.0, 0.0
    return sx / s, sy / s, most


@compiled
def fit_leaning(image, spot, other, neighbours, blur, gain, out):
    """Fit a spot and the light beside it; arguments and ``out`` as in `edge_model.fit_edge_model`.

    ``other`` (4,) is the spot that was split from this one: x, y, height, radius; its height is 0 where there is
    none, and the light is looked for. ``out`` ends with chi squared per degree of freedom, at least 1. Returns False,
    with ``out`` untouched, where the two do not explain the pixels or the light may not be there.
    """
    height, width = image.shape
    # The other light reaches beyond the spot's own window.
    wider = 2 if other[2] == 0.0 else 6
    x0, x1 = max(int(spot[WX0]) - wider, 0), min(int(spot[WX1]) + wider, width)
    y0, y1 = max(int(spot[WY0]) - wider, 0), min(int(spot[WY1]) + wider, height)
    box = Box(x0, x1, y0, y1)
    p = np.empty(PARAMETERS)
    p[PX], p[PY], p[RISE] = spot[X], spot[Y], spot[HEIGHT]
    p[A], p[B] = spot[SEMI_A], spot[SEMI_B]
    if other[2] > 0.0:
        p[QX], p[QY], p[LIGHT], p[WIDTH] = other[0], other[1], other[2], max(0.7 * other[3], 1.0)
    else:
        p[QX], p[QY], p[LIGHT] = _light_beside(image, spot, neighbours, box)
        p[WIDTH] = 2.0
        if p[LIGHT] == 0.0:
            return False
    pixels, count = _gather(image, spot, neighbours, box)
    n, r = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS)
    trial_n, trial_r = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS)
    work, move, trial = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS), np.empty(PARAMETERS)
    chi2, plain, number = _add_up(pixels, count, spot, blur, gain, p, n, r)
    damping = 1e-2
    for iteration in range(ITERATIONS):
        if iteration >= PATIENCE and chi2 > HOPELESS * WORST_SCALE * (number - PARAMETERS):
            return False
        work[:, :] = n
        move[:] = r
        for j in range(PARAMETERS):
            work[j, j] *= 1.0 + damping
            work[j, j] += 1e-9
        if not cholesky_solve(work, move):
            damping *= 10.0
            continue
        trial[:] = p + move
        trial[A], trial[B] = max(trial[A], 0.4), max(trial[B], 0.4)
        trial[WIDTH] = min(max(trial[WIDTH], 0.8), 8.0)
        trial[LIGHT] = min(max(trial[LIGHT], 0.0), p[RISE])
        if math.hypot(trial[PX] - spot[X], trial[PY] - spot[Y]) > 2.0:
            damping = damping * 10.0
            continue
        trial_chi2, trial_plain, trial_number = _add_up(pixels, count, spot, blur, gain, trial, trial_n, trial_r)
        if trial_chi2 < chi2:
            gained = chi2 - trial_chi2
            p[:], n[:, :], r[:] = trial, trial_n, trial_r
            chi2, plain, number = trial_chi2, trial_plain, trial_number
            damping *= 0.2
            if gained < 1e-3 * chi2:
                break
        else:
            damping = damping * 6.0
    dof = number - PARAMETERS
    if dof < 10 or math.sqrt(plain / number) > WORST_MISFIT * spot[HEIGHT]:
        return False
    scale = max(chi2 / dof, 1.0)
    if scale > WORST_SCALE:
        return False
    work[:, :] = n
    for j in range(PARAMETERS):
        work[j, j] += 1e-9
    move[:] = 0.0
    move[LIGHT] = 1.0
    if not cholesky_solve(work, move) or p[LIGHT] ** 2 < LEAST_LIGHT**2 * scale * move[LIGHT]:
        return False
    for axis in range(2):
        work[:, :] = n
        for j in range(PARAMETERS):
            work[j, j] += 1e-9
        move[:] = 0.0
        move[axis] = 1.0
        if not cholesky_solve(work, move):
            return False
        if axis == 0:
            out[2], out[3] = scale * move[0], scale * move[1]
        else:
            out[4] = scale * move[1]
    out[0], out[1] = p[PX], p[PY]
    out[5] = scale
    return True
