"""Smoothing, only where somebody asks for it (`--smooth`): poses of successive frames joined by a motion model.

A filter after `localize`, which never sees it: poses that nobody asked to smooth rest on their frame alone. It takes
the published pose with its published covariance and gives back both; a robot that has no pose in a frame gets none here
either, whatever could be predicted. Its memory is a value that is passed in and handed back, like `Tracks`.

Filter: interacting multiple model (IMM) of four Kalman filters, each with constant velocity and turn rate disturbed by
white acceleration, from a robot that all but stands still to one that starts and stops hard; how well each foresaw the
measured poses weighs them. So a still robot is smoothed much, a manoeuvring one hardly, and the covariance, spread of
the four included, follows. State: position, small rotation about the parent's axes against a common reference,
velocity, turn rate. It is causal and has no fixed delay.

What it cannot know: errors that stay the same from frame to frame (calibration, LED positions) do not average out,
while the covariance after filtering takes the errors of frames for independent.

Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 6.2.2 (white
acceleration) and 11.6.6 (IMM).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.messages import Velocity
from asterism.server.chain.frame import FrameResult
from asterism.server.pose.solve import Lost, PoseEstimate
from asterism.server.pose.track import FORGET_NS, UNKNOWN_SPEED, UNKNOWN_TURN

FILTER = "interacting multiple model, constant velocity"
# Power spectral densities of the acceleration, m^2/s^3, and of the turn's, rad^2/s^3, in the four models. At 60 Hz the
# last is 6 m/s^2 and 40 rad/s^2, one sigma: a small robot that starts or stops hard.
ACCELERATIONS = np.array([0.6e-6, 0.6e-4, 0.6e-2, 0.6])
TURN_ACCELERATIONS = np.array([27e-6, 27e-4, 27e-2, 27.0])
SOJOURN_S = 0.5  # how long a robot keeps to one manner of moving, on average
JUMP = 38.0  # chi squared (six degrees of freedom, one in a million) from which on a pose does not continue the motion
MODELS = len(ACCELERATIONS)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedPose(PoseEstimate):
    """A pose that the filter joined to those before, and how the robot moves."""

    velocity: Velocity | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """One robot's motion as the four models believe it.

    ``states`` (4, 12): position m, rotation vector against ``rotation`` (3, 3), velocity m/s, turn rate rad/s, about
    the parent's axes; ``covariances`` (4, 12, 12); ``weights`` (4,), which sum to 1.
    """

    seen_ns: int
    rotation: Floats
    states: Floats
    covariances: Floats
    weights: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """What smoothing remembers: the motion of every robot that had a pose, by its id."""

    robots: Mapping[str, Motion] = field(default_factory=dict)

    @staticmethod
    def none() -> "Motions":
        """No memory: the next pose of every robot is left as it is."""
        return Motions()


def smooth(result: FrameResult, before: Motions) -> tuple[FrameResult, Motions]:
    """The frame's result with its poses smoothed and labelled so, and the memory for the next frame.

    Position, orientation and covariance are the filter's; residuals and the alternative of an ambiguous tilt stay what
    the frame said. A pose that does not continue the motion (after `track.FORGET_NS` out of sight, a jump, the other
    tilt) is left as measured, and the filter starts from it.
    """
    answers: dict[str, PoseEstimate | Lost] = {}
    motions = dict(before.robots)
    for robot, answer in result.answers.items():
        if not isinstance(answer, PoseEstimate):
            answers[robot] = answer
            continue
        motion = follow(motions.get(robot), result.exposed_ns, answer.pose, answer.covariance)
        motions[robot] = motion
        pose, covariance = estimate(motion)
        answers[robot] = SmoothedPose(
            position=pose.position,
            orientation=pose.orientation,
            covariance=covariance,
            leds=answer.leds,
            spots=answer.spots,
            residuals_px=answer.residuals_px,
            rms_px=answer.rms_px,
            alternative=answer.alternative,
            smoothed_by=FILTER,
            extrapolated=answer.extrapolated,
            velocity=velocity(motion),
        )
    return replace(result, answers=answers), Motions(motions)


def estimate(motion: Motion) -> tuple[Pose, Floats]:
    """Pose and covariance (6, 6), m and rad about the parent's axes, of all models together."""
    state, covariance = _together(motion.weights, motion.states, motion.covariances)
    turned = exp_rotation(state[3:6]) @ motion.rotation
    return Pose.from_matrix(turned, state[:3]), covariance[:6, :6]


