"""How robots move, told from the poses of successive frames whose rows were seen at different times.

A rolling shutter sees a moving robot's LEDs where they are at their own rows' times, so its pose at mid-frame needs its
velocity, better than `track` knows it, with a covariance that is meant. A pose y that was found with the rates u0 (of
position, m/s, and rotation, rad/s) taken for the true ones u is off by what these do within the frame:
y = x + G (u - u0) + noise, with G the skew (s) of `rolling`. So the filter's state is (x, u) at mid-frame, and its
measurement matrix (1, G).

Filter: Kalman filters side by side, one step of them joined into one state (generalised pseudo-Bayes of first order):
velocity that stays the same, or turns with the robot, each disturbed by white acceleration of four densities. How well
each foresaw the measured pose weighs them.

Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 6.2.2 (white
acceleration), 11.6.4 (GPB1).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.pose.courses import MODELS, Courses
from asterism.server.pose.track import FORGET_NS, UNKNOWN_SPEED, UNKNOWN_TURN

# Power spectral densities of the acceleration, m^2/s^3, and of the turn's, rad^2/s^3: from a robot that all but keeps
# its pace to one that starts and stops hard.
ACCELERATIONS = np.tile([0.6e-6, 0.6e-4, 0.6e-2, 0.6], 2)
TURN_ACCELERATIONS = np.tile([27e-6, 27e-4, 27e-2, 27.0], 2)
TURNING = np.repeat([False, True], 4)  # whether the velocity turns with the robot
SOJOURN_S = 0.5  # how long a robot keeps to one manner of moving, on average
JUMP = 38.0  # chi squared (six degrees of freedom, one in a million) from which on a pose does not continue the motion
UNKNOWN_RATES = np.diag([UNKNOWN_SPEED**2] * 3 + [UNKNOWN_TURN**2] * 3)


class Expected(NamedTuple):
    """What is foreseen of m robots: whether they are ``known`` (m,); ``rotations`` (m, 3, 3), the reference that the
    states' rotations are told from; by every model ``states`` (m, MODELS, 12) and ``covariances`` (m, MODELS, 12, 12);
    the models' ``weights`` (m, MODELS).
    """

    known: NDArray[np.bool_]
    rotations: Floats
    states: Floats
    covariances: Floats
    weights: Floats

    def rates(self) -> "Rates":
        """What is foreseen of the rates alone."""
        states, covariances = _together(self.weights, self.states, self.covariances)
        return Rates(states[:, 6:], covariances[:, 6:, 6:], self.weights, np.zeros((len(states), 6, 6)))


class Seen(NamedTuple):
    """Poses of m robots at mid-frame: ``rotations`` (m, 3, 3), ``ts`` (m, 3) m; ``covariances`` (m, 6, 6) of their
    noise; the rates they were found with, ``used`` (m, 6), and the skews (m, 6, 6) s that say what wrong ones do.
    """

    rotations: Floats
    ts: Floats
    covariances: Floats
    used: Floats
    skews: Floats


class Moving(NamedTuple):
    """How m robots move at mid-frame: columns as of `Courses`, and the ``gains`` (m, 6, 6) by which a pose's noise got
    into the rates.
    """

    rotations: Floats
    ts: Floats
    mean: Floats
    covariances: Floats
    weights: Floats
    gains: Floats

    def with_rows(self, which: NDArray[np.bool_], others: "Moving") -> "Moving":
        """The same, but for the robots ``which`` (m,) as the ``others`` have it."""
        pairs = zip(self, others, strict=True)
        return Moving._make(np.where(which.reshape(-1, *[1] * (a.ndim - 1)), b, a) for a, b in pairs)

    def rates(self) -> "Rates":
        """What is known of the rates alone."""
        return Rates(self.mean, self.covariances[:, 6:, 6:], self.weights, self.gains)


def expect(courses: Courses, robots: NDArray[np.int64], exposed_ns: int) -> Expected:
    """What is foreseen of ``robots`` (m,); those not seen within `track.FORGET_NS` move at any speed."""
    seen_ns = courses.seen_ns[robots]
    known = (seen_ns > 0) & (exposed_ns > seen_ns) & (exposed_ns - seen_ns <= FORGET_NS)
    dt = np.where(known, exposed_ns - seen_ns, 0) * 1e-9
    m = len(robots)
    velocity, turn = courses.rates[robots, :3], courses.rates[robots, 3:]
    half, whole = turned(0.5 * turn * dt[:, None]), turned(turn * dt[:, None])
    on = np.tile(np.eye(12), (m, MODELS, 1, 1))
    on[:, :, :6, 6:] = dt[:, None, None, None] * np.eye(6)
    on[:, TURNING, :3, 6:9] = (dt[:, None, None] * half)[:, None]
    on[:, TURNING, 6:9, 6:9] = whole[:, None]
    states = np.zeros((m, MODELS, 12))
    states[:, :, :3] = courses.ts[robots][:, None] + np.einsum("mjab,mb->mja", on[:, :, :3, 6:9], velocity)
    states[:, :, 6:9] = np.einsum("mjab,mb->mja", on[:, :, 6:9, 6:9], velocity)
    states[:, :, 9:] = turn[:, None]
    covariances = on @ courses.covariances[robots][:, None] @ on.transpose(0, 1, 3, 2)
    _disturb(covariances, dt)
    covariances[~known, :, 6:, 6:] = UNKNOWN_RATES
    states[~known, :, 6:] = 0.0
    stay = np.exp(-dt / SOJOURN_S)[:, None]
    weights = stay * courses.weights[robots] + (1.0 - stay) / (MODELS - 1) * (1.0 - courses.weights[robots])
    weights[~known] = 1.0 / MODELS
    rotations = np.where(known[:, None, None], whole @ courses.rotations[robots], np.eye(3))
    return Expected(known, rotations, states, covariances, weights)


def _disturb(covariances: Floats, dt: Floats) -> None:
    """Add what white acceleration does in ``dt`` (m,) s."""
    axes = np.arange(3)
    for first, densities in ((0, ACCELERATIONS), (3, TURN_ACCELERATIONS)):
        at, rate = first + axes, first + 6 + axes
        s, d = densities[:, None], dt[:, None, None]
        covariances[:, :, at, at] += s * d**3 / 3.0
        covariances[:, :, at, rate] += s * d**2 / 2.0
        covariances[:, :, rate, at] += s * d**2 / 2.0
        covariances[:, :, rate, rate] += s * d


class Rates(NamedTuple):
    """Rates of m robots: ``mean`` (m, 6) and ``covariance`` (m, 6, 6); the models' ``weights`` (m, MODELS); ``gains``
    (m, 6, 6) by which the noise of their poses in this frame got into the mean.
    """

    mean: Floats
    covariance: Floats
    weights: Floats
    gains: Floats

    @staticmethod
    def unknown(robots: int) -> "Rates":
        """Of robots that may move at any speed."""
        m = robots
        covariance = np.tile(UNKNOWN_RATES, (m, 1, 1))
        return Rates(np.zeros((m, 6)), covariance, np.full((m, MODELS), 1.0 / MODELS), np.zeros((m, 6, 6)))


def begin(seen: Seen, rates: Rates) -> Moving:
    """How robots move by their poses in one frame and what is known of their ``rates`` beside."""
    across = seen.skews @ rates.covariance - seen.covariances @ rates.gains.transpose(0, 2, 1)
    both = seen.skews @ rates.gains @ seen.covariances
    covariances = np.empty((len(seen.ts), 12, 12))
    covariances[:, :6, :6] = seen.covariances + seen.skews @ rates.covariance @ seen.skews.transpose(0, 2, 1)
    covariances[:, :6, :6] -= both + both.transpose(0, 2, 1)
    covariances[:, :6, 6:], covariances[:, 6:, :6] = -across, -across.transpose(0, 2, 1)
    covariances[:, 6:, 6:] = rates.covariance
    off = np.einsum("mij,mj->mi", seen.skews, seen.used - rates.mean)
    rotations = turned(off[:, 3:]) @ seen.rotations
    return Moving(rotations, seen.ts + off[:, :3], rates.mean, covariances, rates.weights, rates.gains)


def follow_course(before: Expected, seen: Seen) -> Moving:
    """How robots move after one more pose; those that are not known, or that jumped, begin anew."""
    skews, m = seen.skews, len(seen.ts)
    measured = np.concatenate([seen.ts, _turn_between(before.rotations, seen.rotations)], axis=1)
    look = np.concatenate([np.tile(np.eye(6), (m, 1, 1)), skews], axis=2)[:, None]  # (m, 1, 6, 12)
    off = measured + np.einsum("mij,mj->mi", skews, seen.used)
    innovations = off[:, None] - np.einsum("mkij,mkj->mki", np.broadcast_to(look, (m, MODELS, 6, 12)), before.states)
    noise = seen.covariances[:, None]
    across = before.covariances @ look.transpose(0, 1, 3, 2)  # (m, MODELS, 12, 6)
    spreads = look @ across + noise
    gains = np.linalg.solve(spreads, across.transpose(0, 1, 3, 2)).transpose(0, 1, 3, 2)
    chi2 = np.einsum("mki,mki->mk", innovations, np.linalg.solve(spreads, innovations[..., None])[..., 0])
    states = before.states + np.einsum("mkij,mkj->mki", gains, innovations)
    kept = np.eye(12) - gains @ look  # Joseph's form: stays symmetric and positive
    covariances = kept @ before.covariances @ kept.transpose(0, 1, 3, 2) + gains @ noise @ gains.transpose(0, 1, 3, 2)
    logs = np.log(before.weights + 1e-300) - 0.5 * (chi2 + np.linalg.slogdet(spreads)[1])
    weights = np.exp(logs - logs.max(axis=1)[:, None])
    weights /= weights.sum(axis=1)[:, None]
    state, covariance = _together(weights, states, covariances)
    rotations = turned(state[:, 3:6]) @ before.rotations
    into = np.einsum("mk,mkij->mij", weights, gains[:, :, 6:])
    moving = Moving(rotations, state[:, :3], state[:, 6:], covariance, weights, into)
    anew = ~before.known | (chi2.min(axis=1) > JUMP)
    if not anew.any():
        return moving
    fresh = begin(seen, Rates.unknown(m))
    return Moving(*(np.where(anew.reshape(-1, *[1] * (a.ndim - 1)), b, a) for a, b in zip(moving, fresh, strict=True)))


def turned(vectors: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad."""
    # Here and not above: it takes a third of a second to load, and only rolling shutters need it.
    from scipy.spatial.transform import Rotation

    matrices: Floats = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return matrices.reshape(*vectors.shape, 3)


