"""The clock that stamps frames: the host's monotonic clock, and one offset to the epoch for a whole session.

The wall clock may be set while robots drive; stamps of one session never notice. When it has been set, by more than
`STEP_NS`, a new session begins with a new number and a new offset, and everything that was stamped tells its session.
"""

import secrets
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

STEP_NS = 10_000_000
_APART_NS = 100_000  # of the two readings of the monotonic clock around one of the wall clock, at most, ...
_TRIES = 10  # ... in as many tries; on a busy machine the nearest pair holds


class Session(NamedTuple):
    """A time in which stamps are comparable."""

    number: int  # drawn
    offset_ns: int  # epoch less monotonic clock


class SessionClock:
    """Stamps, and the session they belong to. Safe to use from any thread.

    ``wall`` and ``monotonic`` give ns.
    """

    rate = 1.0  # at which it runs; a replay's clock has another

    def __init__(
        self, wall: Callable[[], int] = time.time_ns, monotonic: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._wall = wall
        self._monotonic = monotonic
        self._lock = threading.Lock()
        self.started_ns = wall()
        self._sessions = [Session(draw_session(), self._offset_ns())]

    @property
    def session(self) -> int:
        """The number of the session in force."""
        return self._sessions[-1].number

    def monotonic_ns(self) -> int:
        """The clock below."""
        return self._monotonic()

    def now_ns(self, session: int | None = None) -> int:
        """The time now, ns since the Unix epoch, as that session has it (none: the one in force).

        Raises KeyError for a session that never was, or is over for long.
        """
        return self.at_ns(self._monotonic(), session)

    def at_ns(self, monotonic_ns: int, session: int | None = None) -> int:
        """A time of the host's monotonic clock, likewise."""
        sessions = self._sessions
        for one in reversed(sessions):
            if session is None or one.number == session:
                return monotonic_ns + one.offset_ns
        raise KeyError(session)

    def look(self) -> int | None:
        """Begin a new session if the wall clock was set: returns by how many ns, or None where it was not."""
        with self._lock:
            before = self._sessions[-1]
            offset_ns = self._offset_ns()
            step_ns = offset_ns - before.offset_ns
            if abs(step_ns) <= STEP_NS:
                return None
            # Frames on their way were stamped in the session before.
            self._sessions = [before, Session(draw_session(), offset_ns)]
            return step_ns

    def _offset_ns(self) -> int:
        readings = []
        for _ in range(_TRIES):
            before, wall, after = self._monotonic(), self._wall(), self._monotonic()
            readings.append((after - before, wall - (before + after) // 2))
            if after - before <= _APART_NS:
                break
        return min(readings)[1]


def draw_session() -> int:
    """A session's number: never 0, which tells of no session, and small enough for a signed field of any language."""
    return secrets.randbits(62) + 1
