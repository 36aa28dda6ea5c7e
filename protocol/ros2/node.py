"""A node of ROS 2 in a zenoh session: publishers and subscribers as rmw_zenoh has them, and tokens by which others see
them.
"""

import hashlib
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from asterism.protocol.network import ODOMETRY_PRIORITY
from asterism.protocol.ros2.cdr import encode
from asterism.protocol.ros2.names import RosPlace
from asterism.protocol.ros2.types import RosType
from asterism.protocol.ros2.values import RosMessage
from asterism.protocol.ros2.wire import End, NodeName, Quality, attachment, topic_key, topic_of_any_hash

if TYPE_CHECKING:
    import zenoh
    import zenoh.ext

_BEATS_S = 0.5  # of a publisher whose last messages are kept, after each: by them a node finds what it missed


class RosPublisher:
    """Publishes the messages of one topic. One thread at a time may put."""

    def __init__(
        self,
        publisher: "zenoh.Publisher | zenoh.ext.AdvancedPublisher",
        token: "zenoh.LivelinessToken",
        gid: bytes,
    ) -> None:
        self._publisher, self._token, self._gid = publisher, token, gid
        self._sent = 0

    def put(self, message: RosMessage) -> None:
        """Publish a message; it is dropped rather than waited for, as every message of the server."""
        self._sent += 1
        self._publisher.put(encode(message), attachment=attachment(self._sent, time.time_ns(), self._gid))

    def close(self) -> None:
        """Take the topic back."""
        self._token.undeclare()
        self._publisher.undeclare()  # type: ignore[no-untyped-call]


class RosSubscriber:
    """Takes the messages of one topic until it is closed."""

    def __init__(self, subscriber: "zenoh.Subscriber[None]", token: "zenoh.LivelinessToken | None") -> None:
        self._subscriber, self._token = subscriber, token

    def close(self) -> None:
        """Take no more."""
        if self._token is not None:
            self._token.undeclare()
        self._subscriber.undeclare()


class Node:
    """A node, seen by others until it is closed; so are its publishers and subscribers."""

    def __init__(self, session: "zenoh.Session", place: RosPlace, name: str) -> None:
        self._session = session
        self._name = NodeName(*place, name, str(session.info.zid()))
        self._ends = 0
        self._token = session.liveliness().declare_token(self._name.token)

    def publisher(self, topic: str, kind: RosType, quality: Quality, newest_only: bool = False) -> RosPublisher:
        """Publish on a topic. ``newest_only``: a late message is worth nothing, so its queue is short."""
        token = self._token_of(End.PUBLISHER, topic, kind, quality)
        key = topic_key(self._name.domain, topic, kind)
        # rmw_zenoh hashes the token by XXH3; that it is another for every publisher is all that others rely on.
        gid = hashlib.blake2b(token.encode(), digest_size=16).digest()
        publisher = self._kept(key, quality) if quality.transient_local else self._plain(key, newest_only)
        return RosPublisher(publisher, self._session.liveliness().declare_token(token), gid)

    def subscriber(
        self,
        topic: str,
        kind: RosType,
        quality: Quality,
        take: "Callable[[zenoh.Sample], None]",
        seen: bool = True,
    ) -> RosSubscriber:
        """Take what is published on a topic, whatever hash its publisher tells, in zenoh's thread. ``seen``: others see
        that somebody listens, for whom many cameras wait.
        """
        subscriber = self._session.declare_subscriber(topic_of_any_hash(self._name.domain, topic, kind), take)
        if not seen:
            return RosSubscriber(subscriber, None)
        token = self._token_of(End.SUBSCRIBER, topic, kind, quality)
        return RosSubscriber(subscriber, self._session.liveliness().declare_token(token))

    def close(self) -> None:
        """Be seen no longer."""
        self._token.undeclare()

    def _token_of(self, end: End, topic: str, kind: RosType, quality: Quality) -> str:
        self._ends += 1
        return self._name.token_of(end, self._ends, topic, kind, quality)

    def _plain(self, key: str, newest_only: bool) -> "zenoh.Publisher":
        import zenoh

        priority: zenoh.Priority = getattr(zenoh.Priority, ODOMETRY_PRIORITY if newest_only else "DATA")
        return self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP, priority=priority)

    def _kept(self, key: str, quality: Quality) -> "zenoh.ext.AdvancedPublisher":
        import zenoh
        import zenoh.ext

        return zenoh.ext.declare_advanced_publisher(
            self._session,
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            cache=zenoh.ext.CacheConfig(max_samples=quality.depth),
            sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_BEATS_S),
            publisher_detection=True,
        )
