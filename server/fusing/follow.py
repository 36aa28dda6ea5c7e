"""How robots move, told from their fused poses: filters of several manners side by side, compiled.

State (18,): position and small rotation against a reference, their rates, and how these change; m, rad and s about the
world's axes. White jerk disturbs it, in every manner by another density, from a robot that all but keeps its
acceleration to one that is pushed. Rates of change are in the state, since within a frame a robot in a curve comes off
its tangent by more than its spots' noise. How well a manner foresaw the poses weighs it; one step of all of them is
joined into one state (generalised pseudo-Bayes of first order).

Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 6.2.3 (white
jerk), 11.6.4 (GPB1).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.pose.covariance import invert
from asterism.server.pose.rotations import exp_into, log_between, product_into
from asterism.server.pose.track import ACCELERATION, FORGET_NS, TURN_ACCELERATION, UNKNOWN_SPEED, UNKNOWN_TURN

STATE, POSE = 18, 6
JERKS = np.geomspace(1e-6, 3e3, 5)  # m^2/s^5; the last reaches 6 m/s^2 within a frame
ARM2 = 45.0  # of the turn's density over the position's, 1/m^2: of points some 0.15 m from the robot's middle
MANNERS = len(JERKS)
SOJOURN_S = 0.5  # how long a robot keeps to one manner, on average
JUMP = 60.0  # chi squared from which on a pose does not continue the motion


class Courses(NamedTuple):
    """The motion of r robots as of ``seen_ns`` (r,), 0 where nothing is known: the reference ``rotations`` (r, 3, 3),
    ``states`` (r, 18) with ``covariances`` (r, 18, 18), and how likely the manners are, ``weights`` (r, MANNERS).
    """

    seen_ns: NDArray[np.int64]
    rotations: Floats
    states: Floats
    covariances: Floats
    weights: Floats

    @staticmethod
    def unknown(robots: int) -> "Courses":
        """Of robots never seen."""
        r = robots
        return Courses(
            np.zeros(r, np.int64), np.tile(np.eye(3), (r, 1, 1)), np.zeros((r, STATE)), np.zeros((r, STATE, STATE)),
            np.full((r, MANNERS), 1.0 / MANNERS),
        )  # fmt: skip

    def copied(self) -> "Courses":
        """A copy to be changed."""
        return Courses._make(column.copy() for column in self)


class Look(NamedTuple):
    """Poses of m robots, rows ``robots`` (m,) of the `Courses`, at an exposure: ``rotations`` (m, 3, 3), ``ts`` (m, 3)
    m, the ``noise`` (m, 6, 6) that is new in them, and what is to be added to the poses foreseen, ``wider`` (m, 6, 6):
    what two poses that rest on other cameras may differ by.
    """

    robots: NDArray[np.int64]
    rotations: Floats
    ts: Floats
    noise: Floats
    wider: Floats


@compiled
def _begin(courses, k, look, row, exposed_ns):
    courses.seen_ns[k] = exposed_ns
    courses.rotations[k] = look.rotations[row]
    courses.states[k, :] = courses.covariances[k] = 0.0
    courses.weights[k, :] = 1.0 / MANNERS
    for i in range(3):
        courses.states[k, i] = look.ts[row, i]
        courses.covariances[k, 6 + i, 6 + i] = UNKNOWN_SPEED**2
        courses.covariances[k, 9 + i, 9 + i] = UNKNOWN_TURN**2
        courses.covariances[k, 12 + i, 12 + i] = ACCELERATION**2
        courses.covariances[k, 15 + i, 15 + i] = TURN_ACCELERATION**2
    courses.covariances[k, :POSE, :POSE] = look.noise[row]


@compiled
def foresee(courses, k, dt, state, covariance, rotation):
    """Fill ``state`` (18,), ``covariance`` (18, 18) and the reference ``rotation`` (3, 3) of a robot ``dt`` s later,
    without what disturbs it.
    """
    before, spread = courses.states[k], courses.covariances[k]
    half = 0.5 * dt * dt
    turn = np.empty((3, 3))
    for i in range(POSE):
        state[i] = before[i] + dt * before[6 + i] + half * before[12 + i]
        state[6 + i] = before[6 + i] + dt * before[12 + i]
        state[12 + i] = before[12 + i]
    exp_into(state[3], state[4], state[5], turn)
    product_into(turn, courses.rotations[k], rotation)
    state[3] = state[4] = state[5] = 0.0
    for i in range(POSE):
        for j in range(STATE):
            covariance[i, j] = spread[i, j] + dt * spread[6 + i, j] + half * spread[12 + i, j]
            covariance[6 + i, j] = spread[6 + i, j] + dt * spread[12 + i, j]
            covariance[12 + i, j] = spread[12 + i, j]
    for i in range(STATE):
        for j in range(POSE):
            a, b, c = covariance[i, j], covariance[i, 6 + j], covariance[i, 12 + j]
            covariance[i, j] = a + dt * b + half * c
            covariance[i, 6 + j] = b + dt * c


@compiled
def disturb(covariance, dt, density, turn_density):
    """Add to a ``covariance`` (18, 18) what white jerk does within ``dt`` s."""
    a = dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0, dt**3 / 3.0, dt * dt / 2.0, dt
    for i in range(POSE):
        q = density if i < 3 else turn_density
        covariance[i, i] += q * a[0]
        covariance[i, 6 + i] += q * a[1]
        covariance[6 + i, i] += q * a[1]
        covariance[i, 12 + i] += q * a[2]
        covariance[12 + i, i] += q * a[2]
        covariance[6 + i, 6 + i] += q * a[3]
        covariance[6 + i, 12 + i] += q * a[4]
        covariance[12 + i, 6 + i] += q * a[4]
        covariance[12 + i, 12 + i] += q * a[5]


@compiled
def _correct(covariance, noise, off, state, inverse, gains):
    """Correct a ``state`` and its ``covariance`` in place by what was seen ``off`` (6,) of it; returns chi squared and
    the logarithm of the determinant of what was expected.
    """
    spread = np.empty((POSE, POSE))
    for i in range(POSE):
        for j in range(POSE):
            spread[i, j] = covariance[i, j] + noise[i, j]
    invert(spread, inverse)
    logdet = 0.0
    for i in range(POSE):
        logdet -= 2.0 * math.log(spread[i, i])  # one over the factor's diagonal
    chi2 = 0.0
    for i in range(POSE):
        for j in range(POSE):
            chi2 += off[i] * inverse[i, j] * off[j]
    for i in range(STATE):
        for j in range(POSE):
            gains[i, j] = 0.0
            for h in range(POSE):
                gains[i, j] += covariance[i, h] * inverse[h, j]
        for j in range(POSE):
            state[i] += gains[i, j] * off[j]
    rows = covariance[:POSE].copy()
    for i in range(STATE):
        for j in range(i + 1):
            for h in range(POSE):
                covariance[i, j] -= gains[i, h] * rows[h, j]
            covariance[j, i] = covariance[i, j]
    return chi2, logdet


@compiled
def _follow(courses, k, look, row, exposed_ns):
    dt = (exposed_ns - courses.seen_ns[k]) * 1e-9
    state, covariance, rotation = np.empty(STATE), np.empty((STATE, STATE)), np.empty((3, 3))
    foresee(courses, k, dt, state, covariance, rotation)
    off, turned = np.empty(POSE), np.empty(3)
    log_between(rotation, look.rotations[row], turned)
    for i in range(3):
        off[i], off[3 + i] = look.ts[row, i] - state[i], turned[i]
    for i in range(POSE):
        for j in range(POSE):
            covariance[i, j] += look.wider[row, i, j]
    states, covariances = np.empty((MANNERS, STATE)), np.empty((MANNERS, STATE, STATE))
    inverse, gains, logs = np.empty((POSE, POSE)), np.empty((STATE, POSE)), np.empty(MANNERS)
    keeps, least = math.exp(-dt / SOJOURN_S), math.inf
    for m in range(MANNERS):
        states[m], covariances[m] = state, covariance
        disturb(covariances[m], dt, JERKS[m], ARM2 * JERKS[m])
        chi2, logdet = _correct(covariances[m], look.noise[row], off, states[m], inverse, gains)
        weight = keeps * courses.weights[k, m] + (1.0 - keeps) / MANNERS
        logs[m] = math.log(weight) - 0.5 * (chi2 + logdet)
        least = min(least, chi2)
    if not least < JUMP:
        _begin(courses, k, look, row, exposed_ns)
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
    turn = np.empty((3, 3))
    exp_into(mean[3], mean[4], mean[5], turn)
    product_into(turn, rotation, courses.rotations[k])
    mean[3] = mean[4] = mean[5] = 0.0
    courses.seen_ns[k] = exposed_ns


@compiled
def follow(courses, look, exposed_ns):
    """Bring the courses in place to an exposure by the poses that are seen there (`Look`). Robots not known before, or
    seen too long ago, begin anew.
    """
    for row in range(look.robots.shape[0]):
        k = look.robots[row]
        gone = exposed_ns - courses.seen_ns[k]
        if courses.seen_ns[k] == 0 or gone <= 0 or gone > FORGET_NS:
            _begin(courses, k, look, row, exposed_ns)
        else:
            _follow(courses, k, look, row, exposed_ns)


@compiled
def density_of(courses, k):
    """Density of the jerk that a robot's manners have together."""
    total = 0.0
    for m in range(MANNERS):
        total += courses.weights[k, m] * JERKS[m]
    return total


@compiled
def foresee_poses(courses, at_ns, rotations, ts, covariances):
    """Fill ``rotations`` (r, 3, 3), ``ts`` (r, 3) and ``covariances`` (r, 6, 6) of all robots at a time; those of whom
    nothing is known are left as they are.
    """
    state, covariance = np.empty(STATE), np.empty((STATE, STATE))
    for k in range(courses.seen_ns.shape[0]):
        dt = (at_ns - courses.seen_ns[k]) * 1e-9
        if courses.seen_ns[k] == 0 or abs(at_ns - courses.seen_ns[k]) > FORGET_NS:
            continue
        foresee(courses, k, dt, state, covariance, rotations[k])
        density = density_of(courses, k)
        disturb(covariance, abs(dt), density, ARM2 * density)
        ts[k] = state[:3]
        covariances[k] = covariance[:POSE, :POSE]
