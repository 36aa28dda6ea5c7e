"""Poses seen nearly in front: what the spots say of all tilts at once, where the covariance at a minimum does not tell.

A plane's image shrinks along the tilt by the square of it. With n the part of the plane's normal across the line of
sight, the foreshortening says what n^2 is (as a complex number), so it knows neither the sign of n nor, near n = 0, its
direction; only the perspective, linear in n and weak, tells signs apart. The cost then has one minimum or two, whose
curvature describes neither how wide the valley is nor how the minima are joined.

Residuals are quadratic in n to the third order, when everything else (translation, and the turn about the line of
sight) follows it. So six poses give the cost of every tilt as a polynomial of fourth degree, and the moves of the rest
as quadratic ones. From these come, on a grid of tilts: a minimum that was missed, and how far off the pose may be
(`spread`).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.planar import cholesky_solve, translation
from asterism.server.pose.rotations import exp_into, mapped, product_into

DOUBT = 2.0 * math.log(1e4)  # squared sigmas up to which a tilt is not out of the question
FRONTAL = 8.0 * DOUBT  # tilts further from the line of sight than that, squared sigmas, are what their minimum says
LEAST_STEP = 0.05  # of n, between the poses that the polynomials go through
WIDEST = 0.6  # of n
POWER_X, POWER_Y = np.array([0, 1, 0, 2, 1, 0]), np.array([0, 0, 1, 0, 1, 2])  # powers of 1, x, y, x^2, xy, y^2
COARSE, FINE_X, FINE_Y = 8, 10, 5  # steps to either side


class Valley(NamedTuple):
    """Scratch, and what is known of one robot's tilts.

    ``axes`` (3, 3): two directions across the line of sight, the first along the tilt, and the line of sight itself;
    ``samples`` (6, 12) whitened residuals and ``moves`` (6, 6) of the poses gone through, then coefficients of 1, x, y,
    x^2, xy, y^2; ``cost`` (5, 5) coefficients of x^i y^j; ``rest`` (4, 4) covariance of translation and turn at a given
    tilt; ``columns`` (12, 4) and ``fit`` (4, 4) of these, scratch; ``rotation``, ``step`` (3, 3), ``t`` (3,) likewise.
    """

    axes: Any
    samples: Any
    moves: Any
    cost: Any
    rest: Any
    columns: Any
    fit: Any
    rotation: Any
    step: Any
    t: Any
    gram: Any
    coarse: Any
    fine: Any
    from_here: Any
    sums: Any
    half: Any
    inverse: Any
    beyond: Any
    arm: Any


@compiled
def valley_room():
    """Room for one robot's."""
    axes, samples, moves, cost = np.empty((3, 3)), np.zeros((6, 12)), np.empty((6, 6)), np.empty((5, 5))
    rest, columns, fit = np.empty((4, 4)), np.zeros((12, 4)), np.empty((4, 4))
    rotation, step, t, gram = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.zeros((6, 6))
    coarse, fine = np.empty((2 * COARSE + 1, 2 * COARSE + 1)), np.empty((2 * FINE_X + 1, 2 * FINE_Y + 1))
    from_here, sums, half, inverse = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    beyond = np.empty((5, 5))
    return Valley(
        axes, samples, moves, cost, rest, columns, fit, rotation, step, t,
        gram, coarse, fine, from_here, sums, half, inverse, beyond, np.empty(3),
    )  # fmt: skip


@compiled
def _fill_axes(rotation, t, axes):
    """Fill ``axes`` (3, 3) for a pose's tilt; returns how large it is, as the sine of its angle."""
    length = math.sqrt(t[0] ** 2 + t[1] ** 2 + t[2] ** 2)
    along = 0.0
    for i in range(3):
        axes[2, i] = t[i] / length
        along += rotation[i, 2] * axes[2, i]
    sine2 = 0.0
    for i in range(3):
        axes[0, i] = rotation[i, 2] - along * axes[2, i]
        sine2 += axes[0, i] ** 2
    sine = math.sqrt(sine2)
    if sine < 1e-6:
        # Any direction across will do.
        along = axes[2, 0]
        for i in range(3):
            axes[0, i] = (1.0 if i == 0 else 0.0) - along * axes[2, i]
        size = math.sqrt(axes[0, 0] ** 2 + axes[0, 1] ** 2 + axes[0, 2] ** 2)
    else:
        size = sine
    for i in range(3):
        axes[0, i] /= size
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        axes[1, i] = axes[2, j] * axes[0, k] - axes[2, k] * axes[0, j]
    return sine


