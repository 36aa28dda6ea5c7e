"""What is remembered of how robots move under a rolling shutter; `motion` fills it."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats

MODELS = 8  # manners of moving


class Courses(NamedTuple):
    """The motion of every robot of a rig at the mid-frame in which it was last seen; row i of every array is robot i.

    There are no rows where nothing needs it: under a global shutter.
    """

    seen_ns: NDArray[np.int64]  # (robots,), 0 for never
    rotations: Floats  # (robots, 3, 3) of T_camera_plane
    ts: Floats  # (robots, 3) m
    rates: Floats  # (robots, 6) m/s and rad/s about the camera's axes
    covariances: Floats  # (robots, 12, 12) of pose and rates
    weights: Floats  # (robots, MODELS), which sum to 1

    @staticmethod
    def none(robots: int = 0) -> "Courses":
        """No memory of so many."""
        r = robots
        numbers = np.zeros((r, 6)), np.zeros((r, 12, 12)), np.zeros((r, MODELS))
        return Courses(np.zeros(r, np.int64), np.zeros((r, 3, 3)), np.zeros((r, 3)), *numbers)

    def copy_for(self, robots: int) -> "Courses":
        """A copy to be changed; of another number of robots, none."""
        return Courses._make(column.copy() for column in self) if len(self.seen_ns) == robots else Courses.none(robots)

    def write(self, robots: NDArray[np.int64], exposed_ns: int, found: Iterable[Floats]) -> None:
        """Remember of some ``robots`` (m,) how they move now: columns from ``rotations`` on."""
        self.seen_ns[robots] = exposed_ns
        for column, new in zip(self[1:], found, strict=True):
            column[robots] = new
