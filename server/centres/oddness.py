"""How odd about its centre the light of a spot is: what tells that the centre may be off, where noise does not.

Once all that is even is free (`even_profile`), light that is not symmetric (coma, other light, a shadow) is what can
still move the centre. A shift makes residuals proportional to the profile's slope times cos(direction); light of any
other dependence on the distance shows in the residuals' dipoles: in each of five zones of distance, D = sum(w r e) with
e the outward unit vector and W = sum(w e e^T), chi squared sum(D^T W^-1 D), of which shift and slopes have taken four
degrees of freedom. What the shift has taken of the odd light is not seen; without knowing its kind, as much is expected
along the shift as is left beside it: the centre's variance is raised by one part for every unit of chi squared beyond
what noise explains (within a factor of two for coma and for light beside the spot of any size). A quadrupole is even:
it is taken off chi squared, and off the degrees of freedom, zone by zone.

A streak is even too, but no ellipse, nor is its misfit a quadrupole alone. The third and fifth harmonics of the
direction, cos and sin of three and five times its angle, are odd, and neither shift nor slopes nor anything even has a
part in them: their chi squared tells of noise and other light, whatever the shape (`picture_noise`).
"""

from typing import NamedTuple

import numpy as np

from asterism.server.centres.edge_sums import BLUR, CHI2, COUNT, CX, CY, LIT_1, LIT_2, LIT_FOUND, LIT_READ, PARAMETERS
from asterism.server.centres.even_profile import AT, AWAY_X, AWAY_Y, EDGE_KNOT, LEFT, LIT, STEEP, WEIGHT, spacing_of
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.pixels import LANES, ONE, PX, PY, TWO, ZERO, f32

ZONES = -99.0, -3.5, -1.0, 0.0, 1.0, 99.0  # sigmas of blur from the edge, inwards: where zones of distance end
# Sums of a zone.
(
    XX, XY, YY, DX, DY, CC, CS, SS, QC, QS, PIXELS,
    XX_3, XY_3, YY_3, DX_3, DY_3, XX_5, XY_5, YY_5, DX_5, DY_5,
) = range(21)  # fmt: skip
ZONE_SUMS = 21
LEAST_PIXELS = 6.0  # of a zone, to tell anything
TAKEN = 4  # degrees of freedom, by shift and slopes


class Odd(NamedTuple):
    """What is left of a spot's light: chi squared per degree of freedom of what is neither even nor a dipole; chi
    squared of the ``dipoles`` and that of the ``finer`` harmonics, each with its degrees of freedom.
    """

    misfit: float
    dipoles: float
    dipoles_freedom: float
    finer: float
    finer_freedom: float


class Moved(NamedTuple):
    """A step of the centre, px, and of the slopes, grey levels per px."""

    x: float
    y: float
    u: float
    v: float


