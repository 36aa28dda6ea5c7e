"""A robot that a hand shows to the camera from all sides: what calibrations need, on the simulated camera."""

import math

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig, Robot

DEPTHS_M = (0.8, 1.5)  # where the rig gives no range
TILT = math.radians(36.0)  # about both axes, so up to 47 degrees
PIVOT_TILT = math.radians(30.0)  # at most
PIVOT_SPIN = math.radians(40.0)  # about the plate's normal


def hand_pose(rig: Rig, robot: Robot, index: int, count: int, seed: int) -> Pose:
    """T_camera_robot in frame ``index`` of ``count``: smooth, over the whole image and the rig's range, tilted to all
    sides and turned about.
    """
    start = np.random.default_rng([seed, 5]).uniform(0.0, 2.0 * math.pi, 6)
    s = 2.0 * math.pi * index / count
    near, far = rig.range_m or DEPTHS_M
    depth = 0.5 * (near + far) + 0.48 * (far - near) * math.sin(3.0 * s + start[0])
    position = depth * _ray(rig, math.sin(7.0 * s + start[1]), math.sin(11.0 * s + start[2]), robot.extent / depth)
    tilt_x, tilt_y = TILT * math.sin(5.0 * s + start[3]), TILT * math.sin(8.0 * s + start[4])
    turn = exp_rotation(np.array([tilt_x, 0.0, 0.0])) @ exp_rotation(np.array([0.0, tilt_y, 0.0]))
    facing = turn @ np.diag([1.0, -1.0, -1.0]) @ exp_rotation(np.array([0.0, 0.0, start[5] + 4.0 * s]))
    return Pose.from_matrix(facing, position) @ robot.T_robot_plane.inverse()


def pivot_pose(rig: Rig, robot: Robot, point: str, index: int, count: int, seed: int, spin: float = PIVOT_SPIN) -> Pose:
    """T_camera_robot in frame ``index`` of ``count`` of a robot that rests with a named point at one place before the
    camera and is tilted about it, by up to PIVOT_TILT from facing the camera, to all sides; and turned about its
    plate's normal by up to ``spin`` rad to each side.
    """
    start = np.random.default_rng([seed, 7]).uniform(0.0, 2.0 * math.pi, 5)
    s = 2.0 * math.pi * index / count
    near, far = rig.range_m or DEPTHS_M
    place = 0.5 * (near + far) * _ray(rig, 0.3 * math.sin(start[0]), 0.3 * math.sin(start[1]), robot.extent / near)
    tilt = PIVOT_TILT * math.sin(4.0 * s + start[2])
    lean = 3.0 * s + start[3]
    turn = exp_rotation(tilt * np.array([math.cos(lean), math.sin(lean), 0.0]))
    heading = start[4] + spin * math.sin(5.0 * s)
    facing = turn @ np.diag([1.0, -1.0, -1.0]) @ exp_rotation(np.array([0.0, 0.0, heading]))
    rotation = facing @ robot.T_robot_plane.rotation.T
    return Pose.from_matrix(rotation, place - rotation @ robot.points[point])


def _ray(rig: Rig, across: float, down: float, extent: float) -> Floats:
    """The direction (x / z, y / z, 1) at a place in the image, each from -1 to 1, as far out as the robot is whole."""
    k, camera = rig.camera.matrix, rig.camera
    out = []
    for part, size, focal, middle in (
        (across, camera.width, k[0, 0], k[0, 2]), (down, camera.height, k[1, 1], k[1, 2]),
    ):  # fmt: skip
        low, high = -middle / focal + 0.6 * extent, (size - 1.0 - middle) / focal - 0.6 * extent
        out.append(0.5 * (low + high) + 0.5 * part * max(high - low, 0.0))
    return np.array([*out, 1.0])
