"""The other tilts in which a robot's spots may be seen: each camera's mirror image in depth, where all allow it."""

import math

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Robot
from asterism.server.fusing.joined import Hypothesis, Joined

ALLOWED = 30.0  # squared sigmas over the best: beyond that another tilt is out of the question
UNLIKE_RAD = 0.03


def other_tilts(joined: Joined, robot: Robot, told: Hypothesis) -> tuple[Pose, ...]:
    """Poses T_world_robot with another tilt than ``told`` that its spots allow, the likeliest first."""
    nothing = np.zeros(len(joined.scene.rays), np.bool_)
    found: list[Hypothesis] = []
    for c in told.cameras():
        mirrored = _mirrored(joined.sightings[c].T_world_camera, told.pose, robot)
        other = joined.explain(robot, mirrored, told.labels, nothing)
        if other is None or other.count < told.count or other.chi2 > told.chi2 + ALLOWED:
            continue
        if all(_unlike(other.pose, one.pose) for one in (told, *found)):
            found.append(other)
    return tuple(other.pose for other in sorted(found, key=lambda other: other.chi2))


def _mirrored(T_world_camera: Pose, pose: Pose, robot: Robot) -> Pose:
    """The pose that looks the same to a camera from afar, its plate tilted the other way."""
    seen = T_world_camera.inverse() @ pose @ robot.T_robot_plane
    sight = seen.position / np.linalg.norm(seen.position)
    half_turn: Floats = 2.0 * np.outer(sight, sight) - np.eye(3)
    turned = Pose.from_matrix(half_turn @ seen.rotation @ np.diag([-1.0, -1.0, 1.0]), seen.position)
    return T_world_camera @ turned @ robot.T_robot_plane.inverse()


def _unlike(one: Pose, other: Pose) -> bool:
    return abs(float(one.orientation @ other.orientation)) < math.cos(0.5 * UNLIKE_RAD)