@compiled_sums
def take_step(pixels, n, p, moved, rows):
    """Change what is left in ``rows`` (`even_profile`) by the step ``moved`` that has led to ``p``."""
    xs, ys = pixels[PX], pixels[PY]
    lefts, steeps, aways_x, aways_y = rows[LEFT], rows[STEEP], rows[AWAY_X], rows[AWAY_Y]
    cx, cy = f32(p[CX]), f32(p[CY])
    by_x, by_y, by_u, by_v = f32(moved.x), f32(moved.y), f32(moved.u), f32(moved.v)
    for i in range(n // LANES * LANES):
        shift = steeps[i] * (aways_x[i] * by_x + aways_y[i] * by_y) + (xs[i] - cx) * by_u + (ys[i] - cy) * by_v
        lefts[i] -= shift


@compiled_sums
def add_up_left(rows, n, floor, sums):
    """Chi squared of what is left in ``rows``, and what it says of the sensor's gain: CHI2, COUNT and LIT_ of ``sums``
    as `edge_sums.add_up_centre` fills them. ``floor`` is the pixels' variance without light.
    """
    lefts, weights, lits = rows[LEFT], rows[WEIGHT], rows[LIT]
    floor = f32(floor)
    chi2 = count = lit_1 = lit_2 = lit_read = lit_found = ZERO
    for i in range(n // LANES * LANES):
        w, lit, left = weights[i], lits[i], lefts[i]
        chi2 += w * left * left
        count += ONE if w > ZERO else ZERO
        wl = w * w * lit
        lit_1 += w * lit
        lit_2 += wl * lit
        lit_read += wl * floor
        lit_found += wl * left * left
    sums[CHI2], sums[COUNT] = chi2, count
    sums[LIT_1], sums[LIT_2], sums[LIT_READ], sums[LIT_FOUND] = lit_1, lit_2, lit_read, lit_found


@compiled_sums
def add_up_zone(rows, n, low, high, zone):
    """Fill ``zone`` (ZONE_SUMS,): dipole, quadrupole, third and fifth harmonic of what is left between two places
    ``low`` and ``high`` among the knots, information and score; pixels.
    """
    ats, lefts, weights, aways_x, aways_y = rows[AT], rows[LEFT], rows[WEIGHT], rows[AWAY_X], rows[AWAY_Y]
    low, high = f32(low), f32(high)
    xx = xy = yy = dx = dy = cc = cs = ss = qc = qs = count = ZERO
    xx_3 = xy_3 = yy_3 = dx_3 = dy_3 = xx_5 = xy_5 = yy_5 = dx_5 = dy_5 = ZERO
    for i in range(n // LANES * LANES):
        x, y = aways_x[i], aways_y[i]
        w = weights[i] if ats[i] > low and ats[i] <= high else ZERO
        c, s = x * x - y * y, TWO * x * y
        wr, wx, wc = w * lefts[i], w * x, w * c
        xx += wx * x
        xy += wx * y
        yy += w * y * y
        dx += wr * x
        dy += wr * y
        cc += wc * c
        cs += wc * s
        ss += w * s * s
        qc += wr * c
        qs += wr * s
        x_3, y_3 = x * c - y * s, y * c + x * s
        x_5, y_5 = x_3 * c - y_3 * s, y_3 * c + x_3 * s
        xx_3 += w * x_3 * x_3
        xy_3 += w * x_3 * y_3
        yy_3 += w * y_3 * y_3
        dx_3 += wr * x_3
        dy_3 += wr * y_3
        xx_5 += w * x_5 * x_5
        xy_5 += w * x_5 * y_5
        yy_5 += w * y_5 * y_5
        dx_5 += wr * x_5
        dy_5 += wr * y_5
        count += ONE if w > ZERO else ZERO
    zone[XX], zone[XY], zone[YY], zone[DX], zone[DY] = xx, xy, yy, dx, dy
    zone[CC], zone[CS], zone[SS], zone[QC], zone[QS], zone[PIXELS] = cc, cs, ss, qc, qs, count
    zone[XX_3], zone[XY_3], zone[YY_3], zone[DX_3], zone[DY_3] = xx_3, xy_3, yy_3, dx_3, dy_3
    zone[XX_5], zone[XY_5], zone[YY_5], zone[DX_5], zone[DY_5] = xx_5, xy_5, yy_5, dx_5, dy_5


@compiled_sums
def _subtract_quadrupole(rows, n, low, high, by_c, by_s):
    """Change what is left in a zone by a quadrupole of those amplitudes, grey levels."""
    ats, lefts, aways_x, aways_y = rows[AT], rows[LEFT], rows[AWAY_X], rows[AWAY_Y]
    low, high, by_c, by_s = f32(low), f32(high), f32(by_c), f32(by_s)
    for i in range(n // LANES * LANES):
        x, y = aways_x[i], aways_y[i]
        quadrupole = by_c * (x * x - y * y) + by_s * (TWO * x * y)
        lefts[i] -= quadrupole if ats[i] > low and ats[i] <= high else ZERO


@compiled
def _solve(xx, xy, yy, x, y):
    """Amplitudes of two scores, given their information, and whether there are any."""
    det = xx * yy - xy * xy
    if not det > 1e-3 * xx * yy:
        return 0.0, 0.0, False
    return (yy * x - xy * y) / det, (xx * y - xy * x) / det, True


@compiled
def _chi2(xx, xy, yy, x, y):
    """Chi squared of two scores, given their information, and its degrees of freedom."""
    by_x, by_y, told = _solve(xx, xy, yy, x, y)
    return by_x * x + by_y * y, 2.0 * told


@compiled
def judge(rows, n, p, floor, determined, sums):
    """What is left of a spot's light, as `Odd`.

    ``rows`` hold what is left at the parameters ``p``, of which the quadrupoles are taken; then fills ``sums`` as
    `add_up_left` does. ``determined`` parameters have been fitted beside those of the model.
    """
    zone = np.empty(ZONE_SUMS)
    odd = freedom = finer = finer_freedom = 0.0
    taken = PARAMETERS + determined
    scale = p[BLUR] / spacing_of(p)
    for k in range(len(ZONES) - 1):
        low, high = EDGE_KNOT + ZONES[k] * scale, EDGE_KNOT + ZONES[k + 1] * scale
        add_up_zone(rows, n, low, high, zone)
        if zone[PIXELS] < LEAST_PIXELS:
            continue
        chi2, more = _chi2(zone[XX], zone[XY], zone[YY], zone[DX], zone[DY])
        odd += chi2
        freedom += more
        chi2, more = _chi2(zone[XX_3], zone[XY_3], zone[YY_3], zone[DX_3], zone[DY_3])
        finer += chi2
        finer_freedom += more
        chi2, more = _chi2(zone[XX_5], zone[XY_5], zone[YY_5], zone[DX_5], zone[DY_5])
        finer += chi2
        finer_freedom += more
        x, y, told = _solve(zone[CC], zone[CS], zone[SS], zone[QC], zone[QS])
        _subtract_quadrupole(rows, n, low, high, x, y)
        taken += 2.0 * told
    add_up_left(rows, n, floor, sums)
    freedom = max(freedom - TAKEN, 0.0)
    misfit = (sums[CHI2] - odd) / max(sums[COUNT] - taken - freedom, 1.0)
    return Odd(misfit, odd, freedom, finer, finer_freedom)
