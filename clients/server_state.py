"""What a client knows of one server: whether it lives, its clock by session, the points that robots carry.

Pure: what came over the network is handed in, with this machine's clock in ns.
"""

import math
import threading

import numpy as np

from asterism.clients.age import SessionAge
from asterism.clients.link_state import Link, LinkState
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import PROTOCOL

SILENT_NS = 800_000_000  # four beats
LATE_S = 0.3  # between going out and arriving
FUTURE_S = 0.1  # a stamp may be ahead of what is known of the server's clock by so much
SLOW_NS = 1_000_000_000  # a link counts as slow for so long after a late message
MOST_SESSIONS = 8


class ServerState:
    """One camera's server. Safe to use from any thread."""

    def __init__(self, camera: str, wanted: threading.Event) -> None:
        self.camera = camera
        self._wanted = wanted  # set where somebody waits for its clock
        self.points: dict[str, dict[str, Floats]] = {}  # by robot and name, (3,) m in the robot's frame
        self.axes: dict[str, Floats] = {}  # by robot: along it its LEDs shine, (3,) in the robot's frame
        self.protocol = 1
        self.newer_said = False
        self._told = threading.Condition()  # notified when the server answered for a session
        self._ages: dict[int, SessionAge] = {}
        self._newest: int | None = None  # session of the newest answer
        self._answers = 0
        self._alone = False
        self._alive_since_ns: int | None = None
        self._heard_ns: int | None = None  # anything at all
        self._beat_yet = False
        self._late: tuple[int, float] | None = None  # when, and by how much

    def shows(self, is_alive: bool, now_ns: int) -> None:
        """Its liveliness token came or went."""
        self._alive_since_ns, self._heard_ns, self._beat_yet = (now_ns if is_alive else None), None, False
        if is_alive:  # perhaps another program, that tells other things
            self._newest, self._alone = None, False

    def beats(self, beat: "pb.Beat", now_ns: int) -> None:
        """It told that it lives."""
        self._beat_yet = True
        age = self.age(beat.session)
        age.runs_at(beat.rate)
        self.arrived(age, beat.time_ns, now_ns)

    def answers(self, report: "pb.RigReport", asked_ns: int, answered_ns: int) -> None:
        """It answered for its rig, and told its clock; one of protocol 1 tells none."""
        self.points = {robot.id: _finite(robot) for robot in report.robots}
        axes = {robot.id: np.array([robot.axis.x, robot.axis.y, robot.axis.z]) for robot in report.robots}
        self.axes = {robot: axis for robot, axis in axes.items() if 0.0 < np.linalg.norm(axis) < math.inf}
        self.protocol = max(report.protocol, 1)
        if not report.time_ns:
            self.tells_nothing()
            return
        with self._told:
            age = self._age(report.session)
            age.runs_at(report.rate)
            age.answered(asked_ns, answered_ns, report.time_ns)
            self._newest, self._alone = report.session, False
            self._answers += 1
            self._told.notify_all()

    def tells_nothing(self) -> None:
        """Nobody answers for this server, or it tells no clock: least delays must do, unless it told one before."""
        with self._told:
            if self.answered:
                return
            self._alone = True
            for age in self._ages.values():
                age.alone = True
            self._answers += 1
            self._told.notify_all()

    @property
    def answered(self) -> bool:
        """Whether it told its clock in the newest answer."""
        return self._newest is not None

    @property
    def asked_enough(self) -> bool:
        """Whether it told its clock, or that it tells none."""
        return self.answered or self._alone

    def age(self, session: int) -> SessionAge:
        """Ages in a session; a message that tells none (protocol 1) is of that of the newest answer."""
        with self._told:
            return self._age(session)

    def _age(self, session: int) -> SessionAge:
        if session == 0 and self._newest is not None:
            session = self._newest
        age = self._ages.pop(session, None)
        if age is None:
            age = SessionAge()
            age.alone = self._alone
        self._ages[session] = age  # the last used last
        if len(self._ages) > MOST_SESSIONS:
            del self._ages[next(iter(self._ages))]
        return age

    def wait_known(self, session: int, timeout_s: float) -> SessionAge:
        """Ages in a session, once the server has told its clock there; or it has answered twice, the second question
        surely after this one, or that time has passed.
        """
        with self._told:
            enough = self._answers + 2
            self._wanted.set()
            self._told.wait_for(lambda: self._age(session).known or self._answers >= enough, timeout_s)
            return self._age(session)

    def arrived(self, age: SessionAge, published_ns: int, now_ns: int, waited: bool = False) -> float:
        """A message arrived: by how many s later than it went out; nan where that cannot be known.

        ``waited``: perhaps it came earlier and waited for this program, which says nothing of the link.
        """
        self._heard_ns = now_ns
        time_ns = age.time_ns(now_ns)
        if time_ns is None or (published_ns - time_ns) * 1e-9 <= FUTURE_S * age.rate:
            age.heard(now_ns, published_ns)
            time_ns = age.time_ns(now_ns)
        if time_ns is None:
            return math.nan
        late_s = (time_ns - published_ns) * 1e-9 / age.rate
        if late_s > LATE_S and not waited:
            self._late = (now_ns, late_s)
        return late_s

    def link(self, now_ns: int) -> Link:
        """How things stand with it."""
        name, since_ns = f"camera {self.camera!r}", self._alive_since_ns
        if since_ns is None:
            return Link(LinkState.GONE, f"{name}: the server is gone")
        heard_ns = self._heard_ns if self._heard_ns is not None else since_ns
        # One of protocol 1 does not beat. Over a slow link the beat waits behind poses.
        if (self._beat_yet or self.protocol > 1) and now_ns - heard_ns > SILENT_NS:
            silent_s = (now_ns - heard_ns) * 1e-9
            return Link(LinkState.SILENT, f"{name}: the server has stopped answering, for {silent_s:.1f} s")
        if self._late is not None and now_ns - self._late[0] < SLOW_NS:
            told = f"{name}: the link is too slow, what the server sends arrives {self._late[1]:.1f} s late"
            return Link(LinkState.SLOW, told)
        return Link(LinkState.LIVE, f"{name}: the server is alive")

    @property
    def is_newer(self) -> bool:
        """Whether it speaks a newer protocol than this program knows."""
        return self.protocol > PROTOCOL

    @property
    def newer(self) -> str:
        """What a person is told of that."""
        return (
            f"camera {self.camera!r}: the server speaks protocol {self.protocol}, this program knows {PROTOCOL}; "
            "what is new in it is not understood: update asterism-localization here"
        )


def _finite(robot: "pb.RigRobot") -> dict[str, Floats]:
    """The points that a robot carries, if they are any."""
    points = {name: np.array([point.x, point.y, point.z]) for name, point in robot.points.items()}
    return {name: point for name, point in points.items() if np.isfinite(point).all()}
