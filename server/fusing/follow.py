"""How robots move, told from how their spots move in each camera: filters of several manners side by side, compiled.

State (12,): velocity and turn, and how these change; m, rad and s about the world's axes. What is measured is by how
much a robot's rays in a camera's frame differ from those in that camera's frame before. In this difference cancels
whatever stays, as an error of the camera's place or of the LEDs', and every camera tells its own, whenever it exposes.
White jerk disturbs the state, in every manner by another density, from a robot that all but keeps its acceleration to
one that is pushed; how well a manner foresaw the rays weighs it, and one step of all of them is joined into one state
(generalised pseudo-Bayes of first order). In information form, since a camera tells little of motion along its axis:
with H the derivatives of the differences d by the state and W their information, N = sum H' W H, y = sum H' W d,

    P+ = (1 + P N)^-1 P,    s+ = s + P+ y,    -2 log likelihood = sum d' W d - y' P+ y + log det(1 + P N)

Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 6.2.3 (white
jerk), 7.2 (information form), 11.6.4 (GPB1).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.fusing.joint_rays import linearize, work_room
from asterism.server.pose.rotations import exp_into, product_into
from asterism.server.pose.track import ACCELERATION, FORGET_NS, TURN_ACCELERATION, UNKNOWN_SPEED, UNKNOWN_TURN

STATE, RATES = 12, 6
JERKS = np.geomspace(1e-6, 3e3, 5)  # m^2/s^5; the last reaches 6 m/s^2 within a frame
ARM2 = 45.0  # of the turn's density over the position's, 1/m^2: of points some 0.15 m from the robot's middle
MANNERS = len(JERKS)
SOJOURN_S = 0.5  # how long a robot keeps to one manner, on average
JUMP = 5.0  # chi squared of a degree of freedom from which on rays do not continue the motion, nor nearly so
UNKNOWN_RATES: Floats = (
    np.diag([UNKNOWN_SPEED] * 3 + [UNKNOWN_TURN] * 3 + [ACCELERATION] * 3 + [TURN_ACCELERATION] * 3) ** 2.0
)


class Courses(NamedTuple):
    """The motion of r robots as of ``seen_ns`` (r,), 0 where nothing is known: their poses then, ``rotations``
    (r, 3, 3) and ``ts`` (r, 3) m, with ``spreads`` (r, 6, 6); ``states`` (r, 12) with ``covariances`` (r, 12, 12), and
    how likely the manners are, ``weights`` (r, MANNERS).
    """

    seen_ns: NDArray[np.int64]
    rotations: Floats
    ts: Floats
    spreads: Floats
    states: Floats
    covariances: Floats
    weights: Floats

    @staticmethod
    def unknown(robots: int) -> "Courses":
        """Of robots never seen."""
        r = robots
        return Courses(
            np.zeros(r, np.int64), np.tile(np.eye(3), (r, 1, 1)), np.zeros((r, 3)), np.zeros((r, 6, 6)),
            np.zeros((r, STATE)), np.tile(UNKNOWN_RATES, (r, 1, 1)), np.full((r, MANNERS), 1.0 / MANNERS),
        )  # fmt: skip

    def copied(self) -> "Courses":
        """A copy to be changed."""
        return Courses._make(column.copy() for column in self)


class Look(NamedTuple):
    """Poses of m robots, rows ``robots`` (m,) of the `Courses`, at an exposure: ``rotations`` (m, 3, 3), ``ts`` (m, 3)
    m, with ``covariances`` (m, 6, 6).
    """

    robots: NDArray[np.int64]
    rotations: Floats
    ts: Floats
    covariances: Floats


@compiled
def _begin(courses, k):
    courses.states[k, :] = courses.covariances[k] = 0.0
    courses.weights[k, :] = 1.0 / MANNERS
    for i in range(3):
        courses.covariances[k, i, i] = UNKNOWN_SPEED**2
        courses.covariances[k, 3 + i, 3 + i] = UNKNOWN_TURN**2
        courses.covariances[k, 6 + i, 6 + i] = ACCELERATION**2
        courses.covariances[k, 9 + i, 9 + i] = TURN_ACCELERATION**2


@compiled
def _foresee(courses, k, dt, covariance):
    """Bring a robot's state on by ``dt`` s in place, and fill its ``covariance`` then, without what disturbs it."""
    state, spread = courses.states[k], courses.covariances[k]
    for i in range(RATES):
        state[i] += dt * state[RATES + i]
        for j in range(STATE):
            covariance[i, j] = spread[i, j] + dt * spread[RATES + i, j]
            covariance[RATES + i, j] = spread[RATES + i, j]
    for i in range(STATE):
        for j in range(RATES):
            covariance[i, j] += dt * covariance[i, RATES + j]


