"""How odd about its centre the light of a spot is: what tells that the centre may be off, where noise does not.

Once all that is even is free (`even_profile`), light that is not symmetric (coma, other light, a shadow) is what can
still move the centre. A shift makes residuals proportional to the profile's slope times cos(direction); light of any
other dependence on the distance shows in the residuals' dipoles: in each of five zones of distance, D = sum(w r e) with
e the outward unit vector and W = sum(w e e^T), chi squared sum(D^T W^-1 D), of which shift and slopes have taken four
degrees of freedom. What the shift has taken of the odd light is not seen; without knowing its kind, as much is expected
along the shift as is left beside it: the centre's variance is raised by one part for every unit of chi squared beyond
what noise explains (within a factor of two for coma and for light beside the spot of any size). A quadrupole is even:
it is taken off chi squared, and off the degrees of freedom, zone by zone.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.server.centres.edge_sums import BLUR, COUNT, CX, CY, LIT_1, LIT_2, LIT_FOUND, LIT_READ
from asterism.server.centres.even_profile import AT, AWAY_X, AWAY_Y, EDGE_KNOT, LEFT, LIT, STEEP, WEIGHT, spacing_of
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.pixels import LANES, ONE, PX, PY, TWO, ZERO, f32

ZONES = -99.0, -3.5, -1.0, 0.0, 1.0, 99.0  # sigmas of blur from the edge, inwards: where zones of distance end
# Sums of a zone.
XX, XY, YY, DX, DY, CC, CS, SS, QC, QS, PIXELS = range(11)
ZONE_SUMS = 11
LEAST_PIXELS = 6.0  # of a zone, to tell anything
TAKEN = 4  # degrees of freedom, by shift and slopes


class Moved(NamedTuple):
    """A step of the centre, px, and of the slopes, grey levels per px."""

    x: float
    y: float
    u: float
    v: float


@compiled_sums
def take_step(pixels, n, p, moved, floor, rows, sums):
    """Change what is left in ``rows`` (`even_profile`) by the step ``moved`` that has led to ``p``; return chi squared.

    ``floor`` is the pixels' variance without light. Fills LIT_ and COUNT of ``sums`` as `edge_sums.add_up_centre` does.
    """
    xs, ys = pixels[PX], pixels[PY]
    lefts, weights, steeps, lits = rows[LEFT], rows[WEIGHT], rows[STEEP], rows[LIT]
    aways_x, aways_y = rows[AWAY_X], rows[AWAY_Y]
    cx, cy, floor = f32(p[CX]), f32(p[CY]), f32(floor)
    by_x, by_y, by_u, by_v = f32(moved.x), f32(moved.y), f32(moved.u), f32(moved.v)
    chi2 = count = lit_1 = lit_2 = lit_read = lit_found = ZERO
    for i in range(n // LANES * LANES):
        w, lit = weights[i], lits[i]
        shift = steeps[i] * (aways_x[i] * by_x + aways_y[i] * by_y) + (xs[i] - cx) * by_u + (ys[i] - cy) * by_v
        left = lefts[i] - shift
        lefts[i] = left
        chi2 += w * left * left
        count += ONE if w > ZERO else ZERO
        wl = w * w * lit
        lit_1 += w * lit
        lit_2 += wl * lit
        lit_read += wl * floor
        lit_found += wl * left * left
    sums[COUNT], sums[LIT_1], sums[LIT_2], sums[LIT_READ], sums[LIT_FOUND] = count, lit_1, lit_2, lit_read, lit_found
    return chi2


@compiled_sums
def add_up_zone(rows, n, low, high, zone):
    """Fill ``zone`` (ZONE_SUMS,): dipole and quadrupole of what is left between two places ``low`` and ``high`` among
    the knots, information and score; pixels.
    """
    ats, lefts, weights, aways_x, aways_y = rows[AT], rows[LEFT], rows[WEIGHT], rows[AWAY_X], rows[AWAY_Y]
    low, high = f32(low), f32(high)
    xx = xy = yy = dx = dy = cc = cs = ss = qc = qs = count = ZERO
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
        count += ONE if w > ZERO else ZERO
    zone[XX], zone[XY], zone[YY], zone[DX], zone[DY] = xx, xy, yy, dx, dy
    zone[CC], zone[CS], zone[SS], zone[QC], zone[QS], zone[PIXELS] = cc, cs, ss, qc, qs, count


@compiled
def _explained(xx, xy, yy, x, y):
    """Chi squared that two scores explain, given their information, and how many degrees of freedom that is."""
    det = xx * yy - xy * xy
    if not det > 1e-3 * xx * yy:
        return 0.0, 0.0
    return (yy * x * x - 2.0 * xy * x * y + xx * y * y) / det, 2.0


@compiled
def judge(rows, n, p, chi2, dof):
    """Chi squared per degree of freedom of what is neither even nor a dipole, and how much odd light there is beyond
    noise: the chi squared of the dipoles, in units of that, beyond its own expectation by more than one sigma.

    ``chi2`` and ``dof`` are those of what is left in ``rows`` at the parameters ``p``.
    """
    zone = np.empty(ZONE_SUMS)
    odd = freedom = 0.0
    scale = p[BLUR] / spacing_of(p)
    for k in range(len(ZONES) - 1):
        add_up_zone(rows, n, EDGE_KNOT + ZONES[k] * scale, EDGE_KNOT + ZONES[k + 1] * scale, zone)
        if zone[PIXELS] < LEAST_PIXELS:
            continue
        found, free = _explained(zone[XX], zone[XY], zone[YY], zone[DX], zone[DY])
        odd += found
        freedom += free
        found, free = _explained(zone[CC], zone[CS], zone[SS], zone[QC], zone[QS])
        chi2 -= found
        dof -= free
    freedom = max(freedom - TAKEN, 0.0)
    misfit = (chi2 - odd) / max(dof - freedom, 1.0)
    beyond = odd / max(misfit, 1.0) - freedom - math.sqrt(2.0 * freedom)
    return misfit, max(beyond, 0.0)
