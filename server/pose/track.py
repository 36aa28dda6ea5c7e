"""What is remembered from frame to frame: a value that is passed in and handed back, never changed.

A robot moves on with constant velocity; how far off that may be follows from how well pose and velocity are known
and how hard robots accelerate. Nothing of this enters a published pose: it says where to look, and which of a
plane's two tilts was the right one a moment ago.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.pose.rotations import angle_between, exp_into, log_between, product_into

ACCELERATION = 6.0  # m/s^2, one sigma: a small robot that starts or stops hard
TURN_ACCELERATION = 40.0  # rad/s^2
UNKNOWN_SPEED = 0.5  # m/s, one sigma, of a robot seen once
UNKNOWN_TURN = 3.0  # rad/s
FORGET_NS = 1_000_000_000  # a robot not seen for this long is looked for anew
VELOCITY_GAIN = 0.5  # of the newest difference of poses
TILT_SIGMA = math.radians(4.0)  # how far a tilt follows its prediction
TILT_MEMORY = 0.95  # of the evidence for one tilt, a frame: errors of successive frames are not independent
MOST_EVIDENCE = math.log(1e4)

# Columns of `numbers`: one sigma of position (m), rotation (rad), velocity (m/s) and turn (rad/s); the height of the
# spots (grey levels); the evidence, in nats, for the tilt over the other one; whether there is another one.
POSITION_SIGMA, ROTATION_SIGMA, VELOCITY_SIGMA, TURN_SIGMA, HEIGHT, EVIDENCE, HAS_OTHER = range(7)


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
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
        )


@compiled
def is_fresh(seen_ns, exposed_ns):
    """Whether a robot seen then still says something now; not if time ran backwards."""
    return seen_ns > 0 and 0 < exposed_ns - seen_ns <= FORGET_NS


@compiled
def predict(seen_ns, rotations, ts, velocities, turns, numbers, exposed_ns, index, out_rotations, out_ts, out_sigmas):
    """Constant-velocity prediction of every fresh track.

    Fills ``index`` (robots,), ``out_rotations`` (robots, 3, 3), ``out_ts`` (robots, 3) and ``out_sigmas`` (robots,
    2) = position m, rotation rad; returns how many there are.
    """
    count = 0
    step = np.empty((3, 3))
    for robot in range(seen_ns.shape[0]):
        if not is_fresh(seen_ns[robot], exposed_ns):
            continue
        dt = (exposed_ns - seen_ns[robot]) * 1e-9
        exp_into(turns[robot, 0] * dt, turns[robot, 1] * dt, turns[robot, 2] * dt, step)
        product_into(step, rotations[robot], out_rotations[count])
        for i in range(3):
            out_ts[count, i] = ts[robot, i] + velocities[robot, i] * dt
        known = numbers[robot]
        out_sigmas[count, 0] = math.sqrt(
            known[POSITION_SIGMA] ** 2 + (known[VELOCITY_SIGMA] * dt) ** 2 + (0.5 * ACCELERATION * dt * dt) ** 2
        )
        out_sigmas[count, 1] = math.sqrt(
            known[ROTATION_SIGMA] ** 2 + (known[TURN_SIGMA] * dt) ** 2 + (0.5 * TURN_ACCELERATION * dt * dt) ** 2
        )
        index[count] = robot
        count += 1
    return count


@compiled
def tilt_cost(rotation, before_rotation, turn, turn_sigma, other_rotation, has_other, evidence, dt):
    """What the memory says against a tilt, in units of chi squared: its distance from either remembered tilt.

    The remembered tilt costs nothing where it was, the other one what the evidence so far says against it.
    """
    sigma2 = TILT_SIGMA**2 + (turn_sigma * dt) ** 2
    step, there = np.empty((3, 3)), np.empty((3, 3))
    exp_into(turn[0] * dt, turn[1] * dt, turn[2] * dt, step)
    product_into(step, before_rotation, there)
    cost = angle_between(there, rotation) ** 2 / sigma2
    if has_other > 0.0:
        product_into(step, other_rotation, there)
        other = angle_between(there, rotation) ** 2 / sigma2 + 2.0 * TILT_MEMORY * evidence
        cost = min(cost, other)
    return min(cost, 2.0 * MOST_EVIDENCE)


@compiled
def follow_track(
    seen_ns, rotations, ts, velocities, turns, other_rotations, numbers,
    robot, exposed_ns, rotation, t, covariance, height, other_rotation, has_other, evidence,
):  # fmt: skip
    """Write into the tracks that a robot was seen; ``evidence`` are the log odds of its tilt, memory included."""
    position_variance = max(covariance[0, 0], covariance[1, 1], covariance[2, 2])
    rotation_variance = max(covariance[3, 3], covariance[4, 4], covariance[5, 5])
    known = numbers[robot]
    velocity_sigma, turn_sigma = UNKNOWN_SPEED, UNKNOWN_TURN
    if is_fresh(seen_ns[robot], exposed_ns):
        dt = (exposed_ns - seen_ns[robot]) * 1e-9
        turned = np.empty(3)
        log_between(rotations[robot], rotation, turned)
        gain = 1.0 if known[VELOCITY_SIGMA] >= UNKNOWN_SPEED else VELOCITY_GAIN
        for i in range(3):
            velocities[robot, i] += gain * ((t[i] - ts[robot, i]) / dt - velocities[robot, i])
            turns[robot, i] += gain * (turned[i] / dt - turns[robot, i])
        moved = math.sqrt(position_variance + known[POSITION_SIGMA] ** 2) / dt
        swung = math.sqrt(rotation_variance + known[ROTATION_SIGMA] ** 2) / dt
        velocity_sigma = min(moved + ACCELERATION * dt, UNKNOWN_SPEED)
        turn_sigma = min(swung + TURN_ACCELERATION * dt, UNKNOWN_TURN)
    else:
        velocities[robot] = 0.0
        turns[robot] = 0.0
    seen_ns[robot] = exposed_ns
    rotations[robot] = rotation
    ts[robot] = t
    other_rotations[robot] = other_rotation
    known[POSITION_SIGMA] = math.sqrt(position_variance)
    known[ROTATION_SIGMA] = math.sqrt(rotation_variance)
    known[VELOCITY_SIGMA], known[TURN_SIGMA] = velocity_sigma, turn_sigma
    known[HEIGHT] = height
    known[EVIDENCE] = min(evidence, MOST_EVIDENCE)
    known[HAS_OTHER] = 1.0 if has_other else 0.0
