"""What is remembered from frame to frame: a value that is passed in and handed back, never changed.

A robot moves on with constant velocity; how far off that may be follows from how well pose and velocity are known and
how hard robots accelerate. Nothing of this enters a published pose: it says where to look, and which of a plane's two
tilts was the right one a moment ago.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from asterism.protocol.geometry import Floats, angle_between, exp_rotation, log_rotation

ACCELERATION = 6.0  # m/s^2, one sigma: a small robot that starts or stops hard
TURN_ACCELERATION = 40.0  # rad/s^2
UNKNOWN_SPEED = 0.5  # m/s, one sigma, of a robot seen once
UNKNOWN_TURN = 3.0  # rad/s
FORGET_S = 1.0  # a robot not seen for this long is looked for anew
VELOCITY_GAIN = 0.5  # of the newest difference of poses
TILT_SIGMA = math.radians(4.0)  # how far a tilt follows its prediction
TILT_MEMORY = 0.95  # of the evidence for one tilt, a frame: errors of successive frames are not independent
MOST_EVIDENCE = math.log(1e4)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One robot as last seen: T_camera_plane (rotation, t), its motion, and the evidence for its tilt."""

    exposed_ns: int
    rotation: Floats  # (3, 3)
    t: Floats  # (3,) m
    velocity: Floats  # (3,) m/s, camera's axes
    turn: Floats  # (3,) rad/s, camera's axes
    position_sigma: float  # m
    rotation_sigma: float  # rad
    velocity_sigma: float  # m/s
    turn_sigma: float  # rad/s
    height: float  # of its spots, grey levels
    other_rotation: Floats | None  # the other tilt
    evidence: float  # log odds of the tilt over the other one


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where a robot should be now, and how sure that is (one sigma)."""

    rotation: Floats
    t: Floats
    position_sigma: float
    rotation_sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Every robot that was seen lately."""

    by_robot: dict[str, Track] = field(default_factory=dict)

    @staticmethod
    def none() -> "Tracks":
        """No memory: the next frame is searched from nothing."""
        return Tracks({})

    def at(self, exposed_ns: int) -> "Tracks":
        """The tracks that still say something at that time; none if time ran backwards."""
        kept = {
            robot: track
            for robot, track in self.by_robot.items()
            if 0 < exposed_ns - track.exposed_ns <= FORGET_S * 1e9
        }
        return Tracks(kept)


def predict(track: Track, exposed_ns: int) -> Prediction:
    """Constant-velocity prediction."""
    dt = (exposed_ns - track.exposed_ns) * 1e-9
    return Prediction(
        exp_rotation(track.turn * dt) @ track.rotation,
        track.t + track.velocity * dt,
        math.sqrt(track.position_sigma**2 + (track.velocity_sigma * dt) ** 2 + (0.5 * ACCELERATION * dt * dt) ** 2),
        math.sqrt(track.rotation_sigma**2 + (track.turn_sigma * dt) ** 2 + (0.5 * TURN_ACCELERATION * dt * dt) ** 2),
    )


def follow_track(
    before: Track | None,
    exposed_ns: int,
    rotation: Floats,
    t: Floats,
    covariance: Floats,
    height: float,
    other_rotation: Floats | None,
    evidence: float,
) -> Track:
    """The track after a robot was seen; ``evidence`` are the log odds of its tilt in all, memory included."""
    position_sigma = math.sqrt(float(np.max(np.diag(covariance)[:3])))
    rotation_sigma = math.sqrt(float(np.max(np.diag(covariance)[3:])))
    velocity, turn = np.zeros(3), np.zeros(3)
    velocity_sigma, turn_sigma = UNKNOWN_SPEED, UNKNOWN_TURN
    if before is not None:
        dt = (exposed_ns - before.exposed_ns) * 1e-9
        moved = (t - before.t) / dt
        turned = log_rotation(rotation @ before.rotation.T) / dt
        first = before.velocity_sigma >= UNKNOWN_SPEED
        gain = 1.0 if first else VELOCITY_GAIN
        velocity = before.velocity + gain * (moved - before.velocity)
        turn = before.turn + gain * (turned - before.turn)
        measured = math.sqrt(position_sigma**2 + before.position_sigma**2) / dt
        measured_turn = math.sqrt(rotation_sigma**2 + before.rotation_sigma**2) / dt
        velocity_sigma = min(measured + ACCELERATION * dt, UNKNOWN_SPEED)
        turn_sigma = min(measured_turn + TURN_ACCELERATION * dt, UNKNOWN_TURN)
    return Track(
        exposed_ns,
        rotation,
        t,
        velocity,
        turn,
        position_sigma,
        rotation_sigma,
        velocity_sigma,
        turn_sigma,
        height,
        other_rotation,
        min(evidence, MOST_EVIDENCE),
    )


def tilt_cost(track: Track, exposed_ns: int, rotation: Floats) -> float:
    """What the memory says against a tilt, in units of chi squared: distance from either remembered tilt.

    The remembered tilt costs nothing where it was, the other one what the evidence so far says against it.
    """
    dt = (exposed_ns - track.exposed_ns) * 1e-9
    sigma2 = TILT_SIGMA**2 + (track.turn_sigma * dt) ** 2
    step = exp_rotation(track.turn * dt)
    cost = angle_between(step @ track.rotation, rotation) ** 2 / sigma2
    if track.other_rotation is not None:
        other = angle_between(step @ track.other_rotation, rotation) ** 2 / sigma2
        cost = min(cost, other + 2.0 * TILT_MEMORY * track.evidence)
    return min(cost, 2.0 * MOST_EVIDENCE)
