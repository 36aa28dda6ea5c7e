"""PoseClient: where a robot is, for programs on robots and desks.

with PoseClient("tcp/127.0.0.1:7447") as robots:
    pose = robots["alpha"].latest(max_age_s=0.1)   # None when there is none so fresh
    for pose in robots["alpha"]: ...               # each new pose, newest first wins
    robots["alpha"].on_event(print)                # lost, found: why, and since when
"""

import atexit
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.clients.connection import Connection
from asterism.clients.event_feed import EventReader
from asterism.clients.feed import Feed
from asterism.clients.link_state import Link, LinkState
from asterism.clients.received_pose import clock_ns
from asterism.clients.robot_event import RobotEvent
from asterism.clients.robot_feed import AllRobots, RobotFeed
from asterism.clients.servers import Servers
from asterism.protocol import keys
from asterism.protocol.errors import InputError
from asterism.protocol.network import DEFAULT_ENDPOINT, check_endpoint, client_config

if TYPE_CHECKING:
    import zenoh


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
        self._camera = camera
        self._prefix = prefix
        self._lock = threading.Lock()
        self._feeds: dict[str, RobotFeed] = {}
        self._all: AllRobots | None = None
        self._servers = Servers(self.endpoint)
        self._events: EventReader | None = None
        self._connection = Connection(client_config(connect, options), prefix, camera, self._servers)
        # Threads that read from zenoh would abort the process if Python ended beneath them.
        atexit.register(self.close)

    def __getitem__(self, robot: str) -> RobotFeed:
        """The feed of one robot. Raises InputError for an id that is no part of a key."""
        if problem := keys.key_problem(robot):
            raise InputError(f"robot id {robot!r} {problem}")
        with self._lock:
            feed = self._feeds.get(robot)
            if feed is None:
                feed = self._feeds[robot] = RobotFeed(robot, lambda: self.link, self._servers.robots)
                self._follow_events()
                self._connection.follow_token(self._prefix + keys.visible(self._camera, robot), feed._show)
                self._follow(feed, robot)
            return feed

    def all(self) -> AllRobots:
        """The feed of all robots."""
        with self._lock:
            if self._all is None:
                self._all = AllRobots()
                self._follow_events()
                self._follow(self._all, "*")
            return self._all

    @property
    def alive(self) -> bool:
        """Whether a server is alive on the network, and answers."""
        return self.link.state in (LinkState.LIVE, LinkState.SLOW)

    @property
    def link(self) -> Link:
        """How things stand with the server; with several, that which serves best."""
        return self._servers.link(clock_ns())

    @property
    def links(self) -> dict[str, Link]:
        """How things stand with every server heard of, by camera."""
        return self._servers.links(clock_ns())

    @property
    def events_missed(self) -> int:
        """Events that did not arrive, though others after them did."""
        return 0 if self._events is None else self._events.missed

    def close(self) -> None:
        """Stop receiving; iterations over feeds end. Happens by itself when the program ends."""
        atexit.unregister(self.close)
        try:
            self._connection.close()
        finally:
            with self._lock:
                feeds: list[Feed] = [*self._feeds.values(), *([self._all] if self._all else [])]
            for feed in feeds:
                feed._close()

    def __enter__(self) -> "PoseClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _follow(self, feed: Feed, robot: str) -> None:
        def receive(sample: "zenoh.Sample") -> None:
            key = str(sample.key_expr)
            _, camera, _, named, _ = key.removeprefix(self._prefix).split("/")
            feed._take(sample.payload.to_bytes(), key, named, self._servers[camera])

        self._connection.subscribe(self._prefix + keys.odometry(self._camera, robot), receive)

    def _follow_events(self) -> None:
        """From the first feed on; called under the lock."""
        if self._events is not None:
            return
        reader = self._events = EventReader(self._servers, self._hand_on)

        def receive(sample: "zenoh.Sample") -> None:
            reader.read(sample.payload.to_bytes(), str(sample.key_expr).split("/")[-2])

        self._connection.subscribe(self._prefix + keys.event(self._camera), receive)

    def _hand_on(self, event: RobotEvent) -> None:
        """To the robot's feed, or all where it is of all robots; and to the feed of all."""
        with self._lock:
            feeds: list[Feed] = [feed for robot, feed in self._feeds.items() if event.robot in ("", robot)]
            feeds += [self._all] if self._all else []
        for feed in feeds:
            feed._events.take(event)
