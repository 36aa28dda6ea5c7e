"""Light that lies to one side of all LEDs of a robot alike: it moves their centres together, and leaves no residual.

What an LED spills on its plate, or on a polished floor, is dim: a spot's own fit takes it for a shift of a hundredth of
a pixel, and its noise hides that. All LEDs of a robot together tell. In a ring at the foot of every spot's profile the
light above the surroundings' plane is explained by r = h(d) + D e, h a parabola of the distance, which takes what is
even, e the outward unit vector; D is the dipole, grey levels. At the edge, where the profile rises by HEIGHT within
sqrt(2 pi) blurs, D would move the centre by c = D sqrt(2 pi) blur / HEIGHT, px: residuals D e and a shift's, slope e c,
are the same there. Nearer than the ring there is more of such light, and the fitted slopes take some of it: the
centre moves by TOWARDS times as much. Rendered, for spots of 1.8 to 5 px under blurs of 0.65 to 1.1 px, that factor is
1.3 for broad glows (sigma 1 to 4 radii, 0.5 to 3 radii off), 3.2 for steep ones (0.5 to 1.5 radii, 0.2 to 1 off) and 6
for images of the LED 0.1 to 1 radii off; which light it is cannot be seen. TOWARDS is that of the middle: within a
factor of two or so for all. Across c the shift had a third of it, where two lights were not of the same reach.

So what is known of a robot's common shift is a covariance: TOWARDS^2 (c c' + (ACROSS |c|)^2), c the mean over its
LEDs, weighted by what their centres tell. How well that mean is known, its LEDs' scatter about it tells: light beside a
single one, texture, noise, are no common light. Only what is in excess counts, shrunk as James and Stein do. Spots that
were centred together with the light that leans on them (`leaning_spots`) do not tell: that light is explained. What a
LED's ring says beyond the mean is its own (`own_light`).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.centres.blurred_ellipse import distance_to_ellipse
from asterism.server.centres.edge_steps import BLUR_PX
from asterism.server.centres.near_spots import MOST_NEIGHBOURS, in_order, neighbours_of
from asterism.server.centres.own_light import Ring, usual_surroundings, widen
from asterism.server.centres.window import leave_out
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.pixels import COUNTS, GREY, LANES, PX, PY, ZERO, Box, f32, gather_box, pad, room_for
from asterism.server.segmentation.spot_table import (
    ANGLE,
    HEIGHT,
    LEVEL,
    NOISE,
    SEMI_A,
    SEMI_B,
    SHOULDER,
    SLOPE_X,
    SLOPE_Y,
    X,
    Y,
)

NEAREST_PX, FARTHEST_PX = 1.25, 2.5  # of the ring, from the spot's edge
TOO_LARGE_PX = 0.28  # by how much moments find semi-axes too large
SPARE_PX = 2.0  # of a neighbour's light, beyond what its fit leaves out
TOWARDS, ACROSS = 3.2, 0.33
EXCESS = 8.2  # mean shift squared over its variance along an axis, up to which it is noise: twice 95 % of F(2, 10)
LEAST_PIXELS = 20.0  # of a ring
LEAST_LEDS = 2.5  # of a robot, as their weights count
LEAST_SIGMA_PX = 0.005  # of a centre, so that one does not speak for all
RING_SUMS = 19


class RingRoom(NamedTuple):
    """Room for the ring of a spot: its ``pixels``, ``sums`` (RING_SUMS,), the ``equations`` (5, 6) of its dipole."""

    pixels: Any
    sums: Any
    equations: Any


@compiled_sums
def _add_up_ring(pixels, n, spot, centre, sums):
    """Fill ``sums`` (RING_SUMS,) over the ring's pixels, told from ``centre`` (2,), with d the distance to the ring's
    middle, (x, y) the outward direction, z the light above the surroundings: number, d, d^2, d^3, d^4, x, y, dx, dy,
    ddx, ddy, xx, xy, yy, z, dz, ddz, xz, yz.
    """
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    level = f32(spot[LEVEL] + spot[SLOPE_X] * (centre[0] - spot[X]) + spot[SLOPE_Y] * (centre[1] - spot[Y]))
    slope_x, slope_y = f32(spot[SLOPE_X]), f32(spot[SLOPE_Y])
    a, b = max(spot[SEMI_A] - TOO_LARGE_PX, 0.5), max(spot[SEMI_B] - TOO_LARGE_PX, 0.5)
    per_a2, per_b2 = f32(1.0 / (a * a)), f32(1.0 / (b * b))
    cos, sin = f32(math.cos(spot[ANGLE])), f32(math.sin(spot[ANGLE]))
    middle, half = f32(0.5 * (NEAREST_PX + FARTHEST_PX)), f32(0.5 * (FARTHEST_PX - NEAREST_PX))
    number = d1 = d2 = d3 = d4 = sx = sy = sdx = sdy = sddx = sddy = sxx = sxy = syy = ZERO
    sz = sdz = sddz = sxz = syz = ZERO
    for i in range(n // LANES * LANES):
        dx, dy = xs[i], ys[i]
        _, _, pu, pv, distance, outward, bend = distance_to_ellipse(dx, dy, cos, sin, per_a2, per_b2)
        du, dv = pu * (outward - bend * per_a2), pv * (outward - bend * per_b2)
        x, y = dv * sin - du * cos, -du * sin - dv * cos
        d = -distance - middle
        w = counts[i] if abs(d) < half else ZERO
        z = w * (values[i] - level - slope_x * dx - slope_y * dy)
        wd, wx, wy = w * d, w * x, w * y
        wdd = wd * d
        number += w
        d1 += wd
        d2 += wdd
        d3 += wdd * d
        d4 += wdd * d * d
        sx += wx
        sy += wy
        sdx += wd * x
        sdy += wd * y
        sddx += wdd * x
        sddy += wdd * y
        sxx += wx * x
        sxy += wx * y
        syy += wy * y
        sz += z
        sdz += z * d
        sddz += z * d * d
        sxz += z * x
        syz += z * y
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5], sums[6] = number, d1, d2, d3, d4, sx, sy
    sums[7], sums[8], sums[9], sums[10], sums[11], sums[12], sums[13] = sdx, sdy, sddx, sddy, sxx, sxy, syy
    sums[14], sums[15], sums[16], sums[17], sums[18] = sz, sdz, sddz, sxz, syz


@compiled
def _dipole(sums, m):
    """The dipole x, y of a ring's light, grey levels, how many pixels tell of an axis, and whether it is told.

    ``m`` (5, 6) is room: the normal equations of 1, d, d^2, x, y, of which the first three, which are even, go.
    """
    for i in range(3):
        for j in range(3):
            m[i, j] = sums[i + j]
        m[i, 3], m[i, 4], m[i, 5] = sums[5 + 2 * i], sums[6 + 2 * i], sums[14 + i]
        m[3, i], m[4, i] = m[i, 3], m[i, 4]
    m[3, 3], m[3, 4], m[3, 5] = sums[11], sums[12], sums[17]
    m[4, 3], m[4, 4], m[4, 5] = sums[12], sums[13], sums[18]
    for k in range(3):
        if not m[k, k] > 1e-3:
            return 0.0, 0.0, 0.0, False
        for i in range(k + 1, 5):
            share = m[i, k] / m[k, k]
            for j in range(k, 6):
                m[i, j] -= share * m[k, j]
    xx, xy, yy = m[3, 3], m[3, 4], m[4, 4]
    det = xx * yy - xy * xy
    if sums[0] < LEAST_PIXELS or not det > 0.1 * xx * yy:
        return 0.0, 0.0, 0.0, False
    return (yy * m[3, 5] - xy * m[4, 5]) / det, (xx * m[4, 5] - xy * m[3, 5]) / det, 2.0 * det / (xx + yy), True


@compiled
def _gather_ring(image, spot, centre, neighbours, pixels):
    """The pixels about a spot as far as its ring, told from its ``centre``: how many."""
    reach = spot[SEMI_A] + FARTHEST_PX
    box = Box(
        max(int(centre[0] - reach), 0),
        min(int(centre[0] + reach) + 2, image.shape[1]),
        max(int(centre[1] - reach), 0),
        min(int(centre[1] + reach) + 2, image.shape[0]),
    )
    count = pad(pixels, 0, gather_box(image, box, centre[0], centre[1], pixels, 0))
    leave_out(pixels, count, neighbours, centre[0], centre[1])
    return count


@compiled
def _pool(shifts, common):
    """Fill ``common`` (3,) from the ``shifts`` (k, 4) of a robot's spots: x, y, variance, px^2, and weight; returns the
    mean x, y, as far as it is beyond noise.
    """
    whole = squares = x = y = 0.0
    for k in range(shifts.shape[0]):
        weight = shifts[k, 3]
        whole += weight
        squares += weight * weight
        x += weight * shifts[k, 0]
        y += weight * shifts[k, 1]
    if not whole * whole > LEAST_LEDS * squares:
        return 0.0, 0.0
    x, y = x / whole, y / whole
    noise = scatter = 0.0
    for k in range(shifts.shape[0]):
        share = (shifts[k, 3] / whole) ** 2
        noise += share * shifts[k, 2]
        scatter += 0.5 * share * ((shifts[k, 0] - x) ** 2 + (shifts[k, 1] - y) ** 2)
    noise = max(noise, scatter / (1.0 - squares / (whole * whole)))
    size2 = x * x + y * y
    excess = 1.0 - EXCESS * noise / max(size2, 1e-18)
    if not excess > 0.0:
        return 0.0, 0.0
    scale = excess * TOWARDS * TOWARDS
    around = ACROSS * ACROSS * size2
    common[0], common[1], common[2] = scale * (x * x + around), scale * x * y, scale * (y * y + around)
    return excess * x, excess * y


@compiled
def _look(image, spots, k, centre, neighbours, room):
    """What the ring of spot ``k`` tells (`Ring`): as far as there is any, of a shift of its centre."""
    spot = spots[k]
    n = _gather_ring(image, spot, centre, neighbours, room.pixels)
    _add_up_ring(room.pixels, n, spot, centre, room.sums)
    x, y, number, is_told = _dipole(room.sums, room.equations)
    by = math.sqrt(2.0 * math.pi) * BLUR_PX / spot[HEIGHT]
    return Ring(by * x, by * y, (by * spot[NOISE]) ** 2 / max(number, 1e-9), is_told)


@compiled
def find_common_light(image, spots, robots, centres, covariances, widened, commons):
    """Fill ``commons`` (m, 3) xx, xy, yy px^2: how far, one sigma, all spots of a robot may be off together, 0 where no
    light beside them says so; and widen the ``covariances`` of single spots by what leans on them alone.

    ``spots`` is the spot table; ``robots`` (m, 6) are the rows of the spots of every robot's LEDs, -1 for those not
    seen; ``centres`` (n, 2) px and ``covariances`` (n, 3) px^2 are those of the spots; those that are ``widened`` (n,)
    are told. Returns how many that are.
    """
    commons[:, :] = 0.0
    order, places, widest = in_order(spots)
    largest = 0.0
    for k in robots.flat:
        if k >= 0:
            largest = max(largest, spots[k, SEMI_A])
    room = RingRoom(room_for((2.0 * (largest + FARTHEST_PX) + 4.0) ** 2), np.empty(RING_SUMS), np.empty((5, 6)))
    neighbours, other, count_widened = np.empty((MOST_NEIGHBOURS, 3)), np.empty(6), 0
    floor, excess = usual_surroundings(spots)
    shifts, rings = np.empty((robots.shape[1], 4)), np.empty((robots.shape[1], 3))
    for robot in range(robots.shape[0]):
        told = 0
        for led in range(robots.shape[1]):
            k = robots[robot, led]
            rings[led, :] = 0.0
            if k < 0:
                continue
            count = neighbours_of(spots, order, places[k], widest, neighbours, other)
            neighbours[:count, 2] += SPARE_PX
            ring = _look(image, spots, k, centres[k], neighbours[:count], room)
            if not ring.is_told:
                continue
            rings[led, 0], rings[led, 1], rings[led, 2] = ring.x, ring.y, ring.variance
            if spots[k, SHOULDER] ** 2 <= covariances[k, 0]:
                own = 0.5 * (covariances[k, 0] + covariances[k, 2]) + spots[k, SHOULDER] ** 2 + LEAST_SIGMA_PX**2
                shifts[told, 0], shifts[told, 1] = ring.x, ring.y
                shifts[told, 2], shifts[told, 3] = ring.variance, 1.0 / own
                told += 1
        x, y = _pool(shifts[:told], commons[robot])
        for led in range(robots.shape[1]):
            k = robots[robot, led]
            if k >= 0:
                rings[led, 0], rings[led, 1] = rings[led, 0] - x, rings[led, 1] - y
                if widen(spots[k], rings[led], floor, excess, covariances[k]):
                    widened[k] = True
                    count_widened += 1
    return count_widened
