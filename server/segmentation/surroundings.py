"""What surrounds a window: the plane through the ring of its outermost pixels, and their lower quartile."""

import math
from typing import NamedTuple

import numpy as np

from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.pixels import COUNTS, GREY, LANES, PX, PY, ZERO, f32

SCATTER, NOISE_ROUNDS = 4.0, 5


class Plane(NamedTuple):
    """A background: its level at a window's middle, grey levels, and its slopes, grey levels per px."""

    level: float
    slope_x: float
    slope_y: float


@compiled
def _solve_plane(sums):
    """The plane whose ``sums`` (9,) those of `_add_up_plane` are, by Cramer's rule, and whether there is one."""
    m00, m01, m02, m11, m12, m22 = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    r0, r1, r2 = sums[6], sums[7], sums[8]
    c00 = m11 * m22 - m12 * m12
    c01 = m02 * m12 - m01 * m22
    c02 = m01 * m12 - m02 * m11
    det = m00 * c00 + m01 * c01 + m02 * c02
    if not det > 1e-9 * abs(m00 * m11 * m22):
        return Plane(0.0, 0.0, 0.0), False
    c11 = m00 * m22 - m02 * m02
    c12 = m01 * m02 - m00 * m12
    c22 = m00 * m11 - m01 * m01
    level = (c00 * r0 + c01 * r1 + c02 * r2) / det
    slope_x = (c01 * r0 + c11 * r1 + c12 * r2) / det
    slope_y = (c02 * r0 + c12 * r1 + c22 * r2) / det
    return Plane(level, slope_x, slope_y), True


@compiled_sums
def _add_up_plane(pixels, n, box, plane, below, above, sums):
    """Fill ``sums`` (10,): number, x, y, xx, xy, yy, and z, xz, yz, zz, over a window's outermost pixels near a plane.

    ``box`` is the window; z is the height above the plane's level; left out is what lies more than ``below`` under the
    `Plane` or ``above`` over it.
    """
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    level, slope_x, slope_y = f32(plane.level), f32(plane.slope_x), f32(plane.slope_y)
    below, above = f32(-below), f32(above)
    reach_x, reach_y = f32(0.5 * (box.x1 - box.x0 - 1)), f32(0.5 * (box.y1 - box.y0 - 1))
    number = sx = sy = sxx = sxy = syy = sz = sxz = syz = szz = ZERO
    for i in range(n // LANES * LANES):
        x, y, z = xs[i], ys[i], values[i] - level
        off = z - (slope_x * x + slope_y * y)
        outermost = abs(x) >= reach_x or abs(y) >= reach_y
        w = counts[i] if outermost and off >= below and off <= above else ZERO
        wx, wy = w * x, w * y
        number += w
        sx += wx
        sy += wy
        sxx += wx * x
        sxy += wx * y
        syy += wy * y
        sz += w * z
        sxz += wx * z
        syz += wy * z
        szz += w * z * z
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = number, sx, sy, sxx, sxy, syy
    sums[6], sums[7], sums[8], sums[9] = sz, sxz, syz, szz


@compiled
def _variance_about(fitted, sums):
    """What the plane `fitted` to those ``sums`` leaves, per degree of freedom, grey levels squared."""
    left = sums[9] - fitted.level * sums[6] - fitted.slope_x * sums[7] - fitted.slope_y * sums[8]
    return left / max(sums[0] - 3.0, 1.0)


@compiled
def ring_background(pixels, n, box, guess, noise, rise):
    """`Plane` through the outermost of the ``n`` pixels of a window, and their noise about it, at least ``noise``.

    Pixels that belong to something bright (``rise`` above the ``guess``, later beyond three sigma of the plane) are
    left out. Where those that are left scatter by more than the frame's noise and its chance (`SCATTER` sigma of a
    variance of so many pixels), in glare, on texture, in compressed pictures, they tell the noise, and the limit of
    three sigma is set anew: a few rounds lead from the frame's noise to the ring's, and stop before what stands out
    from both. Source: least squares; the later fits drop the outliers of those before.
    """
    plane = Plane(guess, 0.0, 0.0)
    sums = np.empty(10)
    for attempt in range(2 + NOISE_ROUNDS):
        above = rise if attempt == 0 else 3.0 * noise + 1.0
        below = 255.0 if attempt == 0 else above
        _add_up_plane(pixels, n, box, plane, below, above, sums)
        if sums[0] < 8:
            break
        fitted, solved = _solve_plane(sums)
        if not solved:
            break
        plane = Plane(plane.level + fitted.level, fitted.slope_x, fitted.slope_y)
        if attempt > 0:
            variance = _variance_about(fitted, sums)
            if not variance > noise * noise * (1.0 + SCATTER * math.sqrt(2.0 / sums[0])):
                break
            noise = math.sqrt(variance)
    return plane, noise


@compiled
def ring_quartile(image, box):
    """The lower quartile of a window's outermost pixels: its surroundings, whatever shines into it from one side."""
    x0, x1, y0, y1 = box
    counts = np.zeros(256, np.int64)
    count = 0
    for y in range(y0, y1):
        for x in range(x0, x1, 1 if y in (y0, y1 - 1) else x1 - x0 - 1):
            counts[image[y, x]] += 1
            count += 1
    level, below = 0, counts[0]
    while below <= count // 4:
        level += 1
        below += counts[level]
    return float(level)
