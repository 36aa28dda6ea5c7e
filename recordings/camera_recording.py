"""One camera's recording, made of what its server publishes, by a program that only listens.

The rig is asked for: when the server is first heard, when it starts anew (a new recording begins), when a new session
begins, and when it tells that another rig is in force, which holds from the frame on that the event names.
"""

from collections import deque
from collections.abc import Callable

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.errors import InputError
from asterism.protocol.messages import PROTOCOL, UNNUMBERED
from asterism.protocol.rig import Rig, parse_rig
from asterism.recordings.from_network import Arrived
from asterism.recordings.in_order import InOrder
from asterism.recordings.missing import Missing
from asterism.recordings.recorder import Recorder

MOST_WAITING = 5000  # messages that wait for a rig; the oldest go first
ASK_AGAIN_S = 10.0  # also where nobody told of another rig
SOON_S = 0.5  # while one is waited for
Begin = Callable[[Rig, "pb.RigReport"], Recorder]


class CameraRecording:
    """Fed by one thread: `arrived` with every message, `answered` with what the server says of its rig whenever
    `asks` is true. ``begin`` opens a recorder; ``say`` tells a person.
    """

    def __init__(self, camera: str, begin: Begin, say: Callable[[str], None]) -> None:
        self.recorder: Recorder | None = None
        self.missing = Missing()
        self.waiting_lost = 0  # messages that waited for a rig in vain
        self.problems: list[str] = []  # of recordings that are closed
        self._camera = camera
        self._begin = begin
        self._say = say
        self._server: tuple[str, int, int] | None = None
        self._sessions: set[int] = set()  # whose rig is known
        self._waiting: deque[Arrived] = deque()
        self._wanted = True  # a rig, now
        self._asked_s = -ASK_AGAIN_S
        self._texts: tuple[object, ...] = ()
        self._next: tuple[int, Rig] | None = None  # a rig, and the frame from which it holds
        self._from: int | None = None  # the frame from which a rig holds that is asked for
        self._order = InOrder()
        self._refused = ""

    def asks(self, now_s: float) -> bool:
        """Whether the server is to be asked for its rig now."""
        if now_s - self._asked_s < (SOON_S if self._wanted else ASK_AGAIN_S):
            return False
        self._asked_s = now_s
        return True

    def arrived(self, arrived: Arrived, now_s: float) -> None:
        """A message came."""
        if arrived.session not in self._sessions or self._is_of_next(arrived):
            self._wait(arrived)
            self._want()
            return
        told = arrived.told
        if isinstance(told, pb.Event) and told.happening == pb.RIG_READ:
            self._from = told.sequence
            self._want()
        self._put(self._order.add(arrived, now_s))

    def answered(self, told: "pb.RigReport", now_s: float) -> None:
        """The server told its rig. Raises WorldError where nothing can be recorded."""
        rig = self._rig(told)
        if rig is None:
            return
        self._wanted = False
        server = (told.host, told.pid, told.started_ns)
        if self.recorder is None or server != self._server or self._counts_anew():
            self.close()
            self._server, self._sessions, self._next = server, {told.session}, None
            self.recorder = self._begin(rig, told)
        else:  # its clock may have been set, and its rig read again
            self._sessions |= {told.session, *(one.session for one in self._waiting)}
            if self._from is not None or _texts(told) != self._texts:
                self._next = self._from or 0, rig
        self._texts, self._from = _texts(told), None
        waiting, self._waiting = self._waiting, deque()
        for one in waiting:
            if one.session in self._sessions:
                self._put(self._order.add(one, now_s))
            else:
                self.waiting_lost += 1

    def tick(self, now_s: float) -> None:
        """Now and then, also where nothing arrives."""
        self._put(self._order.due(now_s))

    def close(self) -> None:
        """Finish the recording, if one was begun, and say what is in it."""
        if self.recorder is None:
            return
        self._put(self._order.rest())
        self.recorder.close(self.missing.entries())
        self._say(f"camera '{self._camera}': {self.missing}; recorded in {self.recorder.folder}")
        if self.recorder.problem:
            self.problems.append(self.recorder.problem)
        self.recorder, self.missing, self._order = None, Missing(), InOrder()

    def finish(self) -> None:
        """The same, at the end: what still waits for a rig waits in vain."""
        self.waiting_lost += len(self._waiting)
        self._waiting.clear()
        self.close()

    def _want(self) -> None:
        if not self._wanted:
            self._wanted, self._asked_s = True, self._asked_s - ASK_AGAIN_S

    def _wait(self, arrived: Arrived) -> None:
        self._waiting.append(arrived)
        if len(self._waiting) > MOST_WAITING:
            self._waiting.popleft()
            self.waiting_lost += 1

    def _counts_anew(self) -> bool:
        """Whether the frames of a new session are counted from the beginning: a replay that plays again."""
        new = (one.message for one in self._waiting if one.session not in self._sessions)
        numbers = [message.sequence for message in new if message.kind.schema not in UNNUMBERED]
        return bool(numbers) and numbers[0] <= self.missing.newest

    def _is_of_next(self, arrived: Arrived) -> bool:
        """Whether it is of a rig that was asked for, and is not here yet."""
        return self._from is not None and arrived.message.sequence >= self._from

    def _rig(self, told: "pb.RigReport") -> Rig | None:
        """The rig in an answer, or None, which is said once, where it cannot be gone by."""
        try:
            if told.protocol > PROTOCOL:
                raise InputError(
                    f"its server speaks protocol {told.protocol}, this program knows those up to {PROTOCOL}; update "
                    "asterism-localization here"
                )
            rig = parse_rig(told.rig_yaml, told.camera_yaml, f"camera '{self._camera}'", told.offset_yaml, told.files)
            if rig.camera.name != self._camera:
                raise InputError(f"who answers for its rig has one of camera '{rig.camera.name[:40]}'")
        except InputError as error:
            if str(error) != self._refused:
                self._refused = str(error)
                self._say(f"camera '{self._camera}' is not recorded: {error}")
            return None
        return rig

    def _put(self, due: list[Arrived]) -> None:
        if not due or self.recorder is None:
            return
        for one in due:
            self.missing.count(one)
        messages = [one.message for one in due]
        newest = max(messages, key=lambda message: message.sequence)
        if self._next is not None and newest.kind.schema not in UNNUMBERED and newest.sequence >= self._next[0]:
            self.recorder.take_rig(self._next[1])
            self._next = None
        self.recorder.write(messages, None, newest.log_ns, newest.sequence)


def _texts(told: "pb.RigReport") -> tuple[object, ...]:
    return told.rig_yaml, told.camera_yaml, dict(told.offset_yaml), dict(told.files)
