"""Four spots as four LEDs of a plate, in any perspective: whether there is a pose that sees them so, and the map it is.

Plate points X (2,), from the four's mean; spots x (2,) in the plane that touches the sphere of directions at one of
them. A pose gives x w = A X + b with the relative depth w = 1 + g X of a point: A is two columns of a rotation over
the depth, g the third's share, so A'A + g g' = k^2 times the identity, k = 1 / depth. For a given depth gradient g the
rest is linear: the affine map that fits the x w best, and what it leaves along the one affine dependency of the four
plate points, r = r0 + C g. So two unknowns answer for two numbers r and the two by which A'A + g g' is no multiple of
the identity; Gauss and Newton settle them in two or three steps from the gradients that the weak perspective (g = 0)
implies, whose sign it leaves open, or from none. That a plate's weak perspective tells its tilt up to the sign:
Oberkampf, DeMenthon and Davis, "Iterative pose estimation using coplanar feature points", CVIU 1996, whose own
iteration does not converge for near plates seen from nearly in front.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled

# Columns of an entry's numbers: its invariants; what makes of four spots' x or y a row of the affine map from the plate
# that fits them best (2 x 4, 1 / m), and the length of that; the affine dependency of the four LEDs (4, a unit vector);
# the LEDs from their mean (4 x 2), and that (2), m.
AFFINE, DEPENDENCY, POINTS, MIDDLE, NOISE, NUMBERS = 2, 10, 14, 22, 24, 25
# Sums of an entry and four spots: A for g = 0, by rows (from 0 on), its derivatives by both of g, r0 (12, 13), C by
# rows (14 to 17); the noise of r and of A's numbers, one sigma.
A1, A2, SIGMA, TAU, SUMS = 4, 8, 18, 19, 20

STEPS = 3
SETTLED = 14.0  # squared sigmas: four numbers, 99.3 % of chi squared
# What the start leaves of r, over sin(tilt) and the square of the four's size, and what its first step promises: of
# nine in ten quads of plates that are as wide as half their distance. Five LEDs make five quads, six fifteen.
START, FIRST = 0.45, 0.08


class View(NamedTuple):
    """How a plate may be seen: at a depth of 1 / ``most`` to 1 / ``least`` m, tilted by no more than the angle with
    cosine ``most_tilt``; its spots may be ``sigma`` rad off; ``least_area``: four that span less say nothing.
    """

    least: float
    most: float
    most_tilt: float
    sigma: float
    least_area: float


def numbers_of(points: Floats, s: float, t: float) -> Floats:
    """A row of a table's numbers for four LEDs (4, 2) with invariants ``s`` and ``t``."""
    middle = points.mean(axis=0)
    away = points - middle
    affine = np.linalg.pinv(away)
    dependency = np.linalg.svd(np.column_stack([away, np.full(4, np.abs(away).max())]).T)[2][3]
    noise = math.sqrt(0.5 * float((affine**2).sum()))
    return np.concatenate([[s, t], affine.ravel(), dependency, away.ravel(), middle, [noise]])


@compiled
def _sum_up(numbers, four, order, sums):
    """Fill A, r0 and C of the ``sums``; returns the square of the four's size."""
    p00 = p01 = p10 = p11 = r0 = r1 = c00 = c01 = c10 = c11 = far = 0.0
    x0, y0 = four[order[0], 0], four[order[0], 1]
    for i in range(4):
        x, y = four[order[i], 0], four[order[i], 1]
        u, v, n = numbers[AFFINE + i], numbers[AFFINE + 4 + i], numbers[DEPENDENCY + i]
        far = max(far, (x - x0) ** 2 + (y - y0) ** 2)
        p00 += x * u
        p01 += x * v
        p10 += y * u
        p11 += y * v
        nx, ny, px, py = n * x, n * y, numbers[POINTS + 2 * i], numbers[POINTS + 2 * i + 1]
        r0 += nx
        r1 += ny
        c00 += nx * px
        c01 += nx * py
        c10 += ny * px
        c11 += ny * py
    sums[0], sums[1], sums[2], sums[3], sums[12], sums[13] = p00, p01, p10, p11, r0, r1
    sums[14], sums[15], sums[16], sums[17] = c00, c01, c10, c11
    return far


@compiled
def _sum_up_derivatives(numbers, four, order, sums):
    """Fill the derivatives of A by g."""
    sums[A1 : A2 + 4] = 0.0
    for i in range(4):
        x, y = four[order[i], 0], four[order[i], 1]
        u, v = numbers[AFFINE + i], numbers[AFFINE + 4 + i]
        px, py = numbers[POINTS + 2 * i], numbers[POINTS + 2 * i + 1]
        sums[4] += px * x * u
        sums[5] += px * x * v
        sums[6] += px * y * u
        sums[7] += px * y * v
        sums[8] += py * x * u
        sums[9] += py * x * v
        sums[10] += py * y * u
        sums[11] += py * y * v


