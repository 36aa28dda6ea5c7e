"""A client's session on the network, and the threads that read from it.

None of zenoh's own threads ever runs Python: one that wanted to while the interpreter ends would abort the process.
Samples go into channels; threads of ours read them, and all of those have ended before the interpreter does.
"""

import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

from asterism.clients.asking import HURRY_S, TICK_S, Asking
from asterism.clients.link_state import LinkState
from asterism.clients.received_pose import clock_ns
from asterism.clients.servers import Servers
from asterism.protocol import keys
from asterism.protocol.codec import decode_beat
from asterism.protocol.errors import InputError

if TYPE_CHECKING:
    import zenoh

RECONNECT_S = 0.25
QUEUE = 256  # poses that wait for a callback; the oldest go first
TOKENS = 1024
SLOW_SAID_EVERY_NS = 10_000_000_000
_LOG = logging.getLogger(__name__)

Receive = Callable[["zenoh.Sample"], None]


class Connection:
    """Opens the session as soon as there is a server; after that zenoh reconnects by itself.

    ``subscribe`` and ``follow_token`` may be called before that.
    """

    def __init__(self, config: "zenoh.Config", prefix: str, camera: str, servers: Servers) -> None:
        self._config = config
        self._prefix = prefix
        self._camera = camera
        self._servers = servers
        self._lock = threading.Lock()
        self._session: zenoh.Session | None = None
        self._wanted: list[tuple[str, Receive]] = []  # subscribed to once there is a session
        self._held: list[object] = []
        self._readers: list[threading.Thread] = []
        self._tokens: dict[str, Callable[[str, bool], None]] = {}
        self._polled: list[tuple[zenoh.Handler[zenoh.Sample], Receive]] = []
        self._slow_said_ns = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="asterism-link", daemon=True)
        self._thread.start()

    def subscribe(self, expression: str, receive: Receive) -> None:
        """Have every sample under a key expression handed to ``receive``, on a thread of its own."""
        with self._lock:
            if self._session is None:
                self._wanted.append((expression, receive))
            else:
                self._read_from(self._session, expression, receive)

    def follow_token(self, expression: str, show: Callable[[str, bool], None]) -> None:
        """Have ``show`` told the key of every liveliness token that comes (True) or goes."""
        with self._lock:
            self._tokens[expression] = show
            if self._session is not None:
                self._declare_token(self._session, expression, show)

    def close(self) -> None:
        """End the session and every thread. A Ctrl-C meanwhile is raised when that is done."""
        interrupt: KeyboardInterrupt | None = None
        self._stop.set()
        self._servers.wanted.set()
        for end in (self._thread.join, self._close_session, self._join_readers):
            while True:
                try:
                    end()
                    break
                except KeyboardInterrupt as error:
                    interrupt = error
        if interrupt is not None:
            raise interrupt

    def _close_session(self) -> None:
        with self._lock:
            if self._session is not None:
                self._session.close()
                self._session = None

    def _join_readers(self) -> None:
        for reader in self._readers:
            if reader is not threading.current_thread():  # a callback may close the client
                reader.join()

    def _run(self) -> None:
        session = self._open()
        if session is None:
            return
        asking = Asking(session, self._prefix + keys.rig(self._camera), self._servers)
        while not self._stop.is_set():
            for handler, receive in self._polled:
                while (sample := handler.try_recv()) is not None:
                    receive(sample)
            asking.step()
            self._say_if_slow()
            if asking.waiting:
                self._stop.wait(HURRY_S)
            else:
                self._servers.wanted.wait(TICK_S)

    def _open(self) -> "zenoh.Session | None":
        import zenoh

        while not self._stop.is_set():
            try:
                session = zenoh.open(self._config)
            except zenoh.ZError:
                self._stop.wait(RECONNECT_S)
                continue
            with self._lock:
                self._session = session
                self._declare_own(session)
                for expression, show in self._tokens.items():
                    self._declare_token(session, expression, show)
                for expression, receive in self._wanted:
                    self._read_from(session, expression, receive)
            return session
        return None

    def _declare_own(self, session: "zenoh.Session") -> None:
        """What tells of the servers themselves."""
        import zenoh

        self._declare_token(session, self._prefix + keys.alive(self._camera), self._server_shows)
        beats = session.declare_subscriber(self._prefix + keys.beat(self._camera), zenoh.handlers.RingChannel(QUEUE))
        self._held.append(beats)
        self._polled.append((beats.handler, self._beat))

    def _declare_token(self, session: "zenoh.Session", expression: str, show: Callable[[str, bool], None]) -> None:
        import zenoh

        def receive(sample: "zenoh.Sample") -> None:
            show(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(TOKENS)
        subscriber = session.liveliness().declare_subscriber(expression, channel, history=True)
        self._held.append(subscriber)
        self._polled.append((subscriber.handler, receive))

    def _read_from(self, session: "zenoh.Session", expression: str, receive: Receive) -> None:
        import zenoh

        subscriber = session.declare_subscriber(expression, zenoh.handlers.RingChannel(QUEUE))
        self._held.append(subscriber)

        def read() -> None:
            while not self._stop.is_set():
                try:
                    sample = subscriber.handler.recv()
                except zenoh.ZError:  # the session has ended
                    return
                receive(sample)

        reader = threading.Thread(target=read, name=f"asterism {expression}", daemon=True)
        self._readers.append(reader)
        reader.start()

    def _server_shows(self, key: str, is_alive: bool) -> None:
        self._servers[key.split("/")[-2]].shows(is_alive, clock_ns())
        self._servers.wanted.set()

    def _beat(self, sample: "zenoh.Sample") -> None:
        try:
            beat = decode_beat(sample.payload.to_bytes())
        except InputError:
            return
        self._servers[str(sample.key_expr).split("/")[-2]].beats(beat, clock_ns())

    def _say_if_slow(self) -> None:
        now_ns = clock_ns()
        if now_ns - self._slow_said_ns < SLOW_SAID_EVERY_NS:
            return
        for link in self._servers.links(now_ns).values():
            if link.state is LinkState.SLOW:
                self._slow_said_ns = now_ns
                _LOG.warning("%s", link.sentence)
