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

from asterism.server.centres.edge_sums import BLUR, COUNT, CX, CY, LIT_1, LIT_2, LIT_FOUND, LIT_READ, PARAMETERS
from asterism.server.centres.even_profile import AT, AWAY_X, AWAY_Y, EDGE_KNOT, LEFT, LIT, STEEP, WEIGHT, spacing_of
from asterism.server.compiled import compiled
from asterism.server.segmentation.pixels import PX, PY

ZONES = -3.5, -1.0, 0.0, 1.0  # sigmas of blur from the edge, inwards: where one zone of distance ends
LEAST_PIXELS = 6.0  # of a zone, to tell anything
TAKEN = 4  # degrees of freedom, by shift and slopes
# Sums of a zone: dipole and quadrupole, information and score; pixels.
XX, XY, YY, DX, DY, CC, CS, SS, QC, QS, PIXELS = range(11)
ZONE_SUMS = 11


class Moved(NamedTuple):
    """A step of the centre, px, and of the slopes, grey levels per px."""

    x: float
    y: float
    u: float
    v: float


@compiled
def zone_room():
    """Empty (zones, ZONE_SUMS)."""
    return np.empty((5, ZONE_SUMS))


@compiled
def _in_zone(information_xx, information_xy, information_yy, x, y):
    """Chi squared of two scores, and how many degrees of freedom it has."""
    det = information_xx * information_yy - information_xy * information_xy
    if not det > 1e-3 * information_xx * information_yy:
        return 0.0, 0.0
    return (information_yy * x * x - 2.0 * information_xy * x * y + information_xx * y * y) / det, 2.0


@compiled
def add_up_zones(pixels, n, p, moved, floor, rows, zones, sums):
    """Sums of the zones over what `free_step`, which has moved the centre and the slopes by ``moved``, left.

    ``rows`` are `even_profile`'s; ``floor`` is the pixels' variance without light. Fills LIT_ and COUNT of ``sums`` as
    `edge_sums.add_up_centre` does; returns chi squared.
    """
    zones[:, :] = 0.0
    scale = p[BLUR] / spacing_of(p)
    edge_0, edge_1 = EDGE_KNOT + ZONES[0] * scale, EDGE_KNOT + ZONES[1] * scale
    edge_2, edge_3 = EDGE_KNOT + ZONES[2] * scale, EDGE_KNOT + ZONES[3] * scale
    chi2 = count = lit_1 = lit_2 = lit_read = lit_found = 0.0
    for i in range(n):
        w = float(rows[WEIGHT, i])
        if w == 0.0:
            continue
        at, steep, lit = float(rows[AT, i]), float(rows[STEEP, i]), float(rows[LIT, i])
        x, y = float(rows[AWAY_X, i]), float(rows[AWAY_Y, i])
        dx, dy = float(pixels[PX, i]) - p[CX], float(pixels[PY, i]) - p[CY]
        left = float(rows[LEFT, i]) - steep * (x * moved.x + y * moved.y) - dx * moved.u - dy * moved.v
        zone = zones[int(at > edge_0) + int(at > edge_1) + int(at > edge_2) + int(at > edge_3)]
        c, s = x * x - y * y, 2.0 * x * y
        wr = w * left
        zone[XX] += w * x * x
        zone[XY] += w * x * y
        zone[YY] += w * y * y
        zone[DX] += wr * x
        zone[DY] += wr * y
        zone[CC] += w * c * c
        zone[CS] += w * c * s
        zone[SS] += w * s * s
        zone[QC] += wr * c
        zone[QS] += wr * s
        zone[PIXELS] += 1.0
        chi2 += wr * left
        count += 1.0
        wl = w * w * lit
        lit_1 += w * lit
        lit_2 += wl * lit
        lit_read += wl * floor
        lit_found += wl * left * left
    sums[COUNT], sums[LIT_1], sums[LIT_2], sums[LIT_READ], sums[LIT_FOUND] = count, lit_1, lit_2, lit_read, lit_found
    return chi2


@compiled
def judge_zones(zones, chi2, count, determined):
    """Chi squared per degree of freedom of what is neither even nor a dipole, and how much odd light there is beyond
    noise: the chi squared of the dipoles, in units of that, beyond its own expectation by more than one sigma.

    ``determined`` parameters beside those of the model have been fitted to the ``count`` pixels.
    """
    odd = freedom = 0.0
    dof = count - PARAMETERS - determined
    for k in range(zones.shape[0]):
        zone = zones[k]
        if zone[PIXELS] < LEAST_PIXELS:
            continue
        found, free = _in_zone(zone[XX], zone[XY], zone[YY], zone[DX], zone[DY])
        odd += found
        freedom += free
        found, free = _in_zone(zone[CC], zone[CS], zone[SS], zone[QC], zone[QS])
        chi2 -= found
        dof -= free
    freedom = max(freedom - TAKEN, 0.0)
    misfit = (chi2 - odd) / max(dof - freedom, 1.0)
    beyond = odd / max(misfit, 1.0) - freedom - math.sqrt(2.0 * freedom)
    return misfit, max(beyond, 0.0)
