"""Where a robot is a moment after its pose, if it goes on as it went, and how sure that is.

Constant velocity and turn in the robot's own axes, so on in a circle where it drives one, disturbed by as much white
acceleration as the server's filter takes for possible. The message holds
no covariance between pose and velocity; in a filter of this kind position and velocity correlate by `CORRELATION`
(steady state of the constant-velocity Kalman filter: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to
Tracking and Navigation", 2001, 6.5.2).
"""

from dataclasses import dataclass

import numpy as np

from asterism.clients.accept import UNEVEN
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.messages import RobotPose

CORRELATION = 0.7
SMALL_TURN = 1e-9  # rad
UNFORESEEN = 4.0  # times the filter's acceleration: it averages over what a robot did, not over what it may do


@dataclass(frozen=True, slots=True, eq=False)
class PredictedPose:
    """A pose that nobody saw: ``pose`` and ``covariance`` (6, 6) as in RobotPose, ``ahead_s`` after the one seen."""

    robot: str
    frame_id: str
    pose: Pose
    covariance: Floats
    ahead_s: float

    @property
    def position(self) -> Floats:
        """(3,) m, of the robot's origin in frame_id."""
        return self.pose.position

    @property
    def orientation(self) -> Floats:
        """(4,) x y z w, of the robot in frame_id."""
        return self.pose.orientation


def predict(seen: RobotPose, ahead_s: float) -> PredictedPose:
    """The pose ``ahead_s`` after its exposure. Raises InputError for a pose without velocity, and for a time that is
    not finite or before the exposure.
    """
    if seen.velocity is None:
        raise InputError(
            f"{seen.robot}: the pose has no velocity, expected one that the server smooths (serve --smooth)"
        )
    if not 0.0 <= ahead_s < float("inf"):
        raise InputError(f"{seen.robot}: {ahead_s} s ahead, expected 0 or more")
    turn = seen.pose.rotation
    velocity, rate = turn @ seen.velocity.linear, turn @ seen.velocity.angular
    gone = _mean_turn(rate * ahead_s) @ velocity * ahead_s
    pose = Pose.from_matrix(exp_rotation(rate * ahead_s) @ turn, seen.position + gone)
    return PredictedPose(seen.robot, seen.frame_id, pose, _grown(seen, ahead_s), ahead_s)


def _mean_turn(turned: Floats) -> Floats:
    """The mean (3, 3) of all rotations from none to a rotation vector (3,)."""
    angle = float(np.linalg.norm(turned))
    if angle < SMALL_TURN:
        return np.eye(3)
    x, y, z = turned / angle
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    mean: Floats = np.eye(3) + (1.0 - np.cos(angle)) / angle * hat + (1.0 - np.sin(angle) / angle) * hat @ hat
    return mean


def _grown(seen: RobotPose, ahead_s: float) -> Floats:
    """Covariance of pose and velocity together, ``ahead_s`` later."""
    assert seen.velocity is not None
    to_parent = np.kron(np.eye(2), seen.pose.rotation)
    velocity = to_parent @ seen.velocity.covariance @ to_parent.T
    half = _root(seen.covariance) @ _root(velocity).T
    linear, angular = seen.velocity.accelerations
    white = UNFORESEEN * np.repeat([linear, angular], 3) * ahead_s**3 / 3.0
    between = CORRELATION * ahead_s * (half + half.T)
    grown: Floats = seen.covariance + between + ahead_s**2 * velocity + np.diag(white)
    return grown


def _root(covariance: Floats) -> Floats:
    """Cholesky's factor (6, 6) of a covariance that was accepted: nearly singular ones have one too."""
    sigmas = np.sqrt(np.diag(covariance))
    correlations = covariance / np.outer(sigmas, sigmas)
    factor: Floats = sigmas[:, None] * np.linalg.cholesky(correlations + UNEVEN * np.eye(6))
    return factor
