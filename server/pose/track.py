"""What is remembered from frame to frame: a value that is passed in and handed back, never changed.

A robot moves on with constant velocity; how far off that may be follows from how well pose and velocity are known
and how hard robots accelerate. Nothing of this enters a published pose: it says where to look, and which of a
plane's two tilts was the right one a moment ago.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.pose.courses import Courses
from asterism.server.pose.remembered import REMEMBERED
from asterism.server.pose.rotations import angle_between, exp_into, log_between, product_into

ACCELERATION = 6.0  # m/s^2, one sigma: a small robot that starts or stops hard
TURN_ACCELERATION = 40.0  # rad/s^2
UNKNOWN_SPEED = 0.5  # m/s, one sigma, of a robot seen once
UNKNOWN_TURN = 3.0  # rad/s
FORGET_NS = 1_000_000_000  # a robot not seen for this long is looked for anew
VELOCITY_GAIN = 0.5  # of the newest difference of poses
TILT_SIGMA = math.radians(4.0)  # how far a tilt follows its prediction
TILT_MEMORY = 0.95  # of the evidence for one tilt, a frame: errors of successive frames are not independent
MOST_EVIDENCE = math.log(1e8)

# Columns of `numbers`: one sigma of position (m), rotation (rad), velocity (m/s) and turn (rad/s); the height of the
# spots (grey levels); the evidence, in nats, for the tilt over the other one; whether there is another one.
POSITION_SIGMA, ROTATION_SIGMA, VELOCITY_SIGMA, TURN_SIGMA, HEIGHT, EVIDENCE, HAS_OTHER = range(7)

# What is learned of a robot's LEDs: how far off the rig has them, one sigma, m, as the residuals of its spots tell. It
# changes only where one block of time ends and the next begins, and is then what the last block told alone, so that
# whoever begins anywhere with the values in force agrees with whoever was there before one block later at the latest.
BLOCK_NS = 2_000_000_000  # of the time since the epoch
LEAST_SIGHTINGS = 10  # of a robot in a block, before that the old value stays and the block goes on
LEAST_MISFIT_M = 1e-6
LEAST_SHARE = 0.01  # of a pose's variance that is new in the next frame
# Columns of `misfits`: the value in force (0: nothing is known), that of the newest frame, of the block at hand the sum
# of the logarithms and the count, and which block it is.
KNOWN, NEWEST, LOG_SUM, SIGHTINGS, BLOCK = range(5)


class Tracks(NamedTuple):
    """Every robot of a rig as last seen; row i of every array is robot i. Robots never seen have seen_ns 0.

    Poses are T_camera_plane; motion is about the camera's axes.
    """

    seen_ns: NDArray[np.int64]  # (robots,)
    rotations: Floats  # (robots, 3, 3)
    ts: Floats  # (robots, 3) m
    velocities: Floats  # (robots, 3) m/s
    turns: Floats  # (robots, 3) rad/s
    other_rotations: Floats  # (robots, 3, 3): the other tilt
    numbers: Floats  # (robots, 7), see above
    courses: Courses  # under a rolling shutter only
    misfits: Floats  # (robots, 5), see above
    reasons: Floats  # (robots, 3): why a robot was missing, as `identity.explain` found last
    offs: Floats  # (robots, REMEMBERED, 3): how far off the surface light saw them, as in `remembered`

    @staticmethod
    def none(robots: int = 0) -> "Tracks":
        """No memory: the next frame is searched from nothing."""
        return Tracks(
            np.zeros(robots, np.int64),
            np.zeros((robots, 3, 3)),
            np.zeros((robots, 3)),
            np.zeros((robots, 3)),
            np.zeros((robots, 3)),
            np.zeros((robots, 3, 3)),
            np.zeros((robots, 7)),
            Courses.none(),
            np.zeros((robots, 5)),
            np.zeros((robots, 3)),
            np.zeros((robots, REMEMBERED, 3)),
        )

    def copy_for(self, robots: int) -> "Tracks":
        """A copy to be changed; of tracks of another number of robots, none."""
        if len(self.seen_ns) != robots:
            return Tracks.none(robots)
        return Tracks(
            self.seen_ns.copy(),
            self.rotations.copy(),
            self.ts.copy(),
            self.velocities.copy(),
            self.turns.copy(),
            self.other_rotations.copy(),
            self.numbers.copy(),
            self.courses,
            self.misfits.copy(),
            self.reasons.copy(),
            self.offs.copy(),
        )

    @staticmethod
    def knowing(learned: Floats) -> "Tracks":
        """No memory but what was ``learned`` (robots,) of every robot's LEDs, m, 0 for nothing: `learned_at`."""
        tracks = Tracks.none(len(learned))
        tracks.misfits[:, KNOWN] = learned
        return tracks

    def learned_at(self, exposed_ns: int) -> Floats:
        """What is known (robots,) of every robot's LEDs in a frame, m, 0 for nothing. Ends blocks that are over."""
        misfits, block = self.misfits, float(exposed_ns // BLOCK_NS)
        over = misfits[:, BLOCK] != block
        if over.any():
            told = over & (misfits[:, SIGHTINGS] >= LEAST_SIGHTINGS)
            misfits[told, KNOWN] = np.exp(misfits[told, LOG_SUM] / misfits[told, SIGHTINGS])
            misfits[told, LOG_SUM] = misfits[told, SIGHTINGS] = 0.0
            misfits[over, BLOCK] = block
        return misfits[:, KNOWN].copy()


@compiled
def is_fresh(seen_ns, exposed_ns):
    """Whether a robot seen then still says something now; not if time ran backwards."""
    return seen_ns > 0 and 0 < exposed_ns - seen_ns <= FORGET_NS


class Predicted(NamedTuple):
    """Where robots should be: ``robots`` (m,) of the rig; ``rotations`` (m, 3, 3) and ``ts`` (m, 3) m of
    T_camera_plane; ``sigmas`` (m, 2), one sigma of the position, m, and of the rotation, rad.
    """

    robots: NDArray[np.int64]
    rotations: Floats
    ts: Floats
    sigmas: Floats


@compiled
def predict_room(robots):
    """Room for the predictions of so many robots."""
    return Predicted(np.empty(robots, np.int64), np.empty((robots, 3, 3)), np.empty((robots, 3)), np.empty((robots, 2)))


@compiled
def predict(tracks, exposed_ns, predicted):
    """Fill ``predicted`` with every fresh track, moved on with constant velocity; returns how many there are."""
    count = 0
    step = np.empty((3, 3))
    for robot in range(tracks.seen_ns.shape[0]):
        if not is_fresh(tracks.seen_ns[robot], exposed_ns):
            continue
        dt = (exposed_ns - tracks.seen_ns[robot]) * 1e-9
        turn, known, sigmas = tracks.turns[robot], tracks.numbers[robot], predicted.sigmas[count]
        exp_into(turn[0] * dt, turn[1] * dt, turn[2] * dt, step)
        product_into(step, tracks.rotations[robot], predicted.rotations[count])
        for i in range(3):
            predicted.ts[count, i] = tracks.ts[robot, i] + tracks.velocities[robot, i] * dt
        sigmas[0] = math.sqrt(
            known[POSITION_SIGMA] ** 2 + (known[VELOCITY_SIGMA] * dt) ** 2 + (0.5 * ACCELERATION * dt * dt) ** 2
        )
        sigmas[1] = math.sqrt(
            known[ROTATION_SIGMA] ** 2 + (known[TURN_SIGMA] * dt) ** 2 + (0.5 * TURN_ACCELERATION * dt * dt) ** 2
        )
        predicted.robots[count] = robot
        count += 1
    return count


@compiled
def tilt_cost(tracks, robot, exposed_ns, rotation):
    """What a robot's track says against a tilt, in units of chi squared: its distance from either remembered tilt.

    The remembered tilt costs nothing where it was, the other one what the evidence so far says against it.
    """
    known, turn = tracks.numbers[robot], tracks.turns[robot]
    dt = (exposed_ns - tracks.seen_ns[robot]) * 1e-9
    sigma2 = TILT_SIGMA**2 + (known[TURN_SIGMA] * dt) ** 2
    step, there = np.empty((3, 3)), np.empty((3, 3))
    exp_into(turn[0] * dt, turn[1] * dt, turn[2] * dt, step)
    product_into(step, tracks.rotations[robot], there)
    cost = angle_between(there, rotation) ** 2 / sigma2
    if known[HAS_OTHER] > 0.0:
        product_into(step, tracks.other_rotations[robot], there)
        other = angle_between(there, rotation) ** 2 / sigma2 + 2.0 * TILT_MEMORY * known[EVIDENCE]
        cost = min(cost, other)
    return min(cost, 2.0 * MOST_EVIDENCE)


class LastSeen(NamedTuple):
    """A robot's pose in a frame: ``rotation`` (3, 3) and ``t`` (3,) m of T_camera_plane, with ``covariance`` (6, 6);
    ``height`` of its spots, grey levels; ``other_rotation`` (3, 3), its other tilt if it ``has_other``; ``evidence``,
    the log odds of its tilt, memory included; ``misfit``, m, what its residuals say of its LEDs, and ``noise_share``,
    which share of the spots' variance is their own noise.
    """

    rotation: Any
    t: Any
    covariance: Any
    height: float
    other_rotation: Any
    has_other: bool
    evidence: float
    misfit: float
    noise_share: float


@compiled
def follow_track(tracks, robot, exposed_ns, seen):
    """Write into the tracks that a robot was seen."""
    covariance, t = seen.covariance, seen.t
    position_variance = max(covariance[0, 0], covariance[1, 1], covariance[2, 2])
    rotation_variance = max(covariance[3, 3], covariance[4, 4], covariance[5, 5])
    # What the rig has wrong moves the pose likewise in the next frame.
    share = max(seen.noise_share, LEAST_SHARE)
    position_variance, rotation_variance = share * position_variance, share * rotation_variance
    known, velocity, turn = tracks.numbers[robot], tracks.velocities[robot], tracks.turns[robot]
    velocity_sigma, turn_sigma = UNKNOWN_SPEED, UNKNOWN_TURN
    if is_fresh(tracks.seen_ns[robot], exposed_ns):
        dt = (exposed_ns - tracks.seen_ns[robot]) * 1e-9
        turned = np.empty(3)
        before = tracks.rotations[robot]
        if known[HAS_OTHER] > 0.0:
            # Where the tilt is open it may be the other one this time: the robot has not turned so far.
            other = tracks.other_rotations[robot]
            if angle_between(other, seen.rotation) < angle_between(before, seen.rotation):
                before = other
        log_between(before, seen.rotation, turned)
        gain = 1.0 if known[VELOCITY_SIGMA] >= UNKNOWN_SPEED else VELOCITY_GAIN
        for i in range(3):
            velocity[i] += gain * ((t[i] - tracks.ts[robot, i]) / dt - velocity[i])
            turn[i] += gain * (turned[i] / dt - turn[i])
        moved = math.sqrt(position_variance + known[POSITION_SIGMA] ** 2) / dt
        swung = math.sqrt(rotation_variance + known[ROTATION_SIGMA] ** 2) / dt
        velocity_sigma = min(moved + ACCELERATION * dt, UNKNOWN_SPEED)
        turn_sigma = min(swung + TURN_ACCELERATION * dt, UNKNOWN_TURN)
    else:
        velocity[:] = 0.0
        turn[:] = 0.0
    tracks.seen_ns[robot] = exposed_ns
    tracks.rotations[robot] = seen.rotation
    tracks.ts[robot] = t
    tracks.other_rotations[robot] = seen.other_rotation
    known[POSITION_SIGMA] = math.sqrt(position_variance)
    known[ROTATION_SIGMA] = math.sqrt(rotation_variance)
    known[VELOCITY_SIGMA], known[TURN_SIGMA] = velocity_sigma, turn_sigma
    known[HEIGHT] = seen.height
    known[EVIDENCE] = min(seen.evidence, MOST_EVIDENCE)
    known[HAS_OTHER] = 1.0 if seen.has_other else 0.0
    misfits = tracks.misfits[robot]
    misfits[NEWEST] = seen.misfit
    misfits[LOG_SUM] += math.log(max(seen.misfit, LEAST_MISFIT_M))
    misfits[SIGHTINGS] += 1.0
