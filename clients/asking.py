"""Asking servers for their rig, and with it for their clock."""

import contextlib
import logging
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from asterism.clients.age import SLACK_S
from asterism.clients.received_pose import clock_ns
from asterism.clients.servers import Servers
from asterism.protocol.codec import decode_rig
from asterism.protocol.errors import InputError

if TYPE_CHECKING:
    import zenoh

EVERY_S = 10.0
SOON_S = 0.2  # while a server has not answered
WANTED_S = 0.05  # while somebody waits for an answer
TIMEOUT_S = 10.0
MOST_WAITING = 3  # questions under way
ROUND_TRIP_S = SLACK_S  # a clock told after longer is asked for again soon, ...
TRIES = 5  # ... so often
TICK_S = 0.05  # between steps
HURRY_S = 0.002  # while an answer may come
EMPTY = 2  # as many questions without an answer mean that a server tells nothing
_LOG = logging.getLogger(__name__)


class _Question(NamedTuple):
    asked_ns: int
    replies: "zenoh.Handler[zenoh.Reply]"
    answered: set[str]  # cameras


class Asking:
    """Asks at once, every ten seconds, and when somebody waits; called now and then by one thread."""

    def __init__(self, session: "zenoh.Session", selector: str, servers: Servers) -> None:
        self._session = session
        self._selector = selector
        self._servers = servers
        self._under_way: list[_Question] = []
        self._asked_ns = 0
        self._tries = 0
        self._slow = False  # the newest answer took long
        self._unanswered: dict[str, int] = {}

    @property
    def waiting(self) -> bool:
        """Whether an answer may come any moment."""
        return bool(self._under_way)

    def step(self) -> None:
        """Read what was answered, ask if it is time."""
        self._under_way = [question for question in self._under_way if not self._read(question)]
        now_ns = clock_ns()
        if (now_ns - self._asked_ns) * 1e-9 < self._pause_s() or len(self._under_way) >= MOST_WAITING:
            return
        self._servers.wanted.clear()
        self._asked_ns = now_ns
        self._under_way.append(_Question(now_ns, _get(self._session, self._selector), set()))

    def _pause_s(self) -> float:
        if self._servers.wanted.is_set():
            return WANTED_S
        if self._slow or not all(state.asked_enough for state in self._servers.all()):
            return SOON_S
        return EVERY_S

    def _read(self, question: _Question) -> bool:
        """Take the answers to a question; returns whether there will be none any more."""
        import zenoh

        try:
            while (reply := question.replies.try_recv()) is not None:
                self._take(question, reply)
        except zenoh.ZError:  # the last was read
            self._count_unanswered(question)
            return True
        return False

    def _take(self, question: _Question, reply: "zenoh.Reply") -> None:
        if reply.ok is None:  # nobody answered in time: that says nothing of whether somebody will
            question.answered.update(state.camera for state in self._servers.all())
            return
        now_ns = clock_ns()
        self._slow = (now_ns - question.asked_ns) * 1e-9 > ROUND_TRIP_S and self._tries < TRIES
        self._tries = self._tries + 1 if self._slow else 0
        camera = str(reply.ok.key_expr).split("/")[-2]
        state = self._servers[camera]
        question.answered.add(camera)
        try:
            state.answers(decode_rig(reply.ok.payload.to_bytes()), question.asked_ns, now_ns)
        except InputError:
            state.tells_nothing()
        if state.is_newer and not state.newer_said:
            state.newer_said = True
            _LOG.warning("%s", state.newer)

    def _count_unanswered(self, question: _Question) -> None:
        before, self._unanswered = self._unanswered, {}
        for state in self._servers.all():
            if state.camera not in question.answered:
                count = self._unanswered[state.camera] = before.get(state.camera, 0) + 1
                if count >= EMPTY:
                    state.tells_nothing()


def _get(session: "zenoh.Session", selector: str) -> "zenoh.Handler[zenoh.Reply]":
    import zenoh

    # A ring would lose the answers that were not read before the last; and none is held back for the others.
    consolidation = zenoh.ConsolidationMode.NONE
    return session.get(selector, zenoh.handlers.FifoChannel(64), timeout=TIMEOUT_S, consolidation=consolidation)


@contextlib.contextmanager
def asking(session: "zenoh.Session", selector: str, servers: Servers) -> Iterator[None]:
    """Ask on a thread of its own, until the context ends; ``selector`` is the key expression of the rigs."""
    stop, questions = threading.Event(), Asking(session, selector, servers)

    def run() -> None:
        while not stop.wait(HURRY_S if questions.waiting else TICK_S):
            questions.step()

    thread = threading.Thread(target=run, name="asking")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
