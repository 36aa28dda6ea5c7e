"""PoseClient: where a robot is, for programs on robots and desks.

with PoseClient("tcp/127.0.0.1:7447") as robots:
    pose = robots["alpha"].latest(max_age_s=0.1)   # None when there is none so fresh
    for pose in robots["alpha"]: ...               # each new pose, newest first wins
"""

import atexit
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.protocol import keys
from asterism.protocol.codec import decode_odometry
from asterism.protocol.errors import InputError
from asterism.protocol.messages import RobotPose
from asterism.protocol.network import DEFAULT_ENDPOINT, check_endpoint, client_config

if TYPE_CHECKING:
    import zenoh

RECONNECT_S = 0.25
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedPose(RobotPose):
    """A RobotPose as it arrived: from which camera, and when by this machine's own monotonic clock."""

    camera: str
    received_s: float  # time.monotonic()

    @property
    def age_s(self) -> float:
        """Time since mid-exposure: what the server took, plus this machine's own time since the pose arrived.

        Neither a wrong clock nor a replay makes a pose look fresh or stale.
        """
        return (self.published_ns - self.exposed_ns) * 1e-9 + time.monotonic() - self.received_s


class RobotFeed:
    """One robot's poses. Made by `PoseClient`; safe to use from any thread."""

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self._changed = threading.Condition()
        self._newest: ReceivedPose | None = None
        self._count = 0
        self._callbacks: list[Callable[[ReceivedPose], None]] = []
        self._visible_by: set[str] = set()
        self._closed = False

    def latest(self, max_age_s: float) -> ReceivedPose | None:
        """The newest pose, or None when there is none of at most that age."""
        with self._changed:
            newest = self._newest
        return newest if newest is not None and newest.age_s <= max_age_s else None

    def wait(self, timeout_s: float) -> ReceivedPose | None:
        """The next pose that arrives, or None after that time."""
        with self._changed:
            before = self._count
            self._changed.wait_for(lambda: self._count > before or self._closed, timeout_s)
            return self._newest if self._count > before else None

    def __iter__(self) -> Iterator[ReceivedPose]:
        """Every new pose; one that is replaced before it is asked for is skipped. Ends when the client is closed."""
        seen = 0
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._count > seen or self._closed)  # noqa: B023
                if self._closed:
                    return
                seen = self._count
                newest = self._newest
            assert newest is not None
            yield newest

    def on_pose(self, callback: Callable[[ReceivedPose], None]) -> None:
        """Have every pose handed to ``callback``, on the network's thread: it must return quickly."""
        with self._changed:
            self._callbacks.append(callback)

    @property
    def visible(self) -> bool:
        """Whether a living server sees the robot at this moment."""
        return bool(self._visible_by)

    def _receive(self, pose: ReceivedPose) -> None:
        with self._changed:
            self._newest = pose
            self._count += 1
            callbacks = list(self._callbacks)
            self._changed.notify_all()
        for callback in callbacks:
            callback(pose)

    def _show(self, key: str, is_visible: bool) -> None:
        with self._changed:
            (self._visible_by.add if is_visible else self._visible_by.discard)(key)

    def _close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class PoseClient:
    """The robots of a server, or of all servers that a zenoh router joins. A context manager.

    ``connect`` is a zenoh endpoint; ``camera`` a camera's name or `*`; ``prefix`` is `replay/` to follow a replay;
    ``options`` a JSON5 file of zenoh options. The server may start later, and come back later: the client finds it.
    Raises InputError for a malformed endpoint or file.
    """

    def __init__(
        self,
        connect: str | None = None,
        *,
        camera: str = "*",
        prefix: str = "",
        options: Path | None = None,
    ) -> None:
        if connect is not None:
            check_endpoint(connect)
        self.endpoint = connect or (str(options) if options else DEFAULT_ENDPOINT)
        self._config = client_config(connect, options)
        self._camera = camera
        self._prefix = prefix
        self._lock = threading.Lock()
        self._feeds: dict[str, RobotFeed] = {}
        self._servers: set[str] = set()
        self._session: zenoh.Session | None = None
        self._held: list[object] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._connect, name="asterism-connect", daemon=True)
        self._thread.start()
        # zenoh's threads that call us would abort the process if Python ended beneath them.
        atexit.register(self.close)

    def __getitem__(self, robot: str) -> RobotFeed:
        """The feed of one robot. Raises InputError for an id that is no part of a key."""
        if problem := keys.key_problem(robot):
            raise InputError(f"robot id {robot!r} {problem}")
        with self._lock:
            if robot not in self._feeds:
                self._feeds[robot] = RobotFeed(robot)
                if self._session is not None:
                    self._subscribe(self._session, self._feeds[robot])
            return self._feeds[robot]

    @property
    def alive(self) -> bool:
        """Whether a server is alive on the network."""
        return bool(self._servers)

    def close(self) -> None:
        """Stop receiving; iterations over feeds end. Happens by itself when the program ends."""
        atexit.unregister(self.close)
        self._stop.set()
        self._thread.join()
        with self._lock:
            if self._session is not None:
                self._session.close()
                self._session = None
            for feed in self._feeds.values():
                feed._close()

    def __enter__(self) -> "PoseClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _connect(self) -> None:
        """Open the session as soon as there is a server; after that zenoh reconnects by itself."""
        import zenoh

        while not self._stop.is_set():
            try:
                session = zenoh.open(self._config)
            except zenoh.ZError:
                self._stop.wait(RECONNECT_S)
                continue
            with self._lock:
                self._session = session
                for feed in self._feeds.values():
                    self._subscribe(session, feed)
                self._held.append(
                    session.liveliness().declare_subscriber(
                        self._prefix + keys.alive(self._camera), self._server_shows, history=True
                    )
                )
            return

    def _subscribe(self, session: "zenoh.Session", feed: RobotFeed) -> None:
        import zenoh

        def receive(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr).removeprefix(self._prefix)
            try:
                pose = decode_odometry(sample.payload.to_bytes())
            except InputError as error:
                _LOG.warning("%s: %s; ignored", sample.key_expr, error)
                return
            feed._receive(
                ReceivedPose(
                    **{name: getattr(pose, name) for name in RobotPose.__slots__},
                    camera=key.split("/")[1],
                    received_s=time.monotonic(),
                )
            )

        def show(sample: zenoh.Sample) -> None:
            feed._show(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._held.append(session.declare_subscriber(self._prefix + keys.odometry(self._camera, feed.robot), receive))
        self._held.append(
            session.liveliness().declare_subscriber(
                self._prefix + keys.visible(self._camera, feed.robot), show, history=True
            )
        )

    def _server_shows(self, sample: "zenoh.Sample") -> None:
        import zenoh

        if sample.kind == zenoh.SampleKind.PUT:
            self._servers.add(str(sample.key_expr))
        else:
            self._servers.discard(str(sample.key_expr))
