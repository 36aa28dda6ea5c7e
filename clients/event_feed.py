"""Events as programs take them: by callback, one after another, or the newest. None is skipped, unlike poses."""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

from asterism.clients.callbacks import Callbacks
from asterism.clients.received_pose import clock_ns
from asterism.clients.robot_event import RobotEvent, arrived
from asterism.clients.servers import Servers
from asterism.protocol.codec import decode_event
from asterism.protocol.errors import InputError

MOST_WAITING = 256  # events that wait for whoever iterates; the oldest go first
LOG_EVERY_NS = 1_000_000_000
_LOG = logging.getLogger(__name__)


class EventFeed:
    """The events of one robot, or of all. Safe to use from any thread."""

    def __init__(self) -> None:
        self.callbacks: Callbacks[RobotEvent] = Callbacks()
        self._changed = threading.Condition()
        self._kept: deque[RobotEvent] = deque(maxlen=MOST_WAITING)
        self._count = 0
        self._closed = False

    @property
    def newest(self) -> RobotEvent | None:
        """The last that arrived, if one did."""
        with self._changed:
            return self._kept[-1] if self._kept else None

    def take(self, event: RobotEvent) -> None:
        """One arrived: hand it on."""
        with self._changed:
            self._kept.append(event)
            self._count += 1
            self._changed.notify_all()
        self.callbacks.call(event)

    def close(self) -> None:
        """Nothing arrives any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def after_now(self, timeout_s: float | None) -> Iterator[RobotEvent]:
        """Every event from now on; ends when the client is closed, or when there is none for that time."""
        return self._events(self._count, timeout_s)

    def _events(self, seen: int, timeout_s: float | None) -> Iterator[RobotEvent]:
        while (event := self._next(seen, timeout_s)) is not None:
            seen, told = event
            yield told

    def _next(self, seen: int, timeout_s: float | None) -> tuple[int, RobotEvent] | None:
        """The event behind the first ``seen``, or behind those that are forgotten, and how many were seen then."""
        with self._changed:
            self._changed.wait_for(lambda: self._count > seen or self._closed, timeout_s)
            if self._closed or self._count <= seen:
                return None
            seen = max(seen, self._count - len(self._kept))
            return seen + 1, self._kept[len(self._kept) - (self._count - seen)]


class _Last(NamedTuple):
    session: int
    number: int


class EventReader:
    """Reads the messages of all cameras, and hands each to ``hand_on``. Counts what is none, and what is missing."""

    def __init__(self, servers: Servers, hand_on: Callable[[RobotEvent], None]) -> None:
        self.refused = 0
        self.missed = 0
        self._servers = servers
        self._hand_on = hand_on
        self._last: dict[str, _Last] = {}
        self._said_ns = -LOG_EVERY_NS

    def read(self, payload: bytes, camera: str) -> None:
        """A message of that camera arrived."""
        now_ns = clock_ns()
        try:
            event = decode_event(payload)
        except InputError as error:
            self.refused += 1
            self._say(f"camera {camera!r}: {error}; ignored ({self.refused} so far)", now_ns)
            return
        server = self._servers[camera]
        clock = server.age(event.session)
        server.arrived(clock, event.published_ns, now_ns)
        last = self._last.get(camera)
        self._last[camera] = _Last(event.session, event.number)
        if last is not None and last.session == event.session and event.number > last.number + 1:
            self.missed += event.number - last.number - 1
            self._say(f"camera {camera!r}: {self.missed} events did not arrive so far", now_ns)
        self._hand_on(arrived(event, camera, clock))

    def _say(self, text: str, now_ns: int) -> None:
        if now_ns - self._said_ns >= LOG_EVERY_NS:
            self._said_ns = now_ns
            _LOG.warning("%s", "".join(char if char.isprintable() else "?" for char in text)[:400])
