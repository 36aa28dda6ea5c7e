"""A client of Foxglove's WebSocket protocol that knows nothing of Asterism: it decodes by the schemas it is told.

`python -m tests.foxglove_client PORT [SECONDS]` prints what a server offers, how much of it comes, and a message.

Source: github.com/foxglove/ws-protocol, docs/spec.md, under the subprotocol of today's SDK.
"""

import base64
import contextlib
import json
import struct
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple

from google.protobuf import text_format
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from websockets.sync.client import connect

SUBPROTOCOL = "foxglove.sdk.v1"
_DATA, _HEAD = 1, struct.Struct("<BIQ")  # opcode, subscription, log time


class Heard(NamedTuple):
    """One message."""

    topic: str
    log_ns: int
    payload: bytes


class FoxgloveClient:
    """Connected to a server, subscribed to every channel there is. A context manager."""

    def __init__(self, port: int) -> None:
        self.channels: dict[int, dict[str, Any]] = {}
        self._subscribed: set[int] = set()
        self._classes: dict[str, Any] = {}
        self._connection = connect(
            f"ws://127.0.0.1:{port}",
            subprotocols=[SUBPROTOCOL],
            max_size=None,
            compression=None,
            close_timeout=1.0,  # type: ignore[list-item]
        )

    @property
    def topics(self) -> dict[str, str]:
        """The schema of every topic that is offered now."""
        return {channel["topic"]: channel["schemaName"] for channel in self.channels.values()}

    def wait_for(self, true: Callable[[], bool], timeout_s: float = 30.0) -> list[Heard]:
        """Take what comes until something is true; what was heard by then."""
        heard, until = [], time.monotonic() + timeout_s
        while not true():
            if (one := self._take(until)) is not None:
                heard.append(one)
        return heard

    def until(self, topic: str, log_ns: int = 0, timeout_s: float = 30.0) -> list[Heard]:
        """What is heard until a message of that topic and time (0: any) comes, which is the last of them."""
        last: list[Heard] = []

        def came() -> bool:
            return bool(last) and last[-1].topic == topic and log_ns in (0, last[-1].log_ns)

        until = time.monotonic() + timeout_s
        while not came():
            if (one := self._take(until)) is not None:
                last.append(one)
        return last

    def decode(self, heard: Heard) -> Any:
        """The message, by the schema that its channel was advertised with."""
        if heard.topic not in self._classes:
            channel = next(c for c in self.channels.values() if c["topic"] == heard.topic)
            assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
            pool = DescriptorPool()
            for file in FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
                pool.Add(file)  # type: ignore[no-untyped-call]
            self._classes[heard.topic] = GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
        return self._classes[heard.topic].FromString(heard.payload)

    def __enter__(self) -> "FoxgloveClient":
        self._connection.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.__exit__(kind, error, trace)

    def _take(self, until: float) -> Heard | None:
        told = self._connection.recv(timeout=max(until - time.monotonic(), 0.0))
        if isinstance(told, bytes):
            opcode, subscription, log_ns = _HEAD.unpack_from(told)
            assert opcode == _DATA
            return Heard(self.channels[subscription]["topic"], log_ns, told[_HEAD.size :])
        message = json.loads(told)
        if message["op"] == "advertise":
            self.channels |= {channel["id"]: channel for channel in message["channels"]}
            new = [{"id": channel["id"], "channelId": channel["id"]} for channel in message["channels"]]
            self._connection.send(json.dumps({"op": "subscribe", "subscriptions": new}))
        elif message["op"] == "unadvertise":
            for number in message["channelIds"]:
                self.channels.pop(number)
        return None


def main(port: int, seconds: float = 3.0) -> None:
    """Listen to everything for a while."""
    with FoxgloveClient(port) as client:
        client.wait_for(lambda: bool(client.topics))
        heard: list[Heard] = []
        until = time.monotonic() + seconds
        with contextlib.suppress(TimeoutError):
            heard += client.wait_for(lambda: time.monotonic() > until, seconds + 30.0)
        print(f"{'topic':36} {'schema':26} {'1/s':>5} {'bytes':>6}")
        for topic, schema in sorted(client.topics.items()):
            sizes = [len(one.payload) for one in heard if one.topic == topic]
            print(f"{topic:36} {schema:26} {len(sizes) / seconds:5.0f} {sum(sizes) // max(len(sizes), 1):6}")
        odometry = next(client.decode(one) for one in reversed(heard) if client.topics[one.topic].endswith("Odometry"))
        print(f"{odometry.body_frame_id} in {odometry.frame_id} at {odometry.timestamp.ToJsonString()}:")
        for part in ("position", "orientation"):
            print(part, "{", text_format.MessageToString(getattr(odometry.pose, part), as_one_line=True), "}")
        print(text_format.MessageToString(odometry.metadata[0], as_one_line=True))


if __name__ == "__main__":
    main(int(sys.argv[1]), *map(float, sys.argv[2:]))
