"""What did not arrive of what a server published, by the numbers that stand in it."""

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.messages import ODOMETRY
from asterism.recordings.from_network import Arrived


class Missing:
    """Counts for one recording. What came before its first frame is not missed."""

    def __init__(self) -> None:
        self.frames = 0  # reports that arrived
        self.poses = 0  # which a report has, and which did not come by themselves
        self.events = 0
        self.numbers = 0  # of frames, that no report has
        self._newest: int | None = None
        self._poses: set[tuple[int, str]] = set()  # number and robot, of frames whose report is not there yet
        self._event: tuple[int, int] | None = None  # session and number
        self._dropped: tuple[int, int] | None = None  # by the server itself: as told first, and last

    def count(self, arrived: Arrived) -> None:
        """One more arrived."""
        told, number = arrived.told, arrived.message.sequence
        if arrived.message.kind is ODOMETRY:
            if self._newest is None or number > self._newest:
                self._poses.add((number, arrived.robot))
            elif self.poses:
                self.poses -= 1  # it is late
        elif isinstance(told, pb.FrameReport):
            self._count_frame(told)
        elif isinstance(told, pb.Event):
            session, before = self._event or (0, 0)
            if session == told.session:
                self.events += max(told.number - before - 1, 0)
            self._event = told.session, told.number
        elif isinstance(told, pb.Status):
            first, _ = self._dropped or (told.frames_dropped, 0)
            self._dropped = first, told.frames_dropped

    def _count_frame(self, report: "pb.FrameReport") -> None:
        self.frames += 1
        if self._newest is not None:
            self.numbers += max(report.sequence - self._newest - 1, 0)
            located = {(report.sequence, robot.id) for robot in report.robots if robot.HasField("pose")}
            self.poses += len(located - self._poses)
        self._newest = report.sequence
        self._poses = {pose for pose in self._poses if pose[0] > report.sequence}

    @property
    def newest(self) -> int:
        """Number of the newest frame, -1 before the first."""
        return -1 if self._newest is None else self._newest

    @property
    def dropped(self) -> int:
        """Frames that the server itself left out meanwhile, as its status tells: they have numbers too."""
        return max(self._dropped[1] - self._dropped[0], 0) if self._dropped else 0

    @property
    def frames_lost(self) -> int:
        """Frames whose report did not arrive."""
        return max(self.numbers - self.dropped, 0)

    def entries(self) -> dict[str, str]:
        """For a recording's last metadata."""
        return {
            "frames": str(self.frames),
            "dropped": str(self.dropped),
            "frames_not_arrived": str(self.frames_lost),
            "poses_not_arrived": str(self.poses),
            "events_not_arrived": str(self.events),
        }

    def __str__(self) -> str:
        text = f"{self.frames} frames"
        if self.dropped:
            text += f", {self.dropped} dropped by the server"
        lost = ((self.frames_lost, "frames"), (self.poses, "poses"), (self.events, "events"))
        parts = [f"{count} {what}" for count, what in lost if count]
        return f"{text}; did not arrive: {', '.join(parts)}" if parts else f"{text}, all of them arrived"