@compiled
def _disturb(covariance, dt, density):
    """Add to a ``covariance`` (12, 12) what white jerk does within ``dt`` s."""
    for i in range(RATES):
        q = density if i < 3 else ARM2 * density
        covariance[i, i] += q * dt**3 / 3.0
        covariance[i, RATES + i] += 0.5 * q * dt * dt
        covariance[RATES + i, i] += 0.5 * q * dt * dt
        covariance[RATES + i, RATES + i] += q * dt


@compiled
def _informed(covariance, information):
    """(1 + P N)^-1 P in place of P, ``covariance``; returns log det(1 + P N). Gauss, with pivots."""
    n = STATE
    a = np.empty((n, 2 * n))
    for i in range(n):
        for j in range(n):
            total = 1.0 if i == j else 0.0
            for h in range(n):
                total += covariance[i, h] * information[h, j]
            a[i, j] = total
            a[i, n + j] = covariance[i, j]
    logdet = 0.0
    for c in range(n):
        best = c
        for i in range(c + 1, n):
            if abs(a[i, c]) > abs(a[best, c]):
                best = i
        if best != c:
            for j in range(c, 2 * n):
                a[c, j], a[best, j] = a[best, j], a[c, j]
        logdet += math.log(abs(a[c, c]))
        for i in range(n):
            if i != c:
                share = a[i, c] / a[c, c]
                for j in range(c, 2 * n):
                    a[i, j] -= share * a[c, j]
    for i in range(n):
        for j in range(n):
            covariance[i, j] = a[i, n + j] / a[i, i]
    for i in range(n):
        for j in range(i):
            covariance[i, j] = covariance[j, i] = 0.5 * (covariance[i, j] + covariance[j, i])
    return logdet


@compiled
def _gather(row, look, eyes, bodies, pairs, motion, information, right):
    """Fill the ``information`` (12, 12) and the ``right`` side (12,) of what a robot's rays tell of its state; returns
    the sum of d' W d and how many rays there are, 0 where they tell nothing.
    """
    begin, end = pairs.first[row], pairs.first[row + 1]
    n = (end - begin) // 2
    information[:, :] = 0.0
    right[:] = 0.0
    if n == 0:
        return 0.0, 0
    work = work_room(2 * n)
    if not linearize(row, (look.rotations[row], look.ts[row]), eyes, bodies, pairs, motion, work, True):
        return 0.0, 0
    h, squares = np.empty((2, STATE)), 0.0
    for i in range(n):
        now, before = pairs.covariances[begin + i], pairs.covariances[begin + n + i]
        xx, xy, yy = now[0] + before[0], now[1] + before[1], now[2] + before[2]
        det = xx * yy - xy * xy
        a, b, d = yy / det, -xy / det, xx / det
        t1, t2 = pairs.times[begin + i], pairs.times[begin + n + i]
        for axis in range(2):
            for j in range(RATES):
                h[axis, j] = (t1 - t2) * work.by_pose[i, axis, j]
                h[axis, RATES + j] = 0.5 * (t1 * t1 - t2 * t2) * work.by_pose[i, axis, j]
        e, f = work.off[i, 0] - work.off[n + i, 0], work.off[i, 1] - work.off[n + i, 1]
        squares += a * e * e + 2.0 * b * e * f + d * f * f
        for j in range(STATE):
            p, q = a * h[0, j] + b * h[1, j], b * h[0, j] + d * h[1, j]
            right[j] += p * e + q * f
            for m in range(STATE):
                information[j, m] += p * h[0, m] + q * h[1, m]
    return squares, n


