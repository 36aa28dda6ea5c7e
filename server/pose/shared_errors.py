"""What light says of a pose when some of its errors are shared: by all spots of a robot, or told of the pose itself.

Marginalised, as `on_surface` says: the information of the spots without what those errors may have done to them.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.protocol.led_offset import MOST_DOUBTS, MOST_KNOTS
from asterism.server.compiled import compiled
from asterism.server.pose.planar import HUBER2, cholesky_solve, normal_equations, pose_cost
from asterism.server.pose.rotations import mapped
from asterism.server.pose.spot_shift import AXIS, DOUBT, DOUBTS, along_axis

MOST = 2 + MOST_DOUBTS  # errors that all spots of a robot share


class Shared(NamedTuple):
    """What errors a robot's spots share: ``common`` (3,), the covariance xx, xy, yy of all rays together; ``terms``
    (6, 6), that of the pose, about the visible LEDs' mean; ``some``, whether there are any. Scratch: ``moves``
    (6, 2, MOST), what each does to the rays; ``crossed`` (6, MOST), ``own`` (MOST, MOST), ``seen`` (MOST,).
    """

    common: Any
    terms: Any
    moves: Any
    crossed: Any
    own: Any
    seen: Any


@compiled
def shared_room():
    """Room for one robot's."""
    return Shared(
        np.zeros(3), np.zeros((6, 6)), np.zeros((6, 2, MOST)), np.zeros((6, MOST)), np.zeros((MOST, MOST)),
        np.zeros(MOST),
    )  # fmt: skip


@compiled
def _fill_moves(rotation, t, lit, optics, shared):
    """Fill what errors of one sigma do to the rays; returns how many there are."""
    common, moves = shared.common, shared.moves
    count = 0
    if common[0] + common[2] > 0.0:
        # A Cholesky factor of the covariance.
        xx = math.sqrt(common[0])
        yx = common[1] / xx if xx > 0.0 else 0.0
        for k in range(lit.points.shape[0]):
            moves[k, 0, 0], moves[k, 1, 0] = xx, yx
            moves[k, 0, 1], moves[k, 1, 1] = 0.0, math.sqrt(max(common[2] - yx * yx, 0.0))
        count = 2
    doubts = int(optics[DOUBTS])
    if doubts == 0:
        return count
    axis = np.zeros(3)
    for i in range(3):
        for j in range(3):
            axis[i] += rotation[i, j] * optics[AXIS + j]
    for k in range(lit.points.shape[0]):
        x, y, z = mapped(rotation, t, lit.points[k])
        dot = axis[0] * x + axis[1] * y + axis[2] * z
        angle = math.asin(math.sqrt(max(1.0 - dot * dot / (x * x + y * y + z * z), 0.0)))
        for row in range(doubts):
            shift = along_axis(optics, DOUBT + row * MOST_KNOTS, angle)
            moves[k, 0, count + row] = shift * (axis[0] - x / z * axis[2]) / z
            moves[k, 1, count + row] = shift * (axis[1] - y / z * axis[2]) / z
    return count + doubts


@compiled
def _derivatives(rotation, t, point, out):
    """Fill ``out`` (2, 6) with the derivatives of a point's ray, as in `planar.normal_equations`; returns the ray."""
    x, y, z = mapped(rotation, t, point)
    q0, q1, q2 = x - t[0], y - t[1], z - t[2]
    iz = 1.0 / z
    u, v = x * iz, y * iz
    u2, v2 = -u * iz, -v * iz
    out[0, 0], out[0, 1], out[0, 2] = iz, 0.0, u2
    out[0, 3], out[0, 4], out[0, 5] = u2 * q1, iz * q2 - u2 * q0, -iz * q1
    out[1, 0], out[1, 1], out[1, 2] = 0.0, iz, v2
    out[1, 3], out[1, 4], out[1, 5] = -iz * q2 + v2 * q1, -v2 * q0, iz * q0
    return u, v