def velocity(motion: Motion) -> Velocity:
    """How the robot moves, in its own frame: what it is unsure of its orientation makes its velocity unsure as well."""
    state, covariance = _together(motion.weights, motion.states, motion.covariances)
    turn = exp_rotation(state[3:6]) @ motion.rotation
    linear, angular = turn.T @ state[6:9], turn.T @ state[9:]
    # Where the orientation is off by e and the parent's velocity by d, the robot's is off by R^T (d + v x e).
    jacobian = np.zeros((6, 12))
    for rows, vector in ((slice(0, 3), state[6:9]), (slice(3, 6), state[9:])):
        x, y, z = vector
        jacobian[rows, 3:6] = turn.T @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    jacobian[:3, 6:9] = jacobian[3:, 9:] = turn.T
    accelerations = (float(motion.weights @ ACCELERATIONS), float(motion.weights @ TURN_ACCELERATIONS))
    spread = jacobian @ covariance @ jacobian.T
    return Velocity(linear, angular, 0.5 * (spread + spread.T), accelerations)


def follow(before: Motion | None, exposed_ns: int, pose: Pose, covariance: Floats) -> Motion:
    """The motion after one more measured pose with its covariance (6, 6)."""
    if before is None or not 0 < exposed_ns - before.seen_ns <= FORGET_NS:
        return _begin(exposed_ns, pose, covariance)
    rotation, states, covariances, weights = _predict(before, (exposed_ns - before.seen_ns) * 1e-9)
    measured = np.concatenate([pose.position, log_rotation(pose.rotation @ rotation.T)])
    innovations = measured - states[:, :6]
    spreads = covariances[:, :6, :6] + covariance
    chi2 = np.einsum("mi,mi->m", innovations, np.linalg.solve(spreads, innovations[..., None])[..., 0])
    if chi2.min() > JUMP:
        return _begin(exposed_ns, pose, covariance)
    gains = np.linalg.solve(spreads, covariances[:, :6, :]).transpose(0, 2, 1)  # (4, 12, 6)
    states = states + np.einsum("mij,mj->mi", gains, innovations)
    # Joseph's form: stays symmetric and positive.
    kept = np.eye(12) - np.concatenate([gains, np.zeros((MODELS, 12, 6))], axis=2)
    covariances = kept @ covariances @ kept.transpose(0, 2, 1) + gains @ covariance @ gains.transpose(0, 2, 1)
    log_likelihoods = np.log(weights) - 0.5 * (chi2 + np.linalg.slogdet(spreads)[1])
    weights = np.exp(log_likelihoods - log_likelihoods.max())
    weights /= weights.sum()
    # The reference follows, so that rotations against it stay small.
    turn = weights @ states[:, 3:6]
    states[:, 3:6] -= turn
    return Motion(exposed_ns, exp_rotation(turn) @ rotation, states, covariances, weights)


def _begin(exposed_ns: int, pose: Pose, covariance: Floats) -> Motion:
    """One pose, moving at any speed."""
    state, spread = np.zeros(12), np.zeros((12, 12))
    state[:3] = pose.position
    spread[:6, :6] = covariance
    spread[6:9, 6:9] = UNKNOWN_SPEED**2 * np.eye(3)
    spread[9:, 9:] = UNKNOWN_TURN**2 * np.eye(3)
    return Motion(
        exposed_ns,
        pose.rotation,
        np.tile(state, (MODELS, 1)),
        np.tile(spread, (MODELS, 1, 1)),
        np.full(MODELS, 1.0 / MODELS),
    )


def _predict(motion: Motion, dt: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Reference, states, covariances and weights of the models ``dt`` s later, their interaction first."""
    stay = math.exp(-dt / SOJOURN_S)
    switch = np.full((MODELS, MODELS), (1.0 - stay) / (MODELS - 1))
    np.fill_diagonal(switch, stay)
    joint = switch * motion.weights[:, None]  # from row, to column
    weights = joint.sum(axis=0)
    mixed = [_together(joint[:, k] / weights[k], motion.states, motion.covariances) for k in range(MODELS)]
    states = np.array([state for state, _ in mixed])
    covariances = np.array([covariance for _, covariance in mixed])
    turn = (weights @ states[:, 9:]) * dt
    on = np.eye(12)
    on[:6, 6:] = dt * np.eye(6)
    states = states @ on.T
    states[:, 3:6] -= turn
    covariances = on @ covariances @ on.T
    axes = np.arange(3)
    for first, densities in ((0, ACCELERATIONS), (3, TURN_ACCELERATIONS)):
        at, rate = first + axes, first + 6 + axes
        covariances[:, at, at] += densities[:, None] * dt**3 / 3.0
        covariances[:, at, rate] += densities[:, None] * dt**2 / 2.0
        covariances[:, rate, at] += densities[:, None] * dt**2 / 2.0
        covariances[:, rate, rate] += densities[:, None] * dt
    return exp_rotation(turn) @ motion.rotation, states, covariances, weights


def _together(weights: Floats, states: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Mean (12,) and covariance (12, 12) of weighted models, the spread of their means included."""
    mean: Floats = weights @ states
    off = states - mean
    covariance: Floats = np.einsum("m,mij->ij", weights, covariances) + (weights[:, None] * off).T @ off
    return mean, covariance
