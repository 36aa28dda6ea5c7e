"""Shape of a spot from the moments of its profile, and the verdict on it."""

import math

import numpy as np

from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.components import AREA
from asterism.server.segmentation.pixels import COUNTS, GREY, LANES, ONE, PX, PY, RISE, ZERO, f32
from asterism.server.segmentation.spot_table import (
    ANGLE,
    ELONGATED,
    HEIGHT,
    LEVEL,
    MISSHAPEN,
    NOISE,
    SATURATED_SHARE,
    SEMI_A,
    SEMI_B,
    SHOULDER,
    SLOPE_X,
    SLOPE_Y,
    TOO_FAINT,
    TOO_LARGE,
    TOO_SMALL,
    UNEXPLAINED,
    X,
    Y,
)

# A disc of radius a seen at 60 degrees, b = a / 2, moving by twice its width, 4 a, along its longer axis: the
# streak's moments are those of an ellipse with a semi-axis of sqrt((4 a)^2 / 3 + a^2) = 2.52 a.
LARGEST_ASPECT = 5.1
PEAK_SHARE = 0.55  # a single pixel with more of a spot's light than this is a hot pixel: no lens is that sharp
CLIP = (0.12, 0.7)  # the part of a spot's profile that its shape is taken from
BLUR_PX2 = 0.92  # what blur (sigma 0.7 px) and pixels add to the second moments of the clipped profile, times four
CLIP_SIGMAS = 2.5  # and never so low that noise all over the window counts
UPPER_CLIP = (0.45, 0.85)  # the same where a shoulder of other light is suspected
UPPER_INSET_PX = 0.33  # how far inside the disc's edge that upper part lies
BELOW_ALL = f32(-1e6)  # grey levels
SHOULDER_PX = 0.05  # a centre that moves more between the whole profile and its upper part has other light beside it


@compiled
def _moments(s, sx, sy, sxx, sxy, syy):
    """Mean x, y and second moments xx, xy, yy from raw moments."""
    mx, my = sx / s, sy / s
    return mx, my, sxx / s - mx * mx, sxy / s - mx * my, syy / s - my * my


@compiled
def _ellipse(xx, xy, yy):
    """The larger and the smaller second moment, and the angle of the larger."""
    mean = 0.5 * (xx + yy)
    half = math.sqrt((0.5 * (xx - yy)) ** 2 + xy * xy)
    return mean + half, max(mean - half, 0.0), 0.5 * math.atan2(2.0 * xy, xx - yy)