@compiled
def _follow(courses, k, dt, squares, rays, information, right):
    """Bring a robot's state on by ``dt`` s and correct it; ``courses.states`` is there already."""
    state = courses.states[k].copy()
    covariances, states = np.empty((MANNERS, STATE, STATE)), np.empty((MANNERS, STATE))
    logs, keeps, least = np.empty(MANNERS), math.exp(-dt / SOJOURN_S), math.inf
    _foresee(courses, k, 0.0, covariances[0])
    for m in range(MANNERS - 1, -1, -1):
        covariances[m] = covariances[0]
        _disturb(covariances[m], dt, JERKS[m])
        logdet = _informed(covariances[m], information)
        chi2 = squares
        for i in range(STATE):
            step = 0.0
            for j in range(STATE):
                step += covariances[m, i, j] * right[j]
            chi2 -= step * right[i]
            states[m, i] = state[i] + step
        weight = keeps * courses.weights[k, m] + (1.0 - keeps) / MANNERS
        logs[m] = math.log(weight) - 0.5 * (chi2 + logdet)
        least = min(least, chi2)
    if least > JUMP * 2.0 * rays:
        _begin(courses, k)
        return
    weights, mean, spread = courses.weights[k], courses.states[k], courses.covariances[k]
    total, most = 0.0, logs.max()
    for m in range(MANNERS):
        weights[m] = math.exp(logs[m] - most)
        total += weights[m]
    mean[:] = 0.0
    spread[:, :] = 0.0
    for m in range(MANNERS):
        weights[m] /= total
        mean += weights[m] * states[m]
    for m in range(MANNERS):
        for i in range(STATE):
            for j in range(STATE):
                apart = (states[m, i] - mean[i]) * (states[m, j] - mean[j])
                spread[i, j] += weights[m] * (covariances[m, i, j] + apart)


@compiled
def follow(courses, look, exposed_ns, eyes, bodies, pairs, motion):
    """Bring the courses in place to an exposure where robots have poses (`Look`). Robots not known before, or seen too
    long ago, begin anew.

    ``pairs``, a `Bundle`, holds of each of them first its rays in the frames of this exposure, then in the same order
    the same LEDs' in the same cameras' frames before; ``motion`` is room for how they move.
    """
    information, right, covariance = np.empty((STATE, STATE)), np.empty(STATE), np.empty((STATE, STATE))
    for row in range(look.robots.shape[0]):
        k = look.robots[row]
        gone = exposed_ns - courses.seen_ns[k]
        if courses.seen_ns[k] == 0 or gone <= 0 or gone > FORGET_NS:
            _begin(courses, k)
            gone = 0
        dt = gone * 1e-9
        _foresee(courses, k, dt, covariance)
        courses.covariances[k] = covariance
        motion.ages[row] = 0.0
        motion.rates[row] = courses.states[k]
        squares, rays = _gather(row, look, eyes, bodies, pairs, motion, information, right)
        _follow(courses, k, dt, squares, rays, information, right)
        courses.seen_ns[k] = exposed_ns
        courses.rotations[k], courses.ts[k] = look.rotations[row], look.ts[row]
        courses.spreads[k] = look.covariances[row]


@compiled
def foresee_poses(courses, at_ns, rotations, ts, covariances):
    """Fill ``rotations`` (r, 3, 3), ``ts`` (r, 3) and ``covariances`` (r, 6, 6) of all robots at a time; those of whom
    nothing is known are left as they are.
    """
    turn = np.empty((3, 3))
    for k in range(courses.seen_ns.shape[0]):
        if courses.seen_ns[k] == 0 or abs(at_ns - courses.seen_ns[k]) > FORGET_NS:
            continue
        dt = (at_ns - courses.seen_ns[k]) * 1e-9
        half, state, spread = 0.5 * dt * dt, courses.states[k], courses.covariances[k]
        density = 0.0
        for m in range(MANNERS):
            density += courses.weights[k, m] * JERKS[m]
        x, y, z = dt * state[3] + half * state[9], dt * state[4] + half * state[10], dt * state[5] + half * state[11]
        exp_into(x, y, z, turn)
        product_into(turn, courses.rotations[k], rotations[k])
        for i in range(RATES):
            if i < 3:
                ts[k, i] = courses.ts[k, i] + dt * state[i] + half * state[6 + i]
            for j in range(RATES):
                across = spread[i, RATES + j] + spread[RATES + i, j]
                grown = dt * dt * spread[i, j] + dt * half * across + half * half * spread[RATES + i, RATES + j]
                covariances[k, i, j] = courses.spreads[k, i, j] + grown
            covariances[k, i, i] += (1.0 if i < 3 else ARM2) * density * abs(dt) ** 5 / 20.0
