"""How far off a pose may be that is seen nearly in front: the covariance of all tilts that its spots allow (`valley`).

It is the second moment about the pose, of all tilts weighted by their likelihood; the rest follows them, as a quadratic
function of the tilt, and has its own covariance at every tilt. The third and fourth moments of such a valley are not a
Gaussian's: a tilt that is not yet out of the question may lie ten sigma away. So the covariance is widened until none
lies beyond it, which costs the typical pose little, since few have any.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.covariance import invert
from asterism.server.pose.valley import (
    COARSE,
    DOUBT,
    FINE_X,
    FINE_Y,
    POWER_X,
    POWER_Y,
    along_y,
    fill_quartic,
    move_at,
    value_at,
)

RESOLVED, CLOSER = 4, 5  # steps of a grid that its tilts in doubt must at least fill, and how often it is drawn closer
COVERED = 25.0  # squared error, weighted by the covariance, that a tilt in doubt may at most have


@compiled
def squared(move, covariance, valley):
    """Square of a move (6,), weighted by the ``covariance`` (6, 6)."""
    half, inverse = valley.half, valley.inverse
    half[:, :] = covariance
    invert(half, inverse)
    total = 0.0
    for i in range(6):
        for j in range(6):
            total += move[i] * inverse[i, j] * move[j]
    return total


@compiled
def spread(x, y, other_x, other_y, alone, step, valley, covariance):
    """Fill ``covariance`` (6, 6) of the minimum at the tilt (x, y), about the plane's origin.

    It is the second moment of all tilts about the minimum, or where that is not ``alone`` of those on its side of the
    other one, widened until it covers those that are in doubt. ``step`` is that of `look_around`.
    """
    coarse, lowest = valley.coarse, value_at(valley.cost, x, y)
    # Tilts on the other side have no share.
    dx, dy = other_x - x, other_y - y
    half = 1e300 if alone else 0.5 * (other_x * other_x + other_y * other_y - x * x - y * y)
    x0 = x1 = x
    y0 = y1 = y
    for i in range(2 * COARSE + 1):
        for j in range(2 * COARSE + 1):
            at_x, at_y = (i - COARSE) * step, (j - COARSE) * step
            if coarse[i, j] < lowest + DOUBT and at_x * dx + at_y * dy < half:
                x0, x1, y0, y1 = min(x0, at_x), max(x1, at_x), min(y0, at_y), max(y1, at_y)
    # Moves are those from this minimum.
    moves, sums, powers = valley.from_here, valley.sums, valley.beyond
    moves[:, :] = valley.moves
    move_at(x, y, valley.moves, moves[0])
    for k in range(6):
        moves[0, k] = valley.moves[0, k] - moves[0, k]
    margin_x = margin_y = step
    for closer in range(CLOSER):
        step_x, step_y = (0.5 * (x1 - x0) + margin_x) / FINE_X, (0.5 * (y1 - y0) + margin_y) / FINE_Y
        x0, y0 = x0 - margin_x, y0 - margin_y
        left, right, low, high = _weigh(lowest, Grid(x0, y0, step_x, step_y), dx, dy, half, valley)
        if (right - left >= RESOLVED and high - low >= RESOLVED) or closer == CLOSER - 1:
            break
        margin_x, margin_y = step_x, step_y
        x0, x1 = min(x, x0 + left * step_x), max(x, x0 + right * step_x)
        y0, y1 = min(y, y0 + low * step_y), max(y, y0 + high * step_y)
    total = powers[0, 0]
    for p in range(6):
        for q in range(6):
            sums[p, q] = powers[POWER_X[p] + POWER_X[q], POWER_Y[p] + POWER_Y[q]]
    _from_sums(total, valley, covariance)
    for _ in range(3):
        if not _cover(x0, y0, step_x, step_y, valley, covariance):
            break


class Grid(NamedTuple):
    """Tilts on a grid: the first, and how far apart they are in x and y."""

    x0: float
    y0: float
    step_x: float
    step_y: float


@compiled
def _weigh(lowest, grid, dx, dy, half, valley):
    """Fill ``fine`` with what tilts on a grid cost more than the ``lowest``, and ``beyond`` with the sums of the
    products of their powers, each weighted by how likely it is.

    Returns between which places of the grid tilts are in doubt: the first and the last in x, and in y.
    """
    fine, powers = valley.fine, valley.beyond
    powers[:, :] = 0.0
    left, right, low, high = 2 * FINE_X, 0, 2 * FINE_Y, 0
    for i in range(2 * FINE_X + 1):
        at_x = grid.x0 + i * grid.step_x
        a, b, c, d, e = along_y(valley.cost, at_x)
        m0 = m1 = m2 = m3 = m4 = 0.0
        for j in range(2 * FINE_Y + 1):
            at_y = grid.y0 + j * grid.step_y
            above = a - lowest + at_y * (b + at_y * (c + at_y * (d + at_y * e)))
            if at_x * dx + at_y * dy >= half:
                above = 2.0 * DOUBT
            fine[i, j] = above
            if above < DOUBT:
                left, right, low, high = min(left, i), max(right, i), min(low, j), max(high, j)
            if above < 1.2 * DOUBT:
                weight = math.exp(-0.5 * above)
                m0 += weight
                weight *= at_y
                m1 += weight
                weight *= at_y
                m2 += weight
                weight *= at_y
                m3 += weight
                m4 += weight * at_y
        if m0 > 0.0:
            power = 1.0
            for k in range(5):
                powers[k, 0] += power * m0
                powers[k, 1] += power * m1
                powers[k, 2] += power * m2
                powers[k, 3] += power * m3
                powers[k, 4] += power * m4
                power *= at_x
    return left, right, low, high


@compiled
def _from_sums(total, valley, covariance):
    """Fill ``covariance`` (6, 6) with the second moment of the moves, and what the rest varies by at every tilt."""
    moves, sums, half, rest = valley.from_here, valley.sums, valley.half, valley.rest
    axis, arm = valley.axes[2], valley.arm
    for p in range(6):
        for k in range(6):
            half[p, k] = 0.0
            for q in range(6):
                half[p, k] += sums[p, q] * moves[q, k] / total
    for i in range(6):
        for k in range(6):
            covariance[i, k] = 0.0
            for p in range(6):
                covariance[i, k] += moves[p, i] * half[p, k]
    for i in range(3):
        for j in range(3):
            covariance[i, j] += rest[i, j] + arm[i] * rest[3, j] + rest[i, 3] * arm[j] + arm[i] * rest[3, 3] * arm[j]
            covariance[3 + i, 3 + j] += axis[i] * rest[3, 3] * axis[j]
            covariance[i, 3 + j] += (rest[i, 3] + arm[i] * rest[3, 3]) * axis[j]
            covariance[3 + i, j] += axis[i] * (rest[3, j] + rest[3, 3] * arm[j])


@compiled
def _cover(x0, y0, step_x, step_y, valley, covariance):
    """Widen the ``covariance`` to the tilt in doubt that lies furthest beyond it, if any does."""
    moves, half, gram, fine = valley.from_here, valley.half, valley.gram, valley.fine
    inverse, quartic = valley.inverse, valley.beyond
    half[:, :] = covariance
    invert(half, inverse)
    for p in range(6):
        for k in range(6):
            half[p, k] = 0.0
            for q in range(6):
                half[p, k] += moves[p, q] * inverse[q, k]
        for r in range(p + 1):
            gram[p, r] = 0.0
            for k in range(6):
                gram[p, r] += half[p, k] * moves[r, k]
    fill_quartic(gram, quartic)
    most, most_x, most_y = COVERED, 0.0, 0.0
    for i in range(2 * FINE_X + 1):
        at_x = x0 + i * step_x
        a, b, c, d, e = along_y(quartic, at_x)
        for j in range(2 * FINE_Y + 1):
            at_y = y0 + j * step_y
            beyond = a + at_y * (b + at_y * (c + at_y * (d + at_y * e)))
            if fine[i, j] < DOUBT and beyond > most:
                most, most_x, most_y = beyond, at_x, at_y
    if most <= 1.05 * COVERED:
        return False
    move = np.empty(6)
    move_at(most_x, most_y, moves, move)
    growth = 1.0 / COVERED - 1.0 / most
    for i in range(6):
        for j in range(6):
            covariance[i, j] += growth * move[i] * move[j]
    return True
