"""The model of a spot that other light leans on: blurred ellipses on a plane, pixel by pixel; the first is the spot.

The others are ellipses of their own: the spot's image in a polished floor or another LED is the same disc, dimmer; a
glint is a long one; light that is spread widely (a halo, a lamp behind) is a small one with a wide blur.
"""

import math

from asterism.server.centres.blurred_ellipse import REACH32, distance_to_ellipse, normal
from asterism.server.compiled import compiled_sums
from asterism.server.segmentation.pixels import COUNTS, GREY, LANES, ONE, PX, PY, TWO, ZERO, f32

# Parameters: the plane, at the window's middle; then of every light the centre (px from there), rise, semi-axes, angle
# and blur.
BASE, SLOPE_U, SLOPE_V = range(3)
PLANE = 3
CX, CY, RISE, SEMI_U, SEMI_V, TURN, BLUR = range(7)
OF_A_LIGHT = 7
MOST_LIGHTS = 3
PARAMETERS = PLANE + MOST_LIGHTS * OF_A_LIGHT  # at most
# Rows of the table of pixels that `look` fills: derivatives by the parameters, residual and weight.
RESIDUAL, WEIGHT = PARAMETERS, PARAMETERS + 1
ROWS = PARAMETERS + 2
CEILING, NEAR_CEILING = f32(255.0), f32(252.0)


@compiled_sums
def _ellipse(pixels, count, p, first, table):
    """Add the light of the ellipse whose parameters begin at ``first`` to what the ``table`` tells (RESIDUAL), and fill
    its derivatives.
    """
    xs, ys, light = pixels[PX], pixels[PY], table[RESIDUAL]
    x, y, rise = f32(p[first]), f32(p[first + 1]), f32(p[first + 2])
    per_a, per_b, per_blur = f32(1.0 / p[first + 3]), f32(1.0 / p[first + 4]), f32(1.0 / p[first + 6])
    cos, sin = f32(math.cos(p[first + 5])), f32(math.sin(p[first + 5]))
    per_a2, per_b2 = per_a * per_a, per_b * per_b
    by_x, by_y, by_rise, by_a = table[first], table[first + 1], table[first + 2], table[first + 3]
    by_b, by_turn, by_blur = table[first + 4], table[first + 5], table[first + 6]
    for i in range(count // LANES * LANES):
        u, v, pu, pv, distance, outward, bend = distance_to_ellipse(xs[i] - x, ys[i] - y, cos, sin, per_a2, per_b2)
        off = min(max(distance * per_blur, -REACH32), REACH32)
        step, bell = normal(off)
        du, dv = pu * (outward - bend * per_a2), pv * (outward - bend * per_b2)
        steep = rise * bell * per_blur
        by_x[i] = steep * (dv * sin - du * cos)
        by_y[i] = -steep * (du * sin + dv * cos)
        by_rise[i] = step
        by_a[i] = steep * pu * (TWO * bend * pu - outward * u) * per_a
        by_b[i] = steep * pv * (TWO * bend * pv - outward * v) * per_b
        by_turn[i] = steep * (du * v - dv * u)
        by_blur[i] = -steep * off
        light[i] += rise * step


@compiled_sums
def look(pixels, count, lights, p, floor, gain, table):
    """Fill the ``table`` (ROWS, capacity) of the first ``count`` pixels at parameters ``p`` of so many lights.

    ``floor`` and ``gain`` make the pixels' variances, floor + gain * light.
    """
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    base, slope_u, slope_v = f32(p[BASE]), f32(p[SLOPE_U]), f32(p[SLOPE_V])
    read, shot = f32(floor), f32(gain)
    table[RESIDUAL, :count] = ZERO
    for light in range(lights):
        _ellipse(pixels, count, p, PLANE + light * OF_A_LIGHT, table)
    residuals, weights = table[RESIDUAL], table[WEIGHT]
    for i in range(count // LANES * LANES):
        table[BASE, i] = ONE
        table[SLOPE_U, i] = xs[i]
        table[SLOPE_V, i] = ys[i]
        lit = residuals[i]
        told = base + slope_u * xs[i] + slope_v * ys[i] + lit
        residuals[i] = values[i] - told
        # Beyond the ceiling a pixel says no more than the model does.
        cut = values[i] >= CEILING and told >= NEAR_CEILING
        weights[i] = ZERO if cut else counts[i] / (read + shot * max(lit, ZERO))


@compiled_sums
def add_up(table, count, parameters, n, r):
    """Fill the lower triangle of the normal matrix ``n`` and the right side ``r`` of so many ``parameters``.

    Returns chi squared, the squared residuals without weights, and the number of pixels that count.
    """
    weights, residuals = table[WEIGHT], table[RESIDUAL]
    chi2 = plain = number = ZERO
    for i in range(count // LANES * LANES):
        here = ONE if weights[i] > ZERO else ZERO
        chi2 += weights[i] * residuals[i] * residuals[i]
        plain += here * residuals[i] * residuals[i]
        number += here
    for k in range(parameters):
        by_k = table[k]
        total = ZERO
        for i in range(count // LANES * LANES):
            total += weights[i] * by_k[i] * residuals[i]
        r[k] = total
        for j in range(k + 1):
            by_j = table[j]
            total = ZERO
            for i in range(count // LANES * LANES):
                total += weights[i] * by_k[i] * by_j[i]
            n[k, j] = total
    return float(chi2), float(plain), float(number)