@compiled
def tilt_of(rotation, valley):
    """x and y of the tilt that a rotation has."""
    x = y = 0.0
    for i in range(3):
        x += rotation[i, 2] * valley.axes[0, i]
        y += rotation[i, 2] * valley.axes[1, i]
    return x, y


@compiled
def is_frontal(rotation, t, covariance, valley):
    """Whether a pose, its ``covariance`` (6, 6), may be of another tilt than its minimum says. Fills the axes."""
    axes = valley.axes
    sine = _fill_axes(rotation, t, axes)
    # Along its tilt or across it, whichever is known less.
    along = across = 0.0
    for i in range(3):
        for j in range(3):
            along += axes[1, i] * covariance[3 + i, 3 + j] * axes[1, j]
            across += axes[0, i] * covariance[3 + i, 3 + j] * axes[0, j]
    variance = max(along, across)
    return sine < WIDEST and sine * sine < FRONTAL * variance


@compiled
def _whiten(lit, k, e, f):
    """Residuals (e, f) of an LED in sigmas."""
    xx, xy, yy = lit.information[k, 0], lit.information[k, 1], lit.information[k, 2]
    root = math.sqrt(xx)
    return root * e + xy / root * f, math.sqrt(max(yy - xy * xy / xx, 0.0)) * f


@compiled
def _fill_columns(rotation, t, lit, valley):
    """Fill ``columns``, whitened, of translation and turn about the line of sight, and their covariance ``rest``."""
    columns, fit, rest, axis = valley.columns, valley.fit, valley.rest, valley.axes[2]
    count = lit.points.shape[0]
    for k in range(count):
        x, y, z = mapped(rotation, t, lit.points[k])
        q0, q1, q2 = x - t[0], y - t[1], z - t[2]
        u, v, iz = x / z, y / z, 1.0 / z
        w0, w1, w2 = axis[1] * q2 - axis[2] * q1, axis[2] * q0 - axis[0] * q2, axis[0] * q1 - axis[1] * q0
        columns[2 * k, 0], columns[2 * k + 1, 0] = _whiten(lit, k, iz, 0.0)
        columns[2 * k, 1], columns[2 * k + 1, 1] = _whiten(lit, k, 0.0, iz)
        columns[2 * k, 2], columns[2 * k + 1, 2] = _whiten(lit, k, -u * iz, -v * iz)
        columns[2 * k, 3], columns[2 * k + 1, 3] = _whiten(lit, k, (w0 - u * w2) * iz, (w1 - v * w2) * iz)
    for i in range(4):
        for j in range(i + 1):
            total = 0.0
            for row in range(2 * count):
                total += columns[row, i] * columns[row, j]
            valley.gram[i, j] = total
    unit = np.empty(4)
    for column in range(4):
        for i in range(4):
            unit[i] = 1.0 if i == column else 0.0
            for j in range(i + 1):
                fit[i, j] = valley.gram[i, j]
        if not cholesky_solve(fit, unit):
            return False
        rest[:, column] = unit
    return True


@compiled
def _sample(x, y, pose, pose_t, lit, centre, valley, row):
    """Fill ``row`` of samples and moves: the best pose with the tilt (x, y), as seen from ``pose``."""
    axes, columns, rest = valley.axes, valley.columns, valley.rest
    rotation, t = valley.rotation, valley.t
    z = -math.sqrt(max(1.0 - x * x - y * y, 0.0))
    n0 = x * axes[0, 0] + y * axes[1, 0] + z * axes[2, 0]
    n1 = x * axes[0, 1] + y * axes[1, 1] + z * axes[2, 1]
    n2 = x * axes[0, 2] + y * axes[1, 2] + z * axes[2, 2]
    m0, m1, m2 = pose[0, 2], pose[1, 2], pose[2, 2]
    w0, w1, w2 = m1 * n2 - m2 * n1, m2 * n0 - m0 * n2, m0 * n1 - m1 * n0
    sine, cosine = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2), m0 * n0 + m1 * n1 + m2 * n2
    factor = math.atan2(sine, cosine) / sine if sine > 1e-9 else 1.0
    w0, w1, w2 = factor * w0, factor * w1, factor * w2
    exp_into(w0, w1, w2, valley.step)
    product_into(valley.step, pose, rotation)
    translation(rotation, lit.points, lit.seen, t)
    residuals, moves = valley.samples[row], valley.moves[row]
    b0 = b1 = b2 = b3 = 0.0
    for k in range(lit.points.shape[0]):
        px, py, pz = mapped(rotation, t, lit.points[k])
        residuals[2 * k], residuals[2 * k + 1] = _whiten(lit, k, lit.seen[k, 0] - px / pz, lit.seen[k, 1] - py / pz)
        for i in range(2 * k, 2 * k + 2):
            b0 += columns[i, 0] * residuals[i]
            b1 += columns[i, 1] * residuals[i]
            b2 += columns[i, 2] * residuals[i]
            b3 += columns[i, 3] * residuals[i]
    s0 = rest[0, 0] * b0 + rest[0, 1] * b1 + rest[0, 2] * b2 + rest[0, 3] * b3
    s1 = rest[1, 0] * b0 + rest[1, 1] * b1 + rest[1, 2] * b2 + rest[1, 3] * b3
    s2 = rest[2, 0] * b0 + rest[2, 1] * b1 + rest[2, 2] * b2 + rest[2, 3] * b3
    s3 = rest[3, 0] * b0 + rest[3, 1] * b1 + rest[3, 2] * b2 + rest[3, 3] * b3
    for i in range(2 * lit.points.shape[0]):
        residuals[i] -= columns[i, 0] * s0 + columns[i, 1] * s1 + columns[i, 2] * s2 + columns[i, 3] * s3
    # What the plane's origin moves by: the turn about the line of sight is small, the tilt is not.
    arm = valley.arm
    moves[0], moves[1], moves[2] = t[0] + s0 - pose_t[0], t[1] + s1 - pose_t[1], t[2] + s2 - pose_t[2]
    for i in range(3):
        moves[i] += s3 * arm[i]
        for j in range(3):
            moves[i] += (pose[i, j] - rotation[i, j]) * centre[j]
    moves[3], moves[4], moves[5] = w0 + s3 * axes[2, 0], w1 + s3 * axes[2, 1], w2 + s3 * axes[2, 2]


