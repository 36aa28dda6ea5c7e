"""From a connected component to the spots of light in it: split, local background, shape, verdict.

A component is split where it has several peaks of their own (a watershed in descending grey levels in which peaks
of little prominence are joined to their neighbour), so a lamp, a glint or a dim mirror image that touches an LED does
not take the LED with it. Every spot is then judged against its own surroundings: a plane through the ring around it
is its background, half its height above that its local threshold.
"""

import math

import numpy as np

from asterism.protocol.messages import Fate
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.background import interpolate
from asterism.server.segmentation.components import AREA, PEAK, X0, X1, Y0, Y1
from asterism.server.segmentation.pixels import (
    COUNTS,
    GREY,
    LANES,
    ONE,
    PX,
    PY,
    RISE,
    SPARE,
    ZERO,
    f32,
    gather_box,
    pad,
    room_for,
)
from asterism.server.segmentation.watershed import keep_group, watershed

# Columns of the spot table: centre, semi-axes and angle of the ellipse (px, rad), height above the local background,
# the background's level at the centre and its slopes (grey levels, per px), its noise, the share of the spot's
# pixels that are saturated, the window (px, exclusive ends), the fate, and, where other light leans on the spot, how
# far, in px, that pulls the foot of its profile away from the upper part (else 0), whether the spot was split from
# others, and, once it is centred, chi squared per degree of freedom of the fit.
(
    X,
    Y,
    SEMI_A,
    SEMI_B,
    ANGLE,
    HEIGHT,
    LEVEL,
    SLOPE_X,
    SLOPE_Y,
    NOISE,
    SATURATED_SHARE,
    WX0,
    WX1,
    WY0,
    WY1,
    FATE,
    SHOULDER,
    TOUCHING,
    MISFIT,
) = range(19)
SPOT_COLUMNS = 19

# The verdicts, as plain integers for the compiled code.
UNEXPLAINED = int(Fate.UNEXPLAINED)
TOO_SMALL = int(Fate.TOO_SMALL)
TOO_LARGE = int(Fate.TOO_LARGE)
ELONGATED = int(Fate.ELONGATED)
AT_EDGE = int(Fate.AT_EDGE)
MASKED = int(Fate.MASKED)
TOO_FAINT = int(Fate.TOO_FAINT)
MISSHAPEN = int(Fate.MISSHAPEN)

MARGIN_PX = 3  # of the window around a spot; the ring of its outermost pixels shows the background
REGION_MARGIN_PX = 4  # the same around the upper part of a region of a split component
UPPER_PART = 0.3  # of a region's height above its surroundings
LARGEST_COMPONENT_PX = 40_000  # beyond that a component is a patch of glare: not worth splitting
SMALLEST_AREA_PX = 3
LARGEST_ASPECT = 2.6  # a disc seen at 65 degrees
PEAK_SHARE = 0.55  # a single pixel with more of a spot's light than this is a hot pixel: no lens is that sharp
CLIP = (0.12, 0.7)  # the part of a spot's profile that its shape is taken from
BLUR_PX2 = 0.92  # what blur (sigma 0.7 px) and pixels add to the second moments of the clipped profile, times four
CLIP_SIGMAS = 2.5  # and never so low that noise all over the window counts
UPPER_CLIP = (0.45, 0.85)  # the same where a shoulder of other light is suspected
UPPER_INSET_PX = 0.33  # how far inside the disc's edge that upper part lies
BELOW_ALL = f32(-1e6)  # grey levels
SHOULDER_PX = 0.05  # a centre that moves more between the whole profile and its upper part has other light beside it


@compiled
def _solve3(m00, m01, m02, m11, m12, m22, r0, r1, r2):
    """Solution of a symmetric 3x3 system by Cramer's rule; zeros when it is singular."""
    c00 = m11 * m22 - m12 * m12
    c01 = m02 * m12 - m01 * m22
    c02 = m01 * m12 - m02 * m11
    det = m00 * c00 + m01 * c01 + m02 * c02
    if not det > 1e-9 * abs(m00 * m11 * m22):
        return 0.0, 0.0, 0.0, False
    c11 = m00 * m22 - m02 * m02
    c12 = m01 * m02 - m00 * m12
    c22 = m00 * m11 - m01 * m01
    return (
        (c00 * r0 + c01 * r1 + c02 * r2) / det,
        (c01 * r0 + c11 * r1 + c12 * r2) / det,
        (c02 * r0 + c12 * r1 + c22 * r2) / det,
        True,
    )


@compiled_sums
def _add_up_plane(pixels, n, reach_x, reach_y, level, slope_x, slope_y, below, above, sums):
    """Fill ``sums`` (9,): number, x, y, xx, xy, yy, and z, xz, yz, over a window's outermost pixels near a plane.

    The outermost pixels are ``reach_x`` or ``reach_y`` px from the middle. z is the height above ``level`` grey levels;
    left out is what lies more than ``below`` under the plane or ``above`` over it.
    """
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    level, slope_x, slope_y, below, above = f32(level), f32(slope_x), f32(slope_y), f32(-below), f32(above)
    reach_x, reach_y = f32(reach_x), f32(reach_y)
    number = sx = sy = sxx = sxy = syy = sz = sxz = syz = ZERO
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
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = number, sx, sy, sxx, sxy, syy
    sums[6], sums[7], sums[8] = sz, sxz, syz