@compiled
def _take_spots(rotation, t, lit, optics, shared, a, b):
    """Take off ``a`` (6, 6; its lower triangle) and ``b`` (6,) what errors of the spots may have done; and return what
    they explain of the cost.
    """
    count = _fill_moves(rotation, t, lit, optics, shared)
    if count == 0:
        return 0.0
    crossed, own, seen = shared.crossed[:, :count], np.zeros((count, count)), shared.seen[:count]
    crossed[:, :] = 0.0
    seen[:] = 0.0
    by_pose = np.empty((2, 6))
    for k in range(lit.points.shape[0]):
        u, v = _derivatives(rotation, t, lit.points[k], by_pose)
        xx, xy, yy = lit.information[k, 0], lit.information[k, 1], lit.information[k, 2]
        e, f = lit.seen[k, 0] - u, lit.seen[k, 1] - v
        # The robust loss trusts an outlier less; else more would be explained than it costs.
        m2 = xx * e * e + 2.0 * xy * e * f + yy * f * f
        if m2 > HUBER2:
            trust = math.sqrt(HUBER2 / m2)
            xx, xy, yy = trust * xx, trust * xy, trust * yy
        for p in range(count):
            x, y = shared.moves[k, 0, p], shared.moves[k, 1, p]
            wx, wy = xx * x + xy * y, xy * x + yy * y
            seen[p] += wx * e + wy * f
            for i in range(6):
                crossed[i, p] += by_pose[0, i] * wx + by_pose[1, i] * wy
            for q in range(count):
                own[p, q] += wx * shared.moves[k, 0, q] + wy * shared.moves[k, 1, q]
    explained = 0.0
    for p in range(count):
        own[p, p] += 1.0  # errors are in sigmas
    column, factor = np.empty(count), np.empty((count, count))
    for i in range(7):
        factor[:, :] = own
        for p in range(count):
            column[p] = crossed[i, p] if i < 6 else seen[p]
        if not cholesky_solve(factor, column):
            continue
        for p in range(count):
            if i < 6:
                b[i] -= column[p] * seen[p]
                for j in range(i + 1):
                    a[i, j] -= column[p] * crossed[j, p]
            else:
                explained += column[p] * seen[p]
    return explained


@compiled
def _take_terms(terms, a, b):
    """Take off ``a`` (6, 6; whole) and ``b`` (6,) what is told of the pose, a covariance ``terms`` (6, 6): a becomes
    (1 + a T)^-1 a. Returns what it explains of the cost.
    """
    system, right = np.empty((6, 6)), np.empty((6, 7))
    for i in range(6):
        right[i, 6] = b[i]
        for j in range(6):
            right[i, j] = a[i, j]
            system[i, j] = 1.0 if i == j else 0.0
            for k in range(6):
                system[i, j] += a[i, k] * terms[k, j]
    solved = np.linalg.solve(system, right)
    explained = 0.0
    for i in range(6):
        for j in range(6):
            explained += b[i] * terms[i, j] * solved[j, 6]
    for i in range(6):
        b[i] = solved[i, 6]
        for j in range(6):
            a[i, j] = 0.5 * (solved[i, j] + solved[j, i])
    return explained


@compiled
def is_shared(optics, shared):
    """Whether there are such errors at all."""
    told = shared.common[0] + shared.common[2] > 0.0 or optics[DOUBTS] > 0.0
    for i in range(6):
        told = told or shared.terms[i, i] > 0.0
    return told


@compiled
def fill_light(rotation, t, lit, optics, shared, a, b):
    """Fill ``a`` (6, 6) and ``b`` (6,) of a step by light, shared errors marginalised; returns the cost."""
    cost = pose_cost(rotation, t, lit.points, lit.seen, lit.information)
    normal_equations(rotation, t, lit.points, lit.seen, lit.information, a, b)
    some = is_shared(optics, shared)
    if some:
        cost -= _take_spots(rotation, t, lit, optics, shared, a, b)
    for i in range(6):
        for j in range(i):
            a[j, i] = a[i, j]
    if some:
        cost -= _take_terms(shared.terms, a, b)
    return cost
