"""What a person sees of a robot: its plate around the LEDs, and its angles in degrees."""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Robot

RIM = 0.16  # of the constellation's extent: from an LED to the edge of the plate
_ARC = 16  # corners of the circle around an LED
TO_THE_CAMERA = np.diag([1.0, -1.0, -1.0])  # x right, y up, z towards the camera, from the camera's own axes


def plate_outline(robot: Robot) -> Floats:
    """Corners (n, 3) m, in the robot's frame, of a plate that ends RIM beyond its LEDs; anticlockwise seen from the
    side to which they shine.
    """
    turns = 2 * np.pi * np.arange(_ARC) / _ARC
    circle = RIM * robot.extent * np.column_stack([np.cos(turns), np.sin(turns)])
    flat = _hull((robot.leds_plane[:, None, :2] + circle).reshape(-1, 2))
    return robot.T_robot_plane.map(np.column_stack([flat, np.zeros(len(flat))]))


def roll_pitch_yaw_deg(rotation: Floats) -> Floats:
    """Angles (3,) in degrees of R = Rz(yaw) Ry(pitch) Rx(roll), the convention of ROS (REP 103)."""
    pitch = -np.arcsin(np.clip(rotation[2, 0], -1.0, 1.0))
    roll, yaw = np.arctan2(rotation[2, 1], rotation[2, 2]), np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.degrees([roll, pitch, yaw])


def _hull(points: Floats) -> Floats:
    """The convex hull (m, 2) of points (n, 2), anticlockwise (Andrew's monotone chain, 1979)."""
    ordered = sorted(map(tuple, points.tolist()))

    def half(walk: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        kept: list[tuple[float, ...]] = []
        for point in walk:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= 0:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))


def _turn(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
