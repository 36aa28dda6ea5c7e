"""What happened, told once: robots lost and found, frames that stop and come again, another rig.

Robots' events follow from the frames' results alone, by their exposure times: frames solved again tell the same.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import EVENT, Happening, Message
from asterism.server.pose.solve import Lost

AT_ONCE = 10  # events of a robot, before ...
EVERY_NS = 500_000_000  # ... one of it is told in so long
SPACINGS = 3  # of frames: after so many without one they have stopped
LEFT_THE_RIG = "the rig has it no more"


class Answer(Protocol):
    """A pose, or a `Lost` with its reason."""

    @property
    def state(self) -> str: ...


class Seen(Protocol):
    """What events follow from: a frame's exposure time, ns, its number, and every robot's answer by its id."""

    @property
    def exposed_ns(self) -> int: ...

    @property
    def index(self) -> int: ...

    @property
    def answers(self) -> Mapping[str, Answer]: ...


@dataclass(slots=True)
class _Robot:
    """How a robot stands, since which frame, and what of that was told."""

    state: str = "STATE_UNSPECIFIED"
    reason: str = ""
    since_ns: int = 0
    sequence: int = 0
    changes: int = 0  # since the event before
    told: str = "STATE_UNSPECIFIED"
    told_ns: int = 0  # since when that was so
    room: float = AT_ONCE  # for events
    counted_ns: int = 0  # up to when room was added

    def stands(self, state: str, reason: str, since_ns: int, sequence: int) -> None:
        """As the newest frame has it."""
        if state != self.state:
            self.state, self.reason, self.since_ns, self.sequence = state, reason, since_ns, sequence
            self.changes += 1

    def may_tell(self, now_ns: int) -> bool:
        """Whether there is something to tell, and room for it."""
        if not self.changes:
            return False
        self.room = min(self.room + max(now_ns - self.counted_ns, 0) / EVERY_NS, AT_ONCE)
        self.counted_ns = now_ns
        return self.room >= 1.0

    def tell(self, robot: str) -> "pb.Event":
        """The event of everything since the one before."""
        event = pb.Event(
            robot=robot,
            happening=Happening.STATE_CHANGED,
            before=self.told,
            state=self.state,
            reason=self.reason,
            since_ns=self.since_ns,
            lasted_s=max(self.since_ns - self.told_ns, 0) * 1e-9 if self.told_ns else 0.0,
            sequence=self.sequence,
            left_out=self.changes - 1,
        )
        self.told, self.told_ns, self.changes, self.room = self.state, self.since_ns, 0, self.room - 1.0
        return event


class Events:
    """The events of one camera, as messages that were not stamped yet. One thread feeds it.

    Within a session; where another begins, every robot's state is told again.
    """

    def __init__(self, camera: str) -> None:
        self._key = keys.event(camera)
        self._session = 0
        self._number = 0
        self._robots: dict[str, _Robot] = {}
        self._newest: tuple[int, int] | None = None  # exposure and number of the newest frame
        self._spacing_s = 0.0  # of the two newest
        self._stopped = False  # as was told

    def add(self, result: Seen, session: int) -> list[Message]:
        """What is other in this frame than in the one before."""
        self._begin(session)
        now_ns, events = result.exposed_ns, []
        passed_s = max(now_ns - self._newest[0], 0) * 1e-9 if self._newest else 0.0
        if self._stopped:
            events.append(self._of_camera(Happening.FRAMES_CAME, "frames come again", now_ns, result.index))
            events[0].lasted_s = passed_s
        self._newest, self._stopped, self._spacing_s = (now_ns, result.index), False, passed_s
        for robot, answer in result.answers.items():
            reason = answer.reason if isinstance(answer, Lost) else ""
            self._robots.setdefault(robot, _Robot()).stands(answer.state, reason, now_ns, result.index)
        gone = [robot for robot in self._robots if robot not in result.answers]
        for robot in gone:
            self._robots[robot].stands("STATE_UNSPECIFIED", LEFT_THE_RIG, now_ns, result.index)
        events += [one.tell(robot) for robot, one in self._robots.items() if robot in gone or one.may_tell(now_ns)]
        for robot in gone:
            del self._robots[robot]
        return [self._message(event) for event in events]

    def silent(self, for_s: float, why: str) -> list[Message]:
        """No frame has come for so long. Told once, where there was one before, and they came faster than that."""
        if self._newest is None or self._stopped or for_s < SPACINGS * self._spacing_s:
            return []
        self._stopped = True
        return [self._message(self._of_camera(Happening.FRAMES_STOPPED, why, *self._newest))]

    def rig_read(self, problem: str, frame: tuple[int, int] | None, now_ns: int, session: int) -> list[Message]:
        """The rig was read again: it is in force from ``frame`` (exposure, ns, and number) on, or from the next one
        where it is None; or a ``problem`` is why it is not.
        """
        self._begin(session)
        since_ns, sequence = frame or (now_ns, self._newest[1] + 1 if self._newest else 0)
        if problem:
            return [self._message(self._of_camera(Happening.RIG_REFUSED, problem, since_ns, sequence))]
        told = "the rig was read again"
        return [self._message(self._of_camera(Happening.RIG_READ, told, since_ns, sequence))]

    def _begin(self, session: int) -> None:
        """Times of two sessions are not to be compared: in another one all begins anew."""
        if session != self._session:
            self._session, self._number = session, 0
            self._robots, self._newest, self._spacing_s = {}, None, 0.0

    def _of_camera(self, happening: "pb.Happening", why: str, since_ns: int, sequence: int) -> "pb.Event":
        return pb.Event(happening=happening, reason=why, since_ns=since_ns, sequence=sequence)

    def _message(self, event: "pb.Event") -> Message:
        self._number += 1
        event.number, event.session = self._number, self._session
        return Message(self._key, EVENT, to_bytes(event), event.since_ns, 0, event.sequence)