@compiled
def _interpolate(table, h):
    """Six samples, at (0, 0), (h, 0), (-h, 0), (0, h), (0, -h), (h, h) / sqrt 2, become coefficients, in place."""
    for k in range(table.shape[1]):
        f, right, left, up, down, slant = (
            table[0, k],
            table[1, k],
            table[2, k],
            table[3, k],
            table[4, k],
            table[5, k],
        )
        x, y = 0.5 * (right - left) / h, 0.5 * (up - down) / h
        xx, yy = (0.5 * (right + left) - f) / (h * h), (0.5 * (up + down) - f) / (h * h)
        g = h * math.sqrt(0.5)
        table[1, k], table[2, k], table[3, k], table[5, k] = x, y, xx, yy
        table[4, k] = (slant - f - g * (x + y)) / (g * g) - xx - yy


@compiled
def survey(rotation, t, lit, centre, valley):
    """Fill ``valley`` around a pose whose axes it holds; False where the spots do not determine the rest.

    ``t`` and the points are about the visible LEDs' ``centre`` (3,) in the plane; moves are of the plane's origin.
    """
    axis, arm = valley.axes[2], valley.arm
    x, y, z = mapped(rotation, np.zeros(3), centre)
    arm[0], arm[1], arm[2] = axis[2] * y - axis[1] * z, axis[0] * z - axis[2] * x, axis[1] * x - axis[0] * y
    if not _fill_columns(rotation, t, lit, valley):
        return False
    x, _ = tilt_of(rotation, valley)
    h = max(x, LEAST_STEP)
    g = h * math.sqrt(0.5)
    _sample(0.0, 0.0, rotation, t, lit, centre, valley, 0)
    _sample(h, 0.0, rotation, t, lit, centre, valley, 1)
    _sample(-h, 0.0, rotation, t, lit, centre, valley, 2)
    _sample(0.0, h, rotation, t, lit, centre, valley, 3)
    _sample(0.0, -h, rotation, t, lit, centre, valley, 4)
    _sample(g, g, rotation, t, lit, centre, valley, 5)
    _interpolate(valley.samples, h)
    _interpolate(valley.moves, h)
    for i in range(6):
        for j in range(i + 1):
            dot = 0.0
            for k in range(2 * lit.points.shape[0]):
                dot += valley.samples[i, k] * valley.samples[j, k]
            valley.gram[i, j] = dot
    fill_quartic(valley.gram, valley.cost)
    return True


@compiled
def fill_quartic(gram, quartic):
    """Fill ``quartic`` (5, 5), coefficients of x^i y^j, with that of the quadratic form ``gram`` (6, 6; its lower
    triangle) in 1, x, y, x^2, xy, y^2.
    """
    quartic[:, :] = 0.0
    for i in range(6):
        for j in range(i + 1):
            quartic[POWER_X[i] + POWER_X[j], POWER_Y[i] + POWER_Y[j]] += gram[i, j] if i == j else 2.0 * gram[i, j]


