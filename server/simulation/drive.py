"""Robots that drive about on a curved surface, each in a part of its own: where each is at a time.

On the rig's own surface a robot that `stands` has its point on it and its axis along the normal; the LEDs of others
are CLEARANCE above it.

A drive is a function of robots, seed, size and time alone, so whoever knows these knows where every robot is: cameras
of one floor show the same robots without a word to each other.
"""

import math
from collections.abc import Sequence

import numpy as np

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Robot
from asterism.server.simulation.ground import Ground, Workpiece
from asterism.server.simulation.work import SPEED, Lanes, Work

CLEARANCE = 0.03  # m, of the LEDs above the surface
APART = 0.62  # of the largest robot's size: how far from the border of its part each stays


class Drive:
    """The drive of ``robots``, on a table that reaches to ``half`` (x, y) m to both sides of its middle, with its own
    workpiece there, or on a surface of the rig, ``ground``; `Work` says how.

    ``led_brightness`` (n, 6) is of each of their LEDs, about 1.
    """

    def __init__(
        self, robots: Sequence[Robot], seed: int, half: tuple[float, float], ground: Ground | None = None,
        work: Work | None = None,
    ) -> None:  # fmt: skip
        self.robots = robots
        self.half_x, self.half_y = half
        self.ground = ground or Workpiece(self.half_x)
        self._stand = ground is not None
        self._work = work or Work()
        rng = np.random.default_rng([seed, 1])
        n = len(robots)
        apart = self._work.lanes_m
        columns, rows = parts(n, half) if apart is None else whole_parts(robots, half)
        cell_x, cell_y = 2 * self.half_x / columns, 2 * self.half_y / rows
        index = np.arange(n)
        self.centres = np.column_stack(
            [
                -self.half_x + (index % columns + 0.5) * cell_x,
                -self.half_y + (index // columns + 0.5) * cell_y,
            ]
        )
        room = max(0.5 * min(cell_x, cell_y) - APART * largest(robots), 0.0)
        self.swing = np.column_stack([np.full(n, room), room * rng.uniform(0.5, 1.0, n)])
        self.phase = rng.uniform(0, 2 * math.pi, (n, 3))
        self.pulse = SPEED / max(room, 0.02) * rng.uniform(0.6, 1.0, n)  # rad/s
        self.led_brightness = rng.uniform(0.88, 1.12, (n, LEDS))
        self.lanes = Lanes((cell_x, cell_y), apart) if apart is not None else None

    def pose(self, index: int, time_s: float) -> Pose:
        """T_table_robot of a robot at a time."""
        a = self.phase[index, 0] + self.pulse[index] * time_s
        b = self.phase[index, 1] + 2.0 * self.pulse[index] * time_s
        if self.lanes is not None:
            over, up = self.lanes.at(time_s)
            x, y = float(self.centres[index, 0] + over), float(self.centres[index, 1] + up)
        else:
            x = float(self.centres[index, 0] + self.swing[index, 0] * math.sin(a))
            y = float(self.centres[index, 1] + 0.5 * self.swing[index, 1] * math.sin(b))
        height, slope_x, slope_y = self.ground.at(x, y)
        normal = np.array([-slope_x, -slope_y, 1.0]) / math.sqrt(1 + slope_x**2 + slope_y**2)
        heading = self.phase[index, 2] + 0.6 * math.sin(a) + 0.25 * self.pulse[index] * time_s
        forward = np.array([math.cos(heading), math.sin(heading), 0.0])
        forward -= (forward @ normal) * normal
        forward /= np.linalg.norm(forward)
        turn = np.column_stack([forward, np.cross(normal, forward), normal])
        robot, place = self.robots[index], np.array([x, y, height])
        if lifted := self._work.lifted(robot.id, time_s):
            place = place + lifted * normal
        if self._stand and robot.stands is not None:
            return standing(robot, turn, place)
        return Pose.from_matrix(turn, place + CLEARANCE * normal) @ robot.T_robot_plane.inverse()


def standing(robot: Robot, turn: Floats, place: Floats) -> Pose:
    """A pose of a robot that `stands`: its point at ``place`` (3,), its axis along the third column of ``turn`` (3, 3),
    the x of its LEDs' plane as nearly along the first as that allows.
    """
    assert robot.stands is not None
    axis, x = robot.stands.axis, robot.T_robot_plane.rotation[:, 0]
    if abs(float(axis @ x)) > 0.9:
        x = robot.T_robot_plane.rotation[:, 2]
    x = x - (axis @ x) * axis
    x /= np.linalg.norm(x)
    rotation = turn @ np.column_stack([x, np.cross(axis, x), axis]).T
    return Pose.from_matrix(rotation, place - rotation @ robot.points[robot.stands.point])


def largest(robots: Sequence[Robot]) -> float:
    """The largest robot's extent, m; 0 of none. One that stands on a point beside its LEDs turns about that."""
    return max((robot.extent + 2.0 * _beside(robot) for robot in robots), default=0.0)


def _beside(robot: Robot) -> float:
    """How far the point that a robot stands on is from the middle of its LEDs, across its axis, m."""
    if robot.stands is None:
        return 0.0
    off = robot.points[robot.stands.point] - robot.leds.mean(axis=0)
    return float(np.linalg.norm(off - (off @ robot.stands.axis) * robot.stands.axis))


def parts(robots: int, half: tuple[float, float]) -> tuple[int, int]:
    """Columns and rows of the parts that so many robots have of a table."""
    columns = max(1, min(robots, round(math.sqrt(robots * half[0] / half[1]))))
    return columns, max(1, math.ceil(robots / columns))


def whole_parts(robots: Sequence[Robot], half: tuple[float, float]) -> tuple[int, int]:
    """Columns and rows that leave no part of a table to nobody, as square as may be; those of `parts` where that would
    leave too little to each.
    """
    n = len(robots)
    least = 2.0 * APART * largest(robots)
    sides = [
        (2 * half[0] / columns, 2 * half[1] * columns / n, columns) for columns in range(1, n + 1) if n % columns == 0
    ]
    roomy = [(max(x / y, y / x), columns) for x, y, columns in sides if min(x, y) >= least]
    if not roomy:
        return parts(n, half)
    columns = min(roomy)[1]
    return columns, n // columns
