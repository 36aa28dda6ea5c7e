"""Centre of a spot as that of the ellipse through its sub-pixel edge points: Canny, Zernike moments, conic fit.

Edge pixels are the ridges of the smoothed gradient (Canny, "A computational approach to edge detection", PAMI 1986).
Each is moved onto the edge by the Zernike moments of the 7x7 pixels around it: a step edge at distance l from the
middle of the unit disc, its bright side towards phi, has Z11 = |Z11| exp(i phi) and Z20 / |Z11| = l (Ghosal and
Mehrotra, "Orthogonal moment operators for subpixel edge detection", Pattern Recognition 26, 1993). The ellipse is the
direct least-squares fit (Fitzgibbon et al., PAMI 1999, in the reduced form of Halir and Flusser, WSCG 1998).

The disc of the moments must hold one edge only. Below a radius of 3.5 px, its own, it sees the far side of the spot as
well, and the covariance says what that costs; below 2 px there is no edge left to see, and the spot keeps the centre of
its moments. At every radius the edge alone tells less than all pixels do.
"""

import math

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.centres.edge_steps import BLUR_PX
from asterism.server.compiled import compiled
from asterism.server.pose.planar import cholesky_solve
from asterism.server.segmentation.spot_table import (
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

SIZE = 7  # px of the masks' side
HALF = SIZE // 2
FINER = 40  # samples a pixel along each axis, for the masks
SMOOTHING_PX = 1.0  # of the image that edge pixels are looked for in; the moments are those of the image itself
SMOOTHING_REACH = 3  # px
LEAST_GRADIENT = 0.12  # of the spot's height, per px; a blurred and smoothed straight edge has 0.28
LARGEST_RATIO = 0.7  # of Z20 / |Z11|: beyond it there is no step in this disc, but a spot inside it
LEAST_SHARE = 0.75  # of the edge pixels that must show a step; small spots show few, the rest is chance
NEIGHBOUR_MARGIN_PX = 1.0 + 0.5 * SIZE  # edge pixels nearer than this to another spot see its light
FEWEST_POINTS = 6  # a conic has five parameters
FARTHEST_PX = 1.0  # between the ellipse's centre and that of the moments
# Measured on renderings: the share of the points' noise that stays in their distances to the ellipse, how much of the
# other misfit (variance) the centre takes as if it were independent from point to point, and what is left of the
# sub-pixel phase where there is no misfit.
NOISE_LEFT = 0.72
MISFIT_TAKEN = 0.55
PHASE_ERROR_PX = 0.003


def _masks() -> Floats:
    """Integrals of x, y and 2 rho^2 - 1 over the part of every pixel inside the unit disc, (3, 7, 7)."""
    ticks = (np.arange(SIZE * FINER) + 0.5) * 2.0 / (SIZE * FINER) - 1.0
    x, y = np.meshgrid(ticks, ticks)
    rho2 = x * x + y * y
    fine = np.where(rho2 <= 1.0, np.stack([x, y, 2.0 * rho2 - 1.0]), 0.0)
    masks: Floats = fine.reshape(3, SIZE, FINER, SIZE, FINER).sum(axis=(2, 4)) * (2.0 / (SIZE * FINER)) ** 2
    # A uniform disc has no edge; the supersampled border leaves a trace of one.
    masks[2] -= masks[2].sum() / SIZE**2
    return masks


def _px_per_ratio(radius: float) -> float:
    """How far, px, the edge of a blurred disc of that radius (px) moves per change of Z20 / |Z11|.

    For a step edge that is the radius of the moments' own disc, 3.5 px. Blur makes it larger by a fifth; a curved edge
    and the far side of a small spot make it smaller. Left alone, both move the centre with the sub-pixel phase: by
    0.01 px at a radius of 6 px, more below 3.5 px.
    """
    ticks = (np.arange(40) + 0.5) / 20.0 - 1.0
    x, y = np.meshgrid(ticks, ticks[20:])  # the other half is its mirror image
    inside = x * x + y * y < 1.0
    x, y = 0.5 * SIZE * x[inside], 0.5 * SIZE * y[inside]
    ratios = []
    for outwards in (-0.3, 0.3):
        away = np.hypot(x + radius + outwards, y)
        light = np.array([math.erfc((r - radius) / (math.sqrt(2.0) * BLUR_PX)) for r in away])
        z11 = -light @ x / (0.5 * SIZE)
        ratios.append(light @ (2.0 * (x * x + y * y) / (0.5 * SIZE) ** 2 - 1.0) / z11)
    return float(0.6 / (ratios[1] - ratios[0]))


MASKS = _masks()
KERNEL = np.exp(-0.5 * (np.arange(-SMOOTHING_REACH, SMOOTHING_REACH + 1) / SMOOTHING_PX) ** 2)
KERNEL /= KERNEL.sum()
RADII_PX = np.arange(1.5, 12.1, 0.5)
PX_PER_RATIO = np.array([_px_per_ratio(radius) for radius in RADII_PX])


@compiled
def _rise(image, spot, x0, y0, z):
    """Fill ``z`` (rows, cols) with the grey levels above the spot's background; (x0, y0) px is its first pixel."""
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    for i in range(z.shape[0]):
        base = spot[LEVEL] + spot[SLOPE_Y] * (y0 + i - middle_y)
        for j in range(z.shape[1]):
            z[i, j] = image[y0 + i, x0 + j] - (base + spot[SLOPE_X] * (x0 + j - middle_x))


@compiled
def _smooth(z, along, smooth):
    """Fill ``smooth`` (rows, cols) with ``z`` under a Gaussian; ``along`` is scratch. Beyond the window is nothing."""
    rows, cols = z.shape
    for i in range(rows):
        for j in range(cols):
            s = 0.0
            for k in range(max(-SMOOTHING_REACH, -j), min(SMOOTHING_REACH, cols - 1 - j) + 1):
                s += KERNEL[k + SMOOTHING_REACH] * z[i, j + k]
            along[i, j] = s
    for i in range(rows):
        for j in range(cols):
            s = 0.0
            for k in range(max(-SMOOTHING_REACH, -i), min(SMOOTHING_REACH, rows - 1 - i) + 1):
                s += KERNEL[k + SMOOTHING_REACH] * along[i + k, j]
            smooth[i, j] = s


@compiled
def _slopes(smooth, gx, gy, size):
    """Fill the gradient (rows, cols), grey levels per px, and its size; zero on the outermost pixels."""
    rows, cols = smooth.shape
    gx[:], gy[:], size[:] = 0.0, 0.0, 0.0
    for i in range(1, rows - 1):
        for j in range(1, cols - 1):
            gx[i, j] = 0.5 * (smooth[i, j + 1] - smooth[i, j - 1])
            gy[i, j] = 0.5 * (smooth[i + 1, j] - smooth[i - 1, j])
            size[i, j] = math.sqrt(gx[i, j] ** 2 + gy[i, j] ** 2)


@compiled
def _is_ridge(gx, gy, size, i, j):
    """Whether no place one step along or against the gradient is steeper: Canny's suppression of non-maxima."""
    x, y = gx[i, j], gy[i, j]
    di, dj = 1 if y > 0.0 else -1, 1 if x > 0.0 else -1
    if abs(x) > abs(y):
        share = abs(y / x)
        ahead = (1.0 - share) * size[i, j + dj] + share * size[i + di, j + dj]
        behind = (1.0 - share) * size[i, j - dj] + share * size[i - di, j - dj]
    else:
        share = abs(x / y)
        ahead = (1.0 - share) * size[i + di, j] + share * size[i + di, j + dj]
        behind = (1.0 - share) * size[i - di, j] + share * size[i - di, j - dj]
    return size[i, j] >= ahead and size[i, j] >= behind


@compiled
def _onto_edge(z, i, j, px_per_ratio, edge):
    """Fill ``edge`` (6,): where the edge near pixel (i, j) is; False if there is no step.

    Row and column of the pixel, the direction of the gradient cos phi and sin phi, the edge's offset that way, px, and
    |Z11|.
    """
    zx = zy = z20 = 0.0
    for k in range(SIZE):
        for m in range(SIZE):
            value = z[i + k - HALF, j + m - HALF]
            zx += MASKS[0, k, m] * value
            zy += MASKS[1, k, m] * value
            z20 += MASKS[2, k, m] * value
    z11 = math.sqrt(zx * zx + zy * zy)
    if not z11 > 0.0:
        return False
    edge[0], edge[1], edge[2], edge[3] = i, j, zx / z11, zy / z11
    edge[4], edge[5] = px_per_ratio * z20 / z11, z11
    return abs(z20) < LARGEST_RATIO * z11


@compiled
def _near_neighbour(x, y, neighbours):
    """Whether the light of one of the ``neighbours`` (k, 3) x, y, radius reaches the disc around (x, y), px."""
    for k in range(neighbours.shape[0]):
        away2 = (x - neighbours[k, 0]) ** 2 + (y - neighbours[k, 1]) ** 2
        if away2 < (neighbours[k, 2] + NEIGHBOUR_MARGIN_PX) ** 2:
            return True
    return False


@compiled
def _find_edges(z, spot, neighbours, x0, y0, px_per_ratio, edges):
    """Fill ``edges`` (capacity, 6) with the edge points of ``z``, as `_onto_edge`; how many, 0 if most show no step."""
    rows, cols = z.shape
    smooth, gx, gy, size = (
        np.empty((rows, cols)),
        np.empty((rows, cols)),
        np.empty((rows, cols)),
        np.empty((rows, cols)),
    )
    _smooth(z, gx, smooth)
    _slopes(smooth, gx, gy, size)
    n = ridges = 0
    for i in range(HALF, rows - HALF):
        for j in range(HALF, cols - HALF):
            if size[i, j] < LEAST_GRADIENT * spot[HEIGHT] or not _is_ridge(gx, gy, size, i, j):
                continue
            if not _near_neighbour(x0 + j, y0 + i, neighbours):
                ridges += 1
                n += _onto_edge(z, i, j, px_per_ratio, edges[n])
    return n if n >= LEAST_SHARE * ridges else 0


@compiled
def _fit_conic(points, n, size, conic):
    """Fill ``conic`` (6,): A u^2 + B u v + C v^2 + D u + E v + F = 0, the ellipse through points (n, 2) / ``size``.

    The algebraic distance is least under 4 A C - B^2 = 1. Halir and Flusser's a S = mu C a is solved as a symmetric
    problem, with the Cholesky factor of S. False where the points do not determine an ellipse.
    """
    s = np.zeros((6, 6))
    row = np.empty(6)
    for i in range(n):
        u, v = points[i, 0] / size, points[i, 1] / size
        row[0], row[1], row[2], row[3], row[4], row[5] = u * u, u * v, v * v, u, v, 1.0
        for j in range(6):
            for k in range(6):
                s[j, k] += row[j] * row[k]
    # D, E, F follow from A, B, C: (D, E, F) = t (A, B, C).
    t = np.empty((3, 3))
    for k in range(3):
        linear, right = s[3:, 3:].copy(), -s[3:, k]
        if not cholesky_solve(linear, right):
            return False
        t[:, k] = right
    m = np.empty((3, 3))
    for j in range(3):
        for k in range(3):
            m[j, k] = s[j, k] + s[j, 3] * t[0, k] + s[j, 4] * t[1, k] + s[j, 5] * t[2, k]
    for k in range(3):
        m[k, k] += 1e-12 * n  # points exactly on an ellipse leave nothing
    if not cholesky_solve(m, np.zeros(3)):
        return False
    # w = L^-1 C L^-T with C the matrix of 4 A C - B^2, halved; L is the lower triangle of m now.
    w = np.zeros((3, 3))
    w[0, 2], w[1, 1], w[2, 0] = 1.0, -0.5, 1.0
    for _ in range(2):
        for k in range(3):
            column = w[:, k].copy()
            for j in range(3):
                for i in range(j):
                    column[j] -= m[j, i] * column[i]
                column[j] /= m[j, j]
            w[:, k] = column
        w = w.T.copy()
    values, vectors = np.linalg.eigh(w)
    if not values[2] > 0.0:
        return False
    a = vectors[:, 2].copy()
    for j in range(2, -1, -1):
        for i in range(j + 1, 3):
            a[j] -= m[i, j] * a[i]
        a[j] /= m[j, j]
    for j in range(3):
        conic[j] = a[j]
        conic[3 + j] = t[j, 0] * a[0] + t[j, 1] * a[1] + t[j, 2] * a[2]
    return True


@compiled
def _centre_of(conic, size, ellipse):
    """Fill ``ellipse`` (5,): centre x, y px and q: q0 u^2 + 2 q1 u v + q2 v^2 = 1 about it. False if it is none."""
    a, b, c, d, e, f = conic[0], 0.5 * conic[1], conic[2], 0.5 * conic[3], 0.5 * conic[4], conic[5]
    det = a * c - b * b
    if not det > 0.0:
        return False
    x, y = (b * e - c * d) / det, (b * d - a * e) / det
    level = -(f + d * x + e * y)
    if not level * a > 0.0:
        return False
    per_scale = 1.0 / (level * size * size)
    ellipse[0], ellipse[1] = x * size, y * size
    ellipse[2], ellipse[3], ellipse[4] = a * per_scale, b * per_scale, c * per_scale
    return True


@compiled
def _distance(point, ellipse, row):
    """Sampson's distance (q(u, v) - 1) / |grad q| of a point to the ellipse, px; ``row`` (5,) is its gradient."""
    u, v = point[0] - ellipse[0], point[1] - ellipse[1]
    pu, pv = ellipse[2] * u + ellipse[3] * v, ellipse[3] * u + ellipse[4] * v
    per_slope = 0.5 / math.sqrt(pu * pu + pv * pv)
    row[0], row[1] = -2.0 * pu * per_slope, -2.0 * pv * per_slope
    row[2], row[3], row[4] = u * u * per_slope, 2.0 * u * v * per_slope, v * v * per_slope
    return (u * pu + v * pv - 1.0) * per_slope


@compiled
def _centre_gains(points, n, ellipse, gains):
    """Fill ``gains`` (2, n): how far the centre moves per px that a point moves outwards; return the misfit.

    These are the centre's rows of the inverse normal matrix times the points' gradients. The misfit is the sum of the
    squared distances to the ellipse, px^2; it is below 0 where the points do not determine the centre.
    """
    rows, normal = np.empty((n, 5)), np.zeros((5, 5))
    misfit = 0.0
    for i in range(n):
        misfit += _distance(points[i], ellipse, rows[i]) ** 2
        for j in range(5):
            for k in range(5):
                normal[j, k] += rows[i, j] * rows[i, k]
    for axis in range(2):
        matrix, unit = normal.copy(), np.zeros(5)
        unit[axis] = 1.0
        if not cholesky_solve(matrix, unit):
            return -1.0
        for i in range(n):
            gains[axis, i] = -np.dot(unit, rows[i])
    return misfit


@compiled
def _noise_of_centre(window, z, spot, gain, px_per_ratio, edges, gains, out):
    """Fill xx, xy, yy of ``out`` with what the pixels' noise makes of the centre; return that of the mean point, px^2.

    ``window`` is that part of the image, ``z`` (rows, cols) its rise above the background; ``edges`` (n, 6) and
    ``gains`` (2, n) are the points'. Neighbouring points share most of their pixels, so every pixel's pull is summed
    over all points first.
    """
    pulls = np.zeros((2, z.shape[0], z.shape[1]))
    read = spot[NOISE] ** 2
    points_noise = 0.0
    n = edges.shape[0]
    for e in range(n):
        i, j, cos, sin, ratio = int(edges[e, 0]), int(edges[e, 1]), edges[e, 2], edges[e, 3], edges[e, 4] / px_per_ratio
        for k in range(SIZE):
            for m in range(SIZE):
                row, col = i + k - HALF, j + m - HALF
                along = cos * MASKS[0, k, m] + sin * MASKS[1, k, m]
                pull = px_per_ratio * (MASKS[2, k, m] - ratio * along) / edges[e, 5]
                pulls[0, row, col] += gains[0, e] * pull
                pulls[1, row, col] += gains[1, e] * pull
                points_noise += pull * pull * (read + gain * max(z[row, col], 0.0))
    xx = xy = yy = 0.0
    for row in range(z.shape[0]):
        for col in range(z.shape[1]):
            if window[row, col] < 255:  # the sensor's ceiling has no noise
                variance = read + gain * max(z[row, col], 0.0)
                px, py = pulls[0, row, col], pulls[1, row, col]
                xx += variance * px * px
                xy += variance * px * py
                yy += variance * py * py
    out[2], out[3], out[4] = xx, xy, yy
    return points_noise / n


@compiled
def fit_zernike(image, spot, neighbours, gain, out):
    """The centre of one spot's edge ellipse; arguments and ``out`` as in `edge_model.fit_edge_model`.

    The entries of ``out`` after the covariance are zero: this estimator does not tell of other light.
    """
    height, width = image.shape
    x0, x1 = max(int(spot[WX0]), 0), min(int(spot[WX1]), width)
    y0, y1 = max(int(spot[WY0]), 0), min(int(spot[WY1]), height)
    z = np.empty((y1 - y0, x1 - x0))
    edges, points, gains = np.empty((z.size, 6)), np.empty((z.size, 2)), np.empty((2, z.size))
    conic, ellipse = np.empty(6), np.empty(5)
    _rise(image, spot, x0, y0, z)
    px_per_ratio = np.interp(math.sqrt(spot[SEMI_A] * spot[SEMI_B]), RADII_PX, PX_PER_RATIO)
    n = _find_edges(z, spot, neighbours, x0, y0, px_per_ratio, edges)
    for e in range(n):
        points[e, 0] = x0 + edges[e, 1] + edges[e, 4] * edges[e, 2] - spot[X]
        points[e, 1] = y0 + edges[e, 0] + edges[e, 4] * edges[e, 3] - spot[Y]
    # Without the edge of an ellipse: the coarse centre, and what that may be worth.
    a = spot[SEMI_A]
    out[:] = 0.0
    out[0], out[1], out[2], out[4] = spot[X], spot[Y], a * a, a * a
    if n < FEWEST_POINTS or not _fit_conic(points, n, a, conic) or not _centre_of(conic, a, ellipse):
        return
    if math.sqrt(ellipse[0] ** 2 + ellipse[1] ** 2) > FARTHEST_PX:
        return
    misfit = _centre_gains(points, n, ellipse, gains)
    if misfit < 0.0:
        return
    out[0], out[1] = spot[X] + ellipse[0], spot[Y] + ellipse[1]
    noise = _noise_of_centre(image[y0:y1, x0:x1], z, spot, gain, px_per_ratio, edges[:n], gains, out)
    wrong = MISFIT_TAKEN * max(misfit / max(n - 5.0, 1.0) - NOISE_LEFT * noise, 0.0)
    out[2] += wrong * np.dot(gains[0, :n], gains[0, :n]) + PHASE_ERROR_PX**2
    out[3] += wrong * np.dot(gains[0, :n], gains[1, :n])
    out[4] += wrong * np.dot(gains[1, :n], gains[1, :n]) + PHASE_ERROR_PX**2