@compiled_sums
def _rise_above_plane(pixels, n, spot):
    """Fill the row RISE with the heights above the spot's background plane; below everything what does not count."""
    xs, ys, values, counts, rises = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS], pixels[RISE]
    level, slope_x, slope_y = f32(spot[LEVEL]), f32(spot[SLOPE_X]), f32(spot[SLOPE_Y])
    for i in range(n // LANES * LANES):
        rise = values[i] - (level + slope_x * xs[i] + slope_y * ys[i])
        rises[i] = rise if counts[i] > ZERO else BELOW_ALL


@compiled
def _brightest(rises, n):
    """The brightest pixel's height, and the mean of the three brightest."""
    first = second = third = ZERO
    for i in range(n):
        z = rises[i]
        if z > third:
            if z > first:
                first, second, third = z, first, second
            elif z > second:
                second, third = z, second
            else:
                third = z
    return float(first), (float(first) + float(second) + float(third)) / 3.0


@compiled_sums
def _add_up(pixels, n, height, noise, sums):
    """Fill ``sums`` (15,): six raw moments of the clipped profile, six of its upper part, the pixels above half height,
    the saturated ones among them, all light.
    """
    low, high = f32(max(CLIP[0] * height, CLIP_SIGMAS * noise)), f32(CLIP[1] * height)
    upper_low, upper_high = f32(UPPER_CLIP[0] * height), f32(UPPER_CLIP[1] * height)
    half, ceiling = f32(0.5 * height), f32(255.0)
    us, vs, zs, values = pixels[PX], pixels[PY], pixels[RISE], pixels[GREY]
    s = sx = sy = sxx = sxy = syy = ZERO
    t = tx = ty = txx = txy = tyy = ZERO
    area = saturated = total = ZERO
    for i in range(n // LANES * LANES):
        u, v, z = us[i], vs[i], zs[i]
        total += max(z, ZERO)
        q = max(min(z, high) - low, ZERO)
        qu, qv = q * u, q * v
        s += q
        sx += qu
        sy += qv
        sxx += qu * u
        sxy += qu * v
        syy += qv * v
        q = max(min(z, upper_high) - upper_low, ZERO)
        qu, qv = q * u, q * v
        t += q
        tx += qu
        ty += qv
        txx += qu * u
        txy += qu * v
        tyy += qv * v
        area += ONE if z > half else ZERO
        saturated += ONE if z > half and values[i] >= ceiling else ZERO
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = s, sx, sy, sxx, sxy, syy
    sums[6], sums[7], sums[8], sums[9], sums[10], sums[11] = t, tx, ty, txx, txy, tyy
    sums[12], sums[13], sums[14] = area, saturated, total


@compiled
def shape(pixels, n, box, spot):
    """Centre and ellipse of a spot from the moments of its profile, clipped from below and above.

    ``pixels`` are the ``n`` of its window, ``box``. Other light that leans on the spot pulls the foot of the profile
    more than its upper part; where the two centres differ by more than noise explains, the upper part alone gives the
    shape. Fills X, Y, SEMI_A, SEMI_B, ANGLE, HEIGHT, SHOULDER and SATURATED_SHARE;
    returns the area at half height and the share of the light that the brightest pixel has.
    """
    cx, cy = 0.5 * (box.x0 + box.x1 - 1), 0.5 * (box.y0 + box.y1 - 1)
    _rise_above_plane(pixels, n, spot)
    first, height = _brightest(pixels[RISE], n)
    spot[HEIGHT] = height
    sums = np.empty(15)
    _add_up(pixels, n, height, spot[NOISE], sums)
    area = int(sums[12])
    spot[SATURATED_SHARE] = sums[13] / max(area, 1)
    spot[SHOULDER] = 0.0
    if sums[0] <= 0.0 or sums[6] <= 0.0:
        spot[X], spot[Y] = cx, cy
        spot[SEMI_A], spot[SEMI_B], spot[ANGLE] = 0.5, 0.5, 0.0
        return area, 1.0
    mx, my, xx, xy, yy = _moments(sums[0], sums[1], sums[2], sums[3], sums[4], sums[5])
    ux, uy, upper_xx, upper_xy, upper_yy = _moments(sums[6], sums[7], sums[8], sums[9], sums[10], sums[11])
    shoulder = math.sqrt((mx - ux) ** 2 + (my - uy) ** 2)
    if shoulder > SHOULDER_PX + 2.5 * spot[NOISE] / height:
        spot[SHOULDER] = shoulder
        spot[X], spot[Y] = cx + ux, cy + uy
        large, small, spot[ANGLE] = _ellipse(upper_xx, upper_xy, upper_yy)
        spot[SEMI_A] = math.sqrt(4.0 * large) + UPPER_INSET_PX
        spot[SEMI_B] = math.sqrt(4.0 * small) + UPPER_INSET_PX
    else:
        spot[X], spot[Y] = cx + mx, cy + my
        large, small, spot[ANGLE] = _ellipse(xx, xy, yy)
        spot[SEMI_A] = math.sqrt(max(4.0 * large - BLUR_PX2, 0.16))
        spot[SEMI_B] = math.sqrt(max(4.0 * small - BLUR_PX2, 0.16))
    return area, first / max(sums[14], 1e-9)


@compiled
def judge(spot, area, peak_share, faintest, largest_radius):
    """The fate of a measured spot."""
    a, b = spot[SEMI_A], spot[SEMI_B]
    if spot[HEIGHT] < faintest:
        return TOO_FAINT
    if area < 1 or peak_share > PEAK_SHARE:
        return TOO_SMALL
    if math.sqrt(area / math.pi) > largest_radius or a > 1.5 * largest_radius:
        return TOO_LARGE
    # Blur keeps small spots round: half a pixel on both axes, else noise would make slivers of them.
    if a + 0.5 > LARGEST_ASPECT * (b + 0.5):
        return ELONGATED
    # A filled ellipse has the area that its moments say; a ragged or hollow spot has not.
    expected = math.pi * (a + 0.3) * (b + 0.3)
    if area < 0.5 * expected - 3.0:
        return MISSHAPEN
    return UNEXPLAINED


@compiled
def looks_single(component, spot, area):
    """Whether the component is no larger than one spot of this shape makes it, so that no other hides in it."""
    # The foot of a blurred disc lies at most this far outside its half-height line.
    foot = 2.2
    largest = math.pi * (spot[SEMI_A] + foot) * (spot[SEMI_B] + foot)
    expected = math.pi * (spot[SEMI_A] + 0.3) * (spot[SEMI_B] + 0.3)
    return (
        component[AREA] <= largest + 3
        and area >= 0.7 * expected - 3.0
        and spot[SEMI_A] + 0.5 < 1.7 * (spot[SEMI_B] + 0.5)
    )
