"""What a client hears of `asterism fuse`, by plain zenoh; waited for, never slept for."""

import queue
import time
from collections.abc import Callable
from typing import TypeVar

import zenoh

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_event, decode_frame_report, decode_rig, decode_status
from asterism.protocol.network import client_config

TIMEOUT_S = 30.0
T = TypeVar("T")


class Listener:
    """Joins the endpoint as soon as somebody listens there."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        config = client_config(endpoint)
        config.insert_json5("connect/timeout_ms", "30000")
        self.session = zenoh.open(config)
        self.frames: queue.SimpleQueue[pb.FrameReport] = queue.SimpleQueue()
        self.states: queue.SimpleQueue[pb.Status] = queue.SimpleQueue()
        self.events: queue.SimpleQueue[pb.Event] = queue.SimpleQueue()
        self._held = [
            self._hear(keys.frame(keys.FUSED), decode_frame_report, self.frames),
            self._hear(keys.status(keys.FUSED), decode_status, self.states),
            self._hear(keys.event(keys.FUSED), decode_event, self.events),
        ]

    def _hear(self, key: str, decode: Callable[[bytes], T], to: "queue.SimpleQueue[T]") -> object:
        return self.session.declare_subscriber(key, lambda sample: to.put(decode(sample.payload.to_bytes())))

    def status(self, holds: Callable[["pb.Status"], bool]) -> "pb.Status":
        """The first status that does."""
        return until(lambda: self.states.get(timeout=TIMEOUT_S), holds)

    def event(self, holds: Callable[["pb.Event"], bool]) -> "pb.Event":
        """The first event that does."""
        return until(lambda: self.events.get(timeout=TIMEOUT_S), holds)

    def rig(self) -> "pb.RigReport":
        """What is answered."""
        (reply,) = self.session.get(keys.rig(keys.FUSED), timeout=TIMEOUT_S)
        assert reply.ok is not None
        return decode_rig(reply.ok.payload.to_bytes())

    def close(self) -> None:
        self.session.close()


def until(take: Callable[[], T], holds: Callable[[T], bool]) -> T:
    """What is taken again and again until it holds."""
    end = time.monotonic() + TIMEOUT_S
    while not holds(taken := take()):
        assert time.monotonic() < end, "it did not come about"
    return taken