@compiled
def _ring_background(pixels, n, cols, rows, guess, noise, rise):
    """Plane through the outermost of the ``n`` pixels of a window: level at its centre, slopes.

    Pixels that belong to something bright (``rise`` above the ``guess``, later beyond three sigma of the plane) are
    left out. Source: least squares; the second fit drops the outliers of the first.
    """
    level, slope_x, slope_y = guess, 0.0, 0.0
    sums = np.empty(9)
    for attempt in range(2):
        above = rise if attempt == 0 else 3.0 * noise + 1.0
        below = 255.0 if attempt == 0 else above
        _add_up_plane(
            pixels, n, 0.5 * (cols - 1), 0.5 * (rows - 1), level, slope_x, slope_y, below, above, sums
        )  # fmt: skip
        if sums[0] < 8:
            break
        a, b, c, solved = _solve3(
            sums[0], sums[1], sums[2], sums[3], sums[4], sums[5], sums[6], sums[7], sums[8]
        )  # fmt: skip
        if not solved:
            break
        level, slope_x, slope_y = level + a, b, c
    return level, slope_x, slope_y


@compiled
def _gather_window(image, x0, x1, y0, y1, pixels):
    """The pixels of a window (exclusive ends), row by row, told from its middle; how many, with the padding."""
    cx, cy = 0.5 * (x0 + x1 - 1), 0.5 * (y0 + y1 - 1)
    return pad(pixels, 0, gather_box(image, x0, x1, y0, y1, cx, cy, pixels, 0))


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
def _shape(pixels, n, x0, x1, y0, y1, spot):
    """Centre and ellipse of a spot from the moments of its profile, clipped from below and above.

    ``pixels`` are the ``n`` of its window, from `_gather_window`. Other light that leans on the spot
    pulls the foot of the profile more than its upper part; where the two centres differ by more than noise explains,
    the upper part alone gives the shape. Fills X, Y, SEMI_A, SEMI_B, ANGLE, HEIGHT, SHOULDER and SATURATED_SHARE;
    returns the area at half height and the share of the light that the brightest pixel has.
    """
    cx, cy = 0.5 * (x0 + x1 - 1), 0.5 * (y0 + y1 - 1)
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
def _judge(spot, area, peak_share, faintest, largest_radius):
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
def _looks_single(component, spot, area):
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


@compiled
def _at_edge(image, x0, x1, y0, y1):
    """Whether a box (exclusive ends) reaches the edge of the image, so that light may be cut off."""
    return x0 < 2 or y0 < 2 or x1 > image.shape[1] - 2 or y1 > image.shape[0] - 2


@compiled
def measure_spots(image, thresholds, table, n_components, level, noise, sigmas, least, largest_radius, masks, spots):
    """Fill ``spots`` (capacity, SPOT_COLUMNS) from ``n_components`` rows of ``table``; return how many there are.

    ``level`` and ``noise`` are the background maps; ``sigmas`` and ``least`` say how far, in background sigmas and
    grey levels, a spot must stand out; ``largest_radius`` px; ``masks`` (m, 4) x0, y0, x1, y1 px inclusive.
    """
    height, width = image.shape
    labels = np.empty(0, np.int32)
    regions = np.empty((512, 4))
    pixels = room_for(1024)
    count = 0
    for k in range(n_components):
        component = table[k]
        if count == spots.shape[0]:
            break
        spot = spots[count]
        spot[:] = 0.0
        x0, x1, y0, y1 = component[X0], component[X1], component[Y0], component[Y1]
        cx, cy = 0.5 * (x0 + x1 - 1), 0.5 * (y0 + y1 - 1)
        base = interpolate(level, cy, cx, height, width)
        rough = interpolate(noise, cy, cx, height, width)
        faintest = max(sigmas * rough, least)
        spot[X], spot[Y], spot[LEVEL], spot[NOISE] = cx, cy, base, rough
        spot[SEMI_A] = spot[SEMI_B] = math.sqrt(component[AREA] / math.pi)
        spot[HEIGHT] = component[PEAK] - base
        wx0, wx1 = max(x0 - MARGIN_PX, 0), min(x1 + MARGIN_PX, width)
        wy0, wy1 = max(y0 - MARGIN_PX, 0), min(y1 + MARGIN_PX, height)
        spot[WX0], spot[WX1], spot[WY0], spot[WY1] = wx0, wx1, wy0, wy1
        fate = 0
        if component[AREA] < SMALLEST_AREA_PX:
            fate = TOO_SMALL
        elif (x1 - x0) * (y1 - y0) > LARGEST_COMPONENT_PX:
            fate = TOO_LARGE
        elif _at_edge(image, x0, x1, y0, y1) and max(x1 - x0, y1 - y0) <= 4.0 * largest_radius:
            fate = AT_EDGE
        for m in range(masks.shape[0]):
            if masks[m, 0] <= cx <= masks[m, 2] and masks[m, 1] <= cy <= masks[m, 3]:
                fate = MASKED
        if fate:
            spot[FATE] = fate
            count += 1
            continue
        cells = (wx1 - wx0) * (wy1 - wy0)
        if pixels.shape[1] < cells + SPARE:
            pixels = room_for(cells)
        n = _gather_window(image, wx0, wx1, wy0, wy1, pixels)
        spot[LEVEL], spot[SLOPE_X], spot[SLOPE_Y] = _ring_background(
            pixels, n, wx1 - wx0, wy1 - wy0, base, rough, faintest
        )
        area, share = _shape(pixels, n, wx0, wx1, wy0, wy1, spot)
        if spot[SHOULDER] == 0.0 and _looks_single(component, spot, area) and not _at_edge(image, x0, x1, y0, y1):
            spot[FATE] = _judge(spot, area, share, faintest, largest_radius)
            count += 1
            continue
        if labels.shape[0] < cells:
            labels = np.empty(cells, np.int32)
        n_regions = watershed(image, thresholds, wx0, wx1, wy0, wy1, base, rough, labels, regions)
        keep_group(labels[:cells], regions, n_regions, component)
        count = _measure_regions(
            image, labels, regions, n_regions, spot.copy(), faintest, largest_radius, spots, count, pixels
        )
    return count


