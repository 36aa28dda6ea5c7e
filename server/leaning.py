"""Centre of a spot that other light leans on (a dim mirror image in a polished floor, a lamp's halo): both are fitted.

Model: the blurred ellipse of `edge_model`, its angle fixed, beside a round Gaussian of light, on the spot's background
plane; nine parameters by Levenberg-Marquardt, every pixel weighted with its own variance. The covariance is the
centre's block of the inverse normal matrix, so it owns up to what the second light leaves undetermined.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.planar import cholesky_solve
from asterism.server.spots import (
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
SATURATED = 255
NEIGHBOUR_MARGIN_PX = 1.0
# Beyond these the model does not hold: misfit, of the spot's height, RMS; chi squared per degree of freedom.
WORST_MISFIT, WORST_SCALE = 0.08, 4.0
PATIENCE, HOPELESS = 4, 4.0  # iterations after which a fit that is so many times too bad is given up
LEAST_LIGHT = 5.0  # sigmas: a second light dimmer than that may not be there


@compiled
def _evaluate(image, spot, neighbours, blur, gain, p, x0, x1, y0, y1, want, n, r):
    """Weighted squared residuals of the model; fills the lower triangle n (9, 9) and r (9,) if ``want``.

    Returns chi squared, the plain squared residuals, and the number of pixels.
    """
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    cos, sin = math.cos(spot[ANGLE]), math.sin(spot[ANGLE])
    per_a2, per_b2 = 1.0 / (p[A] * p[A]), 1.0 / (p[B] * p[B])
    floor = spot[NOISE] ** 2 + 0.02
    chi2 = plain = 0.0
    pixels = 0
    g = np.empty(PARAMETERS)
    if want:
        n[:, :] = 0.0
        r[:] = 0.0
    for y in range(y0, y1):
        for x in range(x0, x1):
            taken = False
            for k in range(neighbours.shape[0]):
                away2 = (x - neighbours[k, 0]) ** 2 + (y - neighbours[k, 1]) ** 2
                taken |= away2 < (neighbours[k, 2] + NEIGHBOUR_MARGIN_PX) ** 2
            if taken:
                continue
            dx, dy = x - p[PX], y - p[PY]
            u, v = cos * dx + sin * dy, cos * dy - sin * dx
            s, t = u * per_a2, v * per_b2
            slope = math.sqrt(s * s + t * t) + 1e-9
            reach2 = u * s + v * t
            reach = math.sqrt(reach2 + 1e-12)
            away = (reach - reach2) / slope  # px from the edge, as in the edge model
            distance = min(max(away / blur, -6.0), 6.0)
            step = 0.5 * (1.0 + math.erf(distance * 0.7071067811865476))
            bell = math.exp(-0.5 * distance * distance) * 0.3989422804014327
            ex, ey = x - p[QX], y - p[QY]
            per_w2 = 1.0 / (p[WIDTH] * p[WIDTH])
            away2 = (ex * ex + ey * ey) * per_w2
            glow = math.exp(-0.5 * away2)
            lit = p[RISE] * step + p[LIGHT] * glow
            told = spot[LEVEL] + spot[SLOPE_X] * (x - middle_x) + spot[SLOPE_Y] * (y - middle_y) + lit
            value = float(image[y, x])
            if value >= SATURATED and told >= SATURATED:
                continue
            weight = 1.0 / (floor + gain * max(lit, 0.0))
            residual = value - told
            chi2 += weight * residual * residual
            plain += residual * residual
            pixels += 1
            if not want:
                continue
            outward, bend = (1.0 / reach - 2.0) / slope, away / (slope * slope)
            du, dv = s * (outward - bend * per_a2), t * (outward - bend * per_b2)
            steep = p[RISE] * bell / blur
            g[PX], g[PY] = -steep * (du * cos - dv * sin), -steep * (du * sin + dv * cos)
            g[RISE] = step
            g[A] = steep * (2.0 * bend * s * s - outward * u * s) / p[A]
            g[B] = steep * (2.0 * bend * t * t - outward * v * t) / p[B]
            g[QX], g[QY] = p[LIGHT] * glow * ex * per_w2, p[LIGHT] * glow * ey * per_w2
            g[LIGHT] = glow
            g[WIDTH] = p[LIGHT] * glow * away2 / p[WIDTH]
            for j in range(PARAMETERS):
                wg = weight * g[j]
                r[j] += wg * residual
                for k in range(j + 1):
                    n[j, k] += wg * g[k]
    return chi2, plain, pixels


@compiled
def _light_beside(image, spot, neighbours, x0, x1, y0, y1):
    """Centre and height of what shines outside the spot's ellipse; height 0 if nothing does."""
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    s = sx = sy = most = 0.0
    for y in range(y0, y1):
        for x in range(x0, x1):
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
    p = np.empty(PARAMETERS)
    p[PX], p[PY], p[RISE] = spot[X], spot[Y], spot[HEIGHT]
    p[A], p[B] = spot[SEMI_A], spot[SEMI_B]
    if other[2] > 0.0:
        p[QX], p[QY], p[LIGHT], p[WIDTH] = other[0], other[1], other[2], max(0.7 * other[3], 1.0)
    else:
        p[QX], p[QY], p[LIGHT] = _light_beside(image, spot, neighbours, x0, x1, y0, y1)
        p[WIDTH] = 2.0
        if p[LIGHT] == 0.0:
            return False
    n, r = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS)
    work, move, trial = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS), np.empty(PARAMETERS)
    chi2, plain, pixels = _evaluate(image, spot, neighbours, blur, gain, p, x0, x1, y0, y1, True, n, r)
    damping = 1e-2
    for iteration in range(ITERATIONS):
        if iteration >= PATIENCE and chi2 > HOPELESS * WORST_SCALE * (pixels - PARAMETERS):
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
        trial_chi2, _, _ = _evaluate(image, spot, neighbours, blur, gain, trial, x0, x1, y0, y1, False, n, r)
        if trial_chi2 < chi2:
            gained = chi2 - trial_chi2
            p[:] = trial
            chi2, plain, pixels = _evaluate(image, spot, neighbours, blur, gain, p, x0, x1, y0, y1, True, n, r)
            damping *= 0.2
            if gained < 1e-3 * chi2:
                break
        else:
            damping = damping * 6.0
    dof = pixels - PARAMETERS
    if dof < 10 or math.sqrt(plain / pixels) > WORST_MISFIT * spot[HEIGHT]:
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
