"""One robot, rays of several cameras: its pose in the world by generalised least squares, compiled.

Every ray has its own noise, and shares errors with others: with all rays of its camera where the camera's place is not
exactly known; with all rays of its LED where the rig has that LED wrong; with all rays of other times what is not known
of the robot's motion. So the covariance of all rays together is

    S_ij = [i = j] R_i + [same camera] J_i P_c J_j' + [same LED] s^2 G_i G_j' + J_i M(t_i, t_j) J_j' + sum_d u_id u_jd'

with J the ray's derivatives by a rigid move, of the robot or its camera, P_c the covariance of the camera's place, G
those by the LED's place, M the motion's covariance between two times and u what is not known of the LEDs' light. It is
factorised once, S = L L', and the whitened residuals are minimised over six numbers (Levenberg, Marquardt).
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.fusing.joint_covariance import fill_covariance
from asterism.server.fusing.joint_rays import WHITE, linearize, work_room
from asterism.server.pose.covariance import invert
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.rotations import exp_into, product_into

STEPS = 12
STILL = 1e-9  # m and rad: a step that is none
NEAR = 1e-6  # m and rad: a step after which the next one would be none
FAR = 5e-3  # m and rad: from there on rays share other errors than where the start was
AGAIN = 4  # times that the covariance is made anew at most


@compiled
def _finish(a, h, size):
    """Divide what is left of row h by the root of its first number; whether there is one."""
    if not a[h, h] > 0.0:
        return False
    a[h, h] = 1.0 / math.sqrt(a[h, h])
    for i in range(h + 1, size):
        a[h, i] *= a[h, h]
    return True


@compiled
def factorize(a, size):
    """The upper triangle of the symmetric ``a`` becomes its Cholesky factor, with one over the diagonal; whether it has
    one. The size is even: two rows are taken from those below at once, along the rows, where processors are fastest.
    """
    for h in range(0, size, 2):
        g = h + 1
        if not _finish(a, h, size):
            return False
        share = a[h, g]
        for i in range(g, size):
            a[g, i] -= share * a[h, i]
        if not _finish(a, g, size):
            return False
        for j in range(g + 1, size):
            one, other = a[h, j], a[g, j]
            for i in range(j, size):
                a[j, i] = a[j, i] - one * a[h, i] - other * a[g, i]
    return True


@compiled
def whiten(factor, white, size):
    """Divide the columns of ``white`` (size, WHITE) by the factor, in place."""
    for h in range(size):
        for c in range(WHITE):
            white[h, c] *= factor[h, h]
        for i in range(h + 1, size):
            share = factor[h, i]
            for c in range(WHITE):
                white[i, c] -= share * white[h, c]


@compiled
def _fill_white(work, n):
    """Derivatives and residuals, before they are whitened."""
    for i in range(n):
        for a in range(2):
            for j in range(6):
                work.white[2 * i + a, j] = work.by_pose[i, a, j]
            work.white[2 * i + a, 6] = work.off[i, a]


@compiled
def _normal(white, size, products, normal, right):
    """Fill the normal matrix (6, 6) and right side (6,), by all columns' ``products`` (7, WHITE); returns chi
    squared.
    """
    products[:, :] = 0.0
    for r in range(size):
        for i in range(7):
            for j in range(WHITE):
                products[i, j] += white[r, i] * white[r, j]
    for i in range(6):
        right[i] = products[i, 6]
        for j in range(6):
            normal[i, j] = products[i, j]
    return products[6, 6]


@compiled
def _cost(work, size):
    """Chi squared of the residuals, which are in ``off``."""
    left, cost = work.off.copy().reshape(size), 0.0
    for h in range(size):
        share = left[h] * work.factor[h, h]
        cost += share * share
        for i in range(h + 1, size):
            left[i] -= work.factor[h, i] * share
    return cost


@compiled
def _damped(normal, right, damping, inverse, move):
    """Fill ``move`` (6,) with a damped step, and ``inverse`` (6, 6)."""
    a = normal.copy()
    for i in range(6):
        a[i, i] *= 1.0 + damping
    invert(a, inverse)
    for i in range(6):
        move[i] = 0.0
        for j in range(6):
            move[i] += inverse[i, j] * right[j]


@compiled
def _fit(k, pose, eyes, bodies, bundle, motion, work, covariance):
    """Refine a ``pose``, (3, 3) and (3,), in place with the rays' covariance where it starts; returns chi squared,
    `Poses.logdets` and how far it went, and fills the ``covariance``.
    """
    rotation, t = pose
    size = 2 * (bundle.first[k + 1] - bundle.first[k])
    normal, right, move, turn = np.empty((6, 6)), np.empty(6), np.empty(6), np.empty((3, 3))
    trial, trial_t, products, gone = np.empty((3, 3)), np.empty(3), np.empty((7, WHITE)), 0.0
    fill_covariance(k, rotation, t, eyes, bodies, bundle, motion, work)
    if not factorize(work.factor, size):
        return NO_SOLUTION, 0.0, 0.0
    damping, cost = 0.0, NO_SOLUTION
    for _ in range(STEPS):
        _fill_white(work, size // 2)
        whiten(work.factor, work.white, size)
        cost = _normal(work.white, size, products, normal, right)
        accepted, step, trial_cost = False, 0.0, cost
        for _ in range(8):
            _damped(normal, right, damping, covariance, move)
            exp_into(move[3], move[4], move[5], turn)
            product_into(turn, rotation, trial)
            step = 0.0
            for i in range(3):
                trial_t[i] = t[i] + move[i]
                step = max(step, abs(move[i]), abs(move[3 + i]))
            in_front = linearize(k, (trial, trial_t), eyes, bodies, bundle, motion, work, False)
            if in_front:
                trial_cost = _cost(work, size)
                if step < STILL or trial_cost <= cost * (1.0 + 1e-12):
                    accepted = True
                    break
            damping = max(10.0 * damping, 1e-3)
        if not accepted:
            linearize(k, pose, eyes, bodies, bundle, motion, work, False)
            break
        rotation[:, :] = trial
        for i in range(3):
            t[i] = trial_t[i]
        gone += step
        cost = trial_cost
        damping = 0.1 * damping if damping > 1e-5 else 0.0
        if step < NEAR:
            # What the derivatives change by on so short a way is nothing.
            break
        linearize(k, pose, eyes, bodies, bundle, motion, work, True)
    invert(normal, covariance)
    logdet = 0.0
    for i in range(size):
        logdet -= 2.0 * math.log(work.factor[i, i])
    for i in range(6):
        logdet -= 2.0 * math.log(normal[i, i])
    return cost, logdet, gone


@compiled
def solve_one(k, eyes, bodies, bundle, motion, poses):
    """Solve robot k of the bundle: its rows of the `Poses`."""
    begin, end = bundle.first[k], bundle.first[k + 1]
    rotation, t, covariance = poses.rotations[k], poses.ts[k], poses.covariances[k]
    poses.costs[k], poses.logdets[k] = NO_SOLUTION, 0.0
    covariance[:, :] = 0.0
    for i in range(begin, end):
        poses.residuals[i, :] = 0.0
    if end - begin < 3:
        return
    work = work_room(end - begin)
    cost, logdet = NO_SOLUTION, 0.0
    for _ in range(AGAIN):
        if not linearize(k, (rotation, t), eyes, bodies, bundle, motion, work, True):
            return
        cost, logdet, gone = _fit(k, (rotation, t), eyes, bodies, bundle, motion, work, covariance)
        if gone < FAR:
            break
    poses.costs[k], poses.logdets[k] = cost, logdet
    for i in range(begin, end):
        poses.residuals[i, 0], poses.residuals[i, 1] = work.off[i - begin, 0], work.off[i - begin, 1]


@compiled
def solve_joint(eyes, bodies, bundle, motion, poses):
    """Solve all robots of the bundle from the starts in the `Poses`, and fill these."""
    for k in range(bundle.bodies.shape[0]):
        solve_one(k, eyes, bodies, bundle, motion, poses)
