"""Messages and presence to zenoh, in process. Publishing drops rather than waits: it never holds up the chain."""

from collections.abc import Iterable

import zenoh

from asterism.protocol import keys
from asterism.protocol.messages import RIG_REPORT, Message


class Publisher:
    """Publishes messages, answers for the rig, shows who is alive. A context manager.

    ``prefix`` goes before every key (replay uses it, so that no robot drives by yesterday's poses); ``rig_payload``
    is the encoded rig report.
    """

    def __init__(self, session: zenoh.Session, camera: str, rig_payload: bytes, prefix: str = "") -> None:
        self._session = session
        self._camera = camera
        self._prefix = prefix
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._visible: dict[str, zenoh.LivelinessToken] = {}

        def answer(query: zenoh.Query) -> None:
            query.reply(query.key_expr, rig_payload, encoding=zenoh.Encoding(RIG_REPORT.encoding))

        self._queryable = session.declare_queryable(prefix + keys.rig(camera), answer)
        self._alive = session.liveliness().declare_token(prefix + keys.alive(camera))

    def publish(self, messages: Iterable[Message]) -> None:
        """Put every message that belongs on the network."""
        for message in messages:
            if not message.kind.on_wire:
                continue
            publisher = self._publishers.get(message.key)
            if publisher is None:
                publisher = self._session.declare_publisher(
                    self._prefix + message.key,
                    encoding=zenoh.Encoding(message.kind.encoding),
                    # Not express: a router's queue holds two batches, and drops what each message sent alone fills.
                    congestion_control=zenoh.CongestionControl.DROP,
                )
                self._publishers[message.key] = publisher
            publisher.put(message.payload)

    def show_visible(self, robots: Iterable[str]) -> None:
        """Hold a liveliness token for exactly these robots."""
        wanted = set(robots)
        for robot in self._visible.keys() - wanted:
            self._visible.pop(robot).undeclare()
        for robot in wanted - self._visible.keys():
            key = self._prefix + keys.visible(self._camera, robot)
            self._visible[robot] = self._session.liveliness().declare_token(key)

    def close(self) -> None:
        """Take everything back and close the session."""
        self.show_visible(())
        self._alive.undeclare()
        self._queryable.undeclare()
        for publisher in self._publishers.values():
            publisher.undeclare()
        self._session.close()

    def __enter__(self) -> "Publisher":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def is_alive(session: zenoh.Session, camera: str, timeout_s: float = 1.0) -> bool:
    """Whether a server of that camera shows itself on the network."""
    replies = session.liveliness().get(keys.alive(camera), timeout=timeout_s)
    return any(reply.ok is not None for reply in replies)
