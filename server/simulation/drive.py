"""Robots that drive about on a curved surface, each in a part of its own: where each is at a time.

A drive is a function of robots, seed, size and time alone, so whoever knows these knows where every robot is: cameras
of one floor show the same robots without a word to each other.
"""

import math
from collections.abc import Sequence

import numpy as np

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Robot

CLEARANCE = 0.03  # m, of the LEDs above the surface
SPEED = 0.12  # m/s, of the robots


class Drive:
    """The drive of ``robots``, on a table that reaches to ``half`` (x, y) m to both sides of its middle.

    ``led_brightness`` (n, 6) is of each of their LEDs, about 1.
    """

    def __init__(self, robots: Sequence[Robot], seed: int, half: tuple[float, float]) -> None:
        self.robots = robots
        self.half_x, self.half_y = half
        rng = np.random.default_rng([seed, 1])
        n = len(robots)
        columns, rows = parts(n, half)
        cell_x, cell_y = 2 * self.half_x / columns, 2 * self.half_y / rows
        index = np.arange(n)
        self.centres = np.column_stack(
            [
                -self.half_x + (index % columns + 0.5) * cell_x,
                -self.half_y + (index // columns + 0.5) * cell_y,
            ]
        )
        room = max(0.5 * min(cell_x, cell_y) - 0.62 * largest(robots), 0.0)
        self.swing = np.column_stack([np.full(n, room), room * rng.uniform(0.5, 1.0, n)])
        self.phase = rng.uniform(0, 2 * math.pi, (n, 3))
        self.pulse = SPEED / max(room, 0.02) * rng.uniform(0.6, 1.0, n)  # rad/s
        self.led_brightness = rng.uniform(0.88, 1.12, (n, LEDS))

    def surface(self, x: float, y: float) -> tuple[float, float, float]:
        """Height of the surface at (x, y) of the table, m, and its slopes: a free-form workpiece."""
        size = max(self.half_x, 0.1)
        rise = 0.16 * size
        k = 2.1 / size
        height = rise * math.cos(k * x) * math.cos(0.8 * k * y)
        slope_x = -rise * k * math.sin(k * x) * math.cos(0.8 * k * y)
        slope_y = -rise * 0.8 * k * math.cos(k * x) * math.sin(0.8 * k * y)
        return height, slope_x, slope_y

    def pose(self, index: int, time_s: float) -> Pose:
        """T_table_robot of a robot at a time."""
        a = self.phase[index, 0] + self.pulse[index] * time_s
        b = self.phase[index, 1] + 2.0 * self.pulse[index] * time_s
        x = float(self.centres[index, 0] + self.swing[index, 0] * math.sin(a))
        y = float(self.centres[index, 1] + 0.5 * self.swing[index, 1] * math.sin(b))
        height, slope_x, slope_y = self.surface(x, y)
        normal = np.array([-slope_x, -slope_y, 1.0]) / math.sqrt(1 + slope_x**2 + slope_y**2)
        heading = self.phase[index, 2] + 0.6 * math.sin(a) + 0.25 * self.pulse[index] * time_s
        forward = np.array([math.cos(heading), math.sin(heading), 0.0])
        forward -= (forward @ normal) * normal
        forward /= np.linalg.norm(forward)
        turn = np.column_stack([forward, np.cross(normal, forward), normal])
        T_table_plane = Pose.from_matrix(turn, np.array([x, y, height]) + CLEARANCE * normal)
        return T_table_plane @ self.robots[index].T_robot_plane.inverse()


def largest(robots: Sequence[Robot]) -> float:
    """The largest robot's extent, m; 0 of none."""
    return max((robot.extent for robot in robots), default=0.0)


def parts(robots: int, half: tuple[float, float]) -> tuple[int, int]:
    """Columns and rows of the parts that so many robots have of a table."""
    columns = max(1, min(robots, round(math.sqrt(robots * half[0] / half[1]))))
    return columns, max(1, math.ceil(robots / columns))
