"""Messages of the network in the order in which their server records them.

Poses, events and reports have queues of their own on their way. Each keeps its order; one may overtake another.
"""

from dataclasses import dataclass, field

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.messages import ODOMETRY
from asterism.recordings.from_network import Arrived

LATE_S = 0.5  # so long what is missing of a frame is waited for


@dataclass(slots=True)
class _Frame:
    """What has arrived of one frame: events of the camera, poses, the report, events of robots."""

    since_s: float
    first: list[Arrived] = field(default_factory=list)
    poses: list[Arrived] = field(default_factory=list)
    report: Arrived | None = None
    events: list[Arrived] = field(default_factory=list)

    def all(self) -> list[Arrived]:
        return [*self.first, *self.poses, *([self.report] if self.report else []), *self.events]

    def has_all_poses(self) -> bool:
        told = None if self.report is None else self.report.told
        if not isinstance(told, pb.FrameReport):
            return False
        located = {robot.id for robot in told.robots if robot.HasField("pose")}
        return located <= {pose.robot for pose in self.poses}


class InOrder:
    """Holds what belongs to a frame until all of it is there, or cannot come any more. Pure: times are this machine's,
    s.
    """

    def __init__(self) -> None:
        self._frames: dict[int, _Frame] = {}
        self._written = -1  # number of the newest frame that was handed on
        self._pose = self._report = self._event = -1  # numbers of the newest of each

    def add(self, arrived: Arrived, now_s: float) -> list[Arrived]:
        """What can be written now that this one has arrived: of each frame events of the camera, poses, the report, and
        events of robots.
        """
        number, told = arrived.message.sequence, arrived.told
        if isinstance(told, pb.Event):  # one that was held back tells of a frame that is over
            number = self._event = max(self._event, number)
        if isinstance(told, pb.Status | pb.Coverage) or number <= self._written:
            return [arrived]
        frame = self._frames.setdefault(number, _Frame(now_s))
        if arrived.message.kind is ODOMETRY:
            frame.poses.append(arrived)
            self._pose = max(self._pose, number)
        elif isinstance(told, pb.Event):
            (frame.events if told.robot else frame.first).append(arrived)
        else:
            frame.report = arrived
            self._report = max(self._report, number)
        return self.due(now_s)

    def rest(self) -> list[Arrived]:
        """All that is still held."""
        frames, self._frames = self._frames, {}
        return [one for number in sorted(frames) for one in frames[number].all()]

    def due(self, now_s: float) -> list[Arrived]:
        """What was waited for long enough."""
        due: list[Arrived] = []
        for number in sorted(self._frames):
            frame = self._frames[number]
            poses = self._pose > number or frame.has_all_poses()
            report = self._report > number or frame.report is not None
            if not (poses and report) and now_s - frame.since_s < LATE_S:
                break
            due += self._frames.pop(number).all()
            self._written = number
        return due
