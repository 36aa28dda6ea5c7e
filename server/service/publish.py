"""Messages and presence to zenoh, in process. Publishing drops rather than waits: it never holds up the chain."""

import os
import platform
from collections.abc import Iterable
from typing import Protocol

import zenoh

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import stamped, to_bytes
from asterism.protocol.messages import BEAT, EVENT, ODOMETRY, RIG_REPORT, Message
from asterism.protocol.network import EVENT_PRIORITY, ODOMETRY_PRIORITY
from asterism.server.service.threads import Ticker

BEAT_EVERY_S = 0.2


class Clock(Protocol):
    """What stamps: `SessionClock`, or a replay's."""

    started_ns: int
    rate: float

    @property
    def session(self) -> int: ...

    def now_ns(self, session: int | None = None) -> int: ...

    def monotonic_ns(self) -> int: ...


class Publisher:
    """Publishes messages, answers for the rig, shows who is alive. A context manager.

    ``prefix`` goes before every key (replay uses it, so that no robot drives by yesterday's poses); ``rig_payload``
    is the encoded rig report, and may be changed; ``clock`` stamps what is published. Several threads may publish, each
    its own keys.
    """

    def __init__(self, session: zenoh.Session, camera: str, rig_payload: bytes, clock: Clock, prefix: str = "") -> None:
        self._session = session
        self.camera = camera
        self._prefix = prefix
        self.clock = clock
        self.rig_payload = rig_payload
        self.beats = 0
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._visible: dict[str, zenoh.LivelinessToken] = {}

        keys_rig = prefix + keys.rig(camera)

        def answer(query: zenoh.Query) -> None:
            payload = self.rig_payload + _who_answers(clock)
            query.reply(keys_rig, payload, encoding=zenoh.Encoding(RIG_REPORT.encoding))

        self._queryable = session.declare_queryable(keys_rig, answer)
        self._alive = session.liveliness().declare_token(prefix + keys.alive(camera))
        self._beating = Ticker(self._beat, BEAT_EVERY_S)

    @property
    def beat_key(self) -> str:
        """The key of the beat."""
        return self._prefix + keys.beat(self.camera)

    @property
    def age_key(self) -> tuple[int, int]:
        """Of two servers of one camera the one with the lesser was there first."""
        return self.clock.started_ns, self.clock.session

    def publish(self, messages: Iterable[Message], session: int | None = None) -> list[Message]:
        """Stamp every message, by the clock of that session (none: the one in force), and put it: returns them as they
        went out.
        """
        told = []
        for message in messages:
            out = stamped(message, self.clock.now_ns(session))
            self.put(out)
            told.append(out)
        return told

    def put(self, message: Message) -> None:
        """Put one message as it is, if it is one that goes over the network."""
        if not message.kind.on_wire:
            return
        publisher = self._publishers.get(message.key)
        if publisher is None:
            publisher = self._session.declare_publisher(
                self._prefix + message.key,
                encoding=zenoh.Encoding(message.kind.encoding),
                # Not express: a router's queue holds two batches, and drops what each message sent alone fills.
                congestion_control=zenoh.CongestionControl.DROP,
                priority=_priority(message),
            )
            self._publishers[message.key] = publisher
        publisher.put(message.payload)

    def _beat(self) -> None:
        """Tell that the server lives, and its clock."""
        clock, self.beats = self.clock, self.beats + 1
        session = clock.session
        now_ns, monotonic_ns = clock.now_ns(session), clock.monotonic_ns()
        told = pb.Beat(
            session=session,
            sequence=self.beats,
            time_ns=now_ns,
            monotonic_ns=monotonic_ns,
            rate=clock.rate,
            started_ns=clock.started_ns,
        )
        self.put(Message(keys.beat(self.camera), BEAT, to_bytes(told), now_ns, now_ns, self.beats))

    def show_visible(self, robots: Iterable[str]) -> None:
        """Hold a liveliness token for exactly these robots."""
        wanted = set(robots)
        for robot in self._visible.keys() - wanted:
            self._visible.pop(robot).undeclare()
        for robot in wanted - self._visible.keys():
            key = self._prefix + keys.visible(self.camera, robot)
            self._visible[robot] = self._session.liveliness().declare_token(key)

    def close(self) -> None:
        """Take everything back and close the session."""
        self._beating.close()
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


def _priority(message: Message) -> zenoh.Priority:
    """Odometry has a queue of its own, that is short: a late pose is worth nothing. Events have one that nothing else
    fills, so that none of them is dropped for a frame report.
    """
    names = {ODOMETRY.schema: ODOMETRY_PRIORITY, EVENT.schema: EVENT_PRIORITY}
    priority: zenoh.Priority = getattr(zenoh.Priority, names.get(message.kind.schema, "DATA"))
    return priority


def _who_answers(clock: Clock) -> bytes:
    """What a rig report's reply says beside the rig: who answers, and the time."""
    session = clock.session
    told = pb.RigReport(
        host=platform.node(),
        pid=os.getpid(),
        session=session,
        started_ns=clock.started_ns,
        time_ns=clock.now_ns(session),
        rate=clock.rate,
    )
    return to_bytes(told)