@compiled
def _settle(sums, a, b, most):
    """Gauss and Newton from the depth gradient (a, b); returns the squared sigmas that it leaves, and the gradient.

    It ends where a step promises to leave more than ``most``.
    """
    c00, c01, c10, c11 = sums[14], sums[15], sums[16], sums[17]
    wr = 1.0 / sums[SIGMA] ** 2
    left = np.inf
    for step in range(STEPS + 1):
        p00, p01 = sums[0] + a * sums[4] + b * sums[8], sums[1] + a * sums[5] + b * sums[9]
        p10, p11 = sums[2] + a * sums[6] + b * sums[10], sums[3] + a * sums[7] + b * sums[11]
        q0, q1 = p00 * p00 + p10 * p10 + a * a, p01 * p01 + p11 * p11 + b * b
        k2 = 0.5 * (q0 + q1)
        f0, f1 = q0 - q1, 2.0 * (p00 * p01 + p10 * p11 + a * b)
        wf = 0.25 / (sums[TAU] ** 2 * k2)
        e0, e1 = sums[12] + c00 * a + c01 * b, sums[13] + c10 * a + c11 * b
        r2, f2 = wr * (e0 * e0 + e1 * e1), wf * (f0 * f0 + f1 * f1)
        left = r2 + f2
        if left <= 0.5 * SETTLED or step == STEPS:
            break
        j00 = 2.0 * (p00 * sums[4] + p10 * sums[6] + a - p01 * sums[5] - p11 * sums[7])
        j01 = 2.0 * (p00 * sums[8] + p10 * sums[10] - b - p01 * sums[9] - p11 * sums[11])
        j10 = 2.0 * (sums[4] * p01 + p00 * sums[5] + sums[6] * p11 + p10 * sums[7] + b)
        j11 = 2.0 * (sums[8] * p01 + p00 * sums[9] + sums[10] * p11 + p10 * sums[11] + a)
        h00 = wr * (c00 * c00 + c10 * c10) + wf * (j00 * j00 + j10 * j10)
        h01 = wr * (c00 * c01 + c10 * c11) + wf * (j00 * j01 + j10 * j11)
        h11 = wr * (c01 * c01 + c11 * c11) + wf * (j01 * j01 + j11 * j11)
        d0 = wr * (c00 * e0 + c10 * e1) + wf * (j00 * f0 + j10 * f1)
        d1 = wr * (c01 * e0 + c11 * e1) + wf * (j01 * f0 + j11 * f1)
        det = h00 * h11 - h01 * h01
        da, db = (h11 * d0 - h01 * d1) / det, (h00 * d1 - h01 * d0) / det
        if not left - da * d0 - db * d1 <= most:
            return np.inf, a, b
        a -= da
        b -= db
    return left, a, b


@compiled
def _fill_map(numbers, four, order, sums, a, b, h):
    """Fill ``h`` (3, 3), from the plate to the tangent plane, for a depth gradient; False if an LED lies behind."""
    mx = my = 0.0
    for i in range(4):
        weight = 1.0 + a * numbers[POINTS + 2 * i] + b * numbers[POINTS + 2 * i + 1]
        if not weight > 0.0:
            return False
        mx += 0.25 * weight * four[order[i], 0]
        my += 0.25 * weight * four[order[i], 1]
    cx, cy = numbers[MIDDLE], numbers[MIDDLE + 1]
    for i in range(2):
        h[i, 0] = sums[2 * i] + a * sums[4 + 2 * i] + b * sums[8 + 2 * i]
        h[i, 1] = sums[2 * i + 1] + a * sums[5 + 2 * i] + b * sums[9 + 2 * i]
        h[i, 2] = (mx if i == 0 else my) - h[i, 0] * cx - h[i, 1] * cy
    h[2, 0], h[2, 1], h[2, 2] = a, b, 1.0 - a * cx - b * cy
    return True


@compiled
def explains(numbers, four, order, view, sums, h):
    """Whether four LEDs with those ``numbers`` are seen as ``four`` (4, 2) spots in some pose within the `View`.

    ``order`` (4,) of the spots; ``sums`` (SUMS,) is scratch. Fills the map ``h`` (3, 3) from the plate's coordinates to
    the spots' tangent plane.
    """
    size2 = _sum_up(numbers, four, order, sums)
    p00, p01, p10, p11 = sums[0], sums[1], sums[2], sums[3]
    det = p00 * p11 - p01 * p10
    m00, m01, m11 = p00 * p00 + p10 * p10, p00 * p01 + p10 * p11, p01 * p01 + p11 * p11
    both = m00 + m11
    large2 = 0.5 * (both + math.sqrt(max(both * both - 4.0 * det * det, 0.0)))
    # The weak perspective errs by about the four's size.
    doubt = 1.0 + math.sqrt(size2)
    if det <= 0.0 or large2 * doubt * doubt < view.least**2 or large2 > (view.most * doubt) ** 2:
        return False
    if det * doubt * doubt < view.most_tilt * large2:
        return False
    a, b = math.sqrt(max(large2 - m00, 0.0)), math.sqrt(max(large2 - m11, 0.0))
    if m01 > 0.0:
        b = -b
    flatness = math.sqrt((a * a + b * b) / large2)
    most = 4.0 * view.sigma + (START * flatness + 0.1) * size2
    promised = (math.sqrt(SETTLED) + FIRST * size2 / view.sigma) ** 2
    best, best_a, best_b, begun = np.inf, 0.0, 0.0, False
    for sign in range(-1, 2):
        at, bt = sign * a, sign * b
        e0, e1 = sums[12] + sums[14] * at + sums[15] * bt, sums[13] + sums[16] * at + sums[17] * bt
        if e0 * e0 + e1 * e1 > most * most:
            continue
        if not begun:
            _sum_up_derivatives(numbers, four, order, sums)
            sums[SIGMA], sums[TAU], begun = view.sigma, view.sigma * numbers[NOISE], True
        left, at, bt = _settle(sums, at, bt, promised)
        if left < best:
            best, best_a, best_b = left, at, bt
    return best <= SETTLED and _fill_map(numbers, four, order, sums, best_a, best_b, h)