def _turn_between(a: Floats, b: Floats) -> Floats:
    """Rotation vectors (m, 3), rad, about the parent's axes, that lead from a to b (m, 3, 3)."""
    from scipy.spatial.transform import Rotation

    vectors: Floats = Rotation.from_matrix(b @ a.transpose(0, 2, 1)).as_rotvec()
    return vectors


def is_green(rates: Rates) -> NDArray[np.bool_]:
    """Which robots (m,) were seen only once before: of their velocities nothing is known."""
    return rates.covariance[:, 0, 0] > 0.5 * UNKNOWN_SPEED**2


def density(weights: Floats) -> Floats:
    """Power spectral densities (m, 6) of the accelerations, m^2/s^3 and rad^2/s^3, by the models' ``weights``."""
    told: Floats = np.repeat(np.stack([weights @ ACCELERATIONS, weights @ TURN_ACCELERATIONS], axis=1), 3, axis=1)
    return told


def share_turning(weights: Floats) -> Floats:
    """How likely it is that velocities turn with the robots (m,)."""
    share: Floats = weights[:, TURNING].sum(axis=1)
    return share


def _together(weights: Floats, states: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Means (m, 12) and covariances (m, 12, 12) of weighted models, the spread of their means included."""
    mean = np.einsum("mk,mki->mi", weights, states)
    off = states - mean[:, None]
    covariance = np.einsum("mk,mkij->mij", weights, covariances) + np.einsum("mk,mki,mkj->mij", weights, off, off)
    return mean, covariance
