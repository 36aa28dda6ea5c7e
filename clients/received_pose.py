"""A pose as it arrived, and what this machine can say of it now: its age, named points, where the robot is by now."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from asterism.clients.age import SessionAge
from asterism.clients.named_points import NamedPoint, carried
from asterism.clients.prediction import PredictedPose, predict
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import RobotPose

# A monotonic clock that goes on while the machine sleeps, where there is one: a pose from before is old.
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


def clock_ns() -> int:
    """This machine's own clock, which nobody sets."""
    return time.clock_gettime_ns(_CLOCK)


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedPose(RobotPose):
    """A RobotPose as it arrived: from which camera, when (``received_ns``, by `clock_ns`), and what its server told:
    its clock, and the points that the robot carries.
    """

    camera: str
    received_ns: int
    clock: SessionAge = field(repr=False)
    points: Mapping[str, Floats] = field(repr=False)

    @property
    def age_s(self) -> float:
        """Time since mid-exposure, s, by the server's clock as this machine knows it; infinite while it knows nothing.

        Neither a wrong clock nor data that waited on their way make a pose look fresher than it is by more than
        `age.SLACK_S`. In a replay it is time of the recording, at whatever speed it is played.
        """
        return self.clock.age_s(clock_ns(), self.exposed_ns)

    def point(self, name: str) -> NamedPoint:
        """A named point of the rig, such as the tool. Raises InputError for a name that the rig does not have."""
        if name not in self.points:
            there = ", ".join(sorted(self.points)) or "none"
            raise InputError(f"robot {self.robot!r} carries no point {name!r}; points of its rig: {there}")
        return carried(name, self.points[name], self.pose, self.covariance)

    def predicted(self, ahead_s: float = 0.0) -> PredictedPose:
        """Where the robot is ``ahead_s`` from now if it goes on as it went.

        Raises InputError where the server does not smooth, or while the pose's age is not known.
        """
        return predict(self, max(self.age_s, 0.0) + ahead_s)
