"""How a robot stands, in two angles that a person reads."""

import math

import numpy as np

from asterism.protocol.geometry import Floats

UP = np.array([0.0, 0.0, 1.0])  # along it LEDs shine where a rig does not say


def heading_deg(turn: Floats) -> float:
    """Where the robot's x axis points about the parent frame's z axis, -180 to 180 degrees; ``turn`` (3, 3) of
    T_parent_robot.
    """
    return math.degrees(math.atan2(turn[1, 0], turn[0, 0]))


def tilt_deg(turn: Floats, axis: Floats, frame_id: str) -> float:
    """Angle between the robot's LED axis (3,), in its own frame, and the world's up, its z; where poses are in the
    camera's frame, the way from the scene back to the camera, its -z. 0 to 180 degrees.
    """
    up = float(turn[2] @ axis) / float(np.linalg.norm(axis))
    return math.degrees(math.acos(min(max(up if frame_id == "world" else -up, -1.0), 1.0)))