@compiled
def _region_boxes(image, labels, regions, n_regions, whole, boxes, cut):
    """Boxes (n, 4) x0, x1, y0, y1 (exclusive ends) of the upper part of every region, above what surrounds it.

    Lower down a region's pixels are shared out between neighbours by chance. ``cut`` (n,) is set where a region
    reaches the edge of the image. Returns how many regions have any pixel.
    """
    wx0, wx1, wy0, wy1 = int(whole[WX0]), int(whole[WX1]), int(whole[WY0]), int(whole[WY1])
    boxes[:, 0], boxes[:, 1], boxes[:, 2], boxes[:, 3] = wx1, wx0, wy1, wy0
    cut[:] = False
    for y in range(wy0, wy1):
        for x in range(wx0, wx1):
            region = labels[(y - wy0) * (wx1 - wx0) + x - wx0]
            if region < 0:
                continue
            cut[region] |= _at_edge(image, x, x + 1, y, y + 1)
            foot = max(regions[region, 1], whole[LEVEL])
            if image[y, x] > foot + UPPER_PART * (regions[region, 0] - foot):
                box = boxes[region]
                box[0], box[1] = min(box[0], x), max(box[1], x + 1)
                box[2], box[3] = min(box[2], y), max(box[3], y + 1)
    count = 0
    for region in range(n_regions):
        count += boxes[region, 0] < boxes[region, 1]
    return count


@compiled
def _ring_quartile(image, x0, x1, y0, y1):
    """The lower quartile of a window's outermost pixels: its surroundings, whatever shines into it from one side."""
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


@compiled
def _measure_regions(image, labels, regions, n_regions, whole, faintest, largest_radius, spots, count, pixels):
    """Measure every region of a split component as a spot of its own; return the new number of spots."""
    wx0, wx1, wy0, wy1 = int(whole[WX0]), int(whole[WX1]), int(whole[WY0]), int(whole[WY1])
    width = wx1 - wx0
    boxes, cut = np.empty((max(n_regions, 1), 4), np.int64), np.empty(max(n_regions, 1), np.bool_)
    alone = _region_boxes(image, labels, regions, n_regions, whole, boxes, cut)
    for region in range(n_regions):
        if boxes[region, 0] >= boxes[region, 1] or count == spots.shape[0]:
            continue
        x0, x1 = max(boxes[region, 0] - REGION_MARGIN_PX, wx0), min(boxes[region, 1] + REGION_MARGIN_PX, wx1)
        y0, y1 = max(boxes[region, 2] - REGION_MARGIN_PX, wy0), min(boxes[region, 3] + REGION_MARGIN_PX, wy1)
        spot = spots[count]
        spot[:] = whole
        spot[WX0], spot[WX1], spot[WY0], spot[WY1] = x0, x1, y0, y1
        spot[TOUCHING] = alone > 1
        around = _ring_quartile(image, x0, x1, y0, y1)
        n = _gather_window(image, x0, x1, y0, y1, pixels)
        spot[LEVEL], spot[SLOPE_X], spot[SLOPE_Y] = _ring_background(
            pixels, n, x1 - x0, y1 - y0, around, whole[NOISE], faintest
        )
        for y in range(y0, y1):
            for x in range(x0, x1):
                # The free surroundings count as the spot's own; other regions do not.
                if labels[(y - wy0) * width + x - wx0] not in (region, -1):
                    pixels[COUNTS, (y - y0) * (x1 - x0) + x - x0] = ZERO
        area, share = _shape(pixels, n, x0, x1, y0, y1, spot)
        spot[FATE] = AT_EDGE if cut[region] else _judge(spot, area, share, faintest, largest_radius)
        count += 1
    return count
