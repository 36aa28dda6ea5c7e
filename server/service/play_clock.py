"""The clock of a replay: it runs through a recording's own times, at the replay's speed."""

import time
from collections.abc import Callable

from asterism.server.sources.session_clock import draw_session


class PlayClock:
    """Every play is a session of its own: `begin` one before its first message. Safe to read from any thread.

    ``rate`` is the replay's speed; ``monotonic`` gives ns.
    """

    def __init__(self, rate: float, monotonic: Callable[[], int] = time.monotonic_ns) -> None:
        self.rate = rate
        self.started_ns = time.time_ns()
        self._monotonic = monotonic
        self.begin(self.started_ns)

    def begin(self, first_ns: int) -> None:
        """A play begins, with what went out at ``first_ns``, ns since the Unix epoch."""
        self._play = (draw_session(), first_ns, self._monotonic())

    @property
    def session(self) -> int:
        """The number of the play."""
        return self._play[0]

    def monotonic_ns(self) -> int:
        """The clock below."""
        return self._monotonic()

    def now_ns(self, session: int | None = None) -> int:
        """The recording's time that is played now, ns since the Unix epoch."""
        number, first_ns, began_ns = self._play
        if session not in (None, number):
            raise KeyError(session)
        return first_ns + round((self._monotonic() - began_ns) * self.rate)
