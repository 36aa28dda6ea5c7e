"""Whether the router that a server has joined is there: without it nobody hears what is published, and it is said."""

import time
from collections.abc import Callable

import zenoh

from asterism.server.service.threads import Ticker

LOOK_EVERY_S = 0.1
MOST = 64  # events between two looks


class Uplink:
    """Looks at a client's connection, and has ``say`` tell a person whenever it is gone, and when it is back.

    ``where`` is the router's place, in words.
    """

    def __init__(self, session: zenoh.Session, where: str, say: Callable[[str], None]) -> None:
        self._where = where
        self._say = say
        self._gone_s: float | None = None
        # No callback: the thread that zenoh runs it on may outlive the session, and Python.
        self._listener = session.info.declare_transport_events_listener(zenoh.handlers.RingChannel(MOST))
        self._looking = Ticker(self._look, LOOK_EVERY_S)

    def close(self) -> None:
        """Look no more."""
        self._looking.close()
        self._listener.undeclare()

    def _look(self) -> None:
        while (event := self._listener.handler.try_recv()) is not None:
            self._changed(event)

    def _changed(self, event: zenoh.TransportEvent) -> None:
        now_s = time.monotonic()
        if event.kind == zenoh.SampleKind.DELETE:
            self._gone_s = now_s
            self._say(f"the router at {self._where} is gone: nobody hears what is published until it is back")
        elif self._gone_s is not None:
            self._say(f"the router at {self._where} is back, after {now_s - self._gone_s:.1f} s")
            self._gone_s = None