@compiled
def along_y(quartic, x):
    """Coefficients of 1, y, ..., y^4 of a polynomial (5, 5) at an x."""
    c = quartic
    return (
        c[0, 0] + x * (c[1, 0] + x * (c[2, 0] + x * (c[3, 0] + x * c[4, 0]))),
        c[0, 1] + x * (c[1, 1] + x * (c[2, 1] + x * c[3, 1])),
        c[0, 2] + x * (c[1, 2] + x * c[2, 2]),
        c[0, 3] + x * c[1, 3],
        c[0, 4],
    )


@compiled
def value_at(quartic, x, y):
    """A polynomial of fourth degree, coefficients (5, 5) of x^i y^j."""
    a, b, c, d, e = along_y(quartic, x)
    return a + y * (b + y * (c + y * (d + y * e)))


@compiled
def move_at(x, y, moves, move):
    """Fill ``move`` (6,): translation, m, and turn, rad, to the best pose with the tilt (x, y)."""
    m = moves
    for k in range(6):
        move[k] = m[0, k] + x * (m[1, k] + x * m[3, k]) + y * (m[2, k] + x * m[4, k] + y * m[5, k])


@compiled
def _reach(x, y, valley):
    """How far from the line of sight tilts may lie that are not out of the question."""
    # The foreshortening alone: |n^2 - w| in sigmas, along whichever of its two directions says less.
    aa = ab = bb = 0.0
    for k in range(12):
        a, b = 0.5 * (valley.samples[3, k] - valley.samples[5, k]), 0.5 * valley.samples[4, k]
        aa, ab, bb = aa + a * a, ab + a * b, bb + b * b
    least = 0.5 * (aa + bb - math.sqrt((aa - bb) ** 2 + 4.0 * ab * ab))
    return min(math.sqrt(x * x + y * y + 1.2 * math.sqrt(DOUBT / max(least, 1e-6))), WIDEST)


@compiled
def _leads_out(edge, inside, limit):
    """Whether the valley goes on beyond a cost at the edge of the grid, or another one may begin there."""
    return edge <= limit or edge < inside


@compiled
def look_around(x, y, valley):
    """Fill the ``coarse`` costs about the tilt (x, y) of a minimum, to be read by the others; the step of the grid."""
    limit = value_at(valley.cost, x, y) + DOUBT
    reach = _reach(x, y, valley)
    last = 2 * COARSE
    while True:
        step = reach / COARSE
        for i in range(last + 1):
            a, b, c, d, e = along_y(valley.cost, (i - COARSE) * step)
            for j in range(last + 1):
                at = (j - COARSE) * step
                valley.coarse[i, j] = a + at * (b + at * (c + at * (d + at * e)))
        coarse, is_open = valley.coarse, False
        for i in range(last + 1):
            is_open = is_open or _leads_out(coarse[i, 0], coarse[i, 1], limit)
            is_open = is_open or _leads_out(coarse[i, last], coarse[i, last - 1], limit)
            is_open = is_open or _leads_out(coarse[0, i], coarse[1, i], limit)
            is_open = is_open or _leads_out(coarse[last, i], coarse[last - 1, i], limit)
        # Near by, the perspective may move the middle of the valley, or the other minimum, away from the line of sight.
        if not is_open or reach >= WIDEST:
            return step
        reach = min(1.5 * reach, WIDEST)


@compiled
def missed(x, y, other_x, other_y, step, valley):
    """The tilt of the least minimum of the ``coarse`` costs that is neither of the two, and whether there is one."""
    coarse = valley.coarse
    # Between the steps of the grid a narrow one is deeper.
    limit = value_at(valley.cost, x, y) + FRONTAL
    best_x = best_y = 0.0
    found = False
    for i in range(1, 2 * COARSE):
        for j in range(1, 2 * COARSE):
            here = coarse[i, j]
            if here >= limit:
                continue
            least = True
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    least = least and here <= coarse[i + di, j + dj]
            if not least:
                continue
            at_x, at_y = (i - COARSE) * step, (j - COARSE) * step
            near = min((at_x - x) ** 2 + (at_y - y) ** 2, (at_x - other_x) ** 2 + (at_y - other_y) ** 2)
            if near > (1.6 * step) ** 2:
                best_x, best_y, limit, found = at_x, at_y, here, True
    return best_x, best_y, found


@compiled
def fill_pose(x, y, pose, lit, valley, rotation, t):
    """Fill ``rotation`` (3, 3) and ``t`` (3,), about the visible LEDs' mean, with a pose of about the tilt (x, y)."""
    move = np.empty(6)
    move_at(x, y, valley.moves, move)
    exp_into(move[3], move[4], move[5], valley.step)
    product_into(valley.step, pose, rotation)
    translation(rotation, lit.points, lit.seen, t)
