"""The wire of rmw_zenoh: keys of topics, tokens by which nodes see each other, what is attached to every message.

By its design.md and source (rmw_zenoh_cpp of Jazzy 0.2.4 and later, Kilted, Rolling); versions before have another
attachment.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from asterism.protocol.ros2 import names
from asterism.protocol.ros2.types import RosType

_LIVELINESS = "@ros2_lv"
_ATTACHMENT = struct.Struct("<qqB16s")  # sequence, time, length of the gid, gid
_DEFAULT_DEPTH = 42  # of rmw_zenoh's queues; a token leaves out what is default


class End(StrEnum):
    """Which end of a topic a token tells of."""

    PUBLISHER = "MP"
    SUBSCRIBER = "MS"


class Quality(NamedTuple):
    """Quality of service, keep-last: how many messages are kept, whether for those that join later, whether reliable.

    rmw_zenoh looks at none of it where it joins publishers and subscribers.
    """

    depth: int = 10
    transient_local: bool = False
    best_effort: bool = False

    @property
    def told(self) -> str:
        """As tokens tell it: reliability, durability, history, deadline, lifespan, liveliness."""
        depth = "" if self.depth == _DEFAULT_DEPTH else str(self.depth)
        return f"{2 if self.best_effort else ''}:{1 if self.transient_local else ''}:,{depth}:,:,:,,"


@dataclass(frozen=True, slots=True)
class NodeName:
    """A node: its domain, its namespace as `names.clean_namespace` gives it, its name, the id of its zenoh session."""

    domain: int
    namespace: str
    name: str
    zid: str

    @property
    def token(self) -> str:
        """What `ros2 node list` sees."""
        return f"{_LIVELINESS}/{self.domain}/{self.zid}/0/0/NN/%/{_mangled(self.namespace)}/{self.name}"

    def token_of(self, end: End, number: int, topic: str, kind: RosType, quality: Quality) -> str:
        """What `ros2 topic list` sees; ``number`` is another for every end of the node."""
        node = f"{_LIVELINESS}/{self.domain}/{self.zid}/0/{number}/{end}/%/{_mangled(self.namespace)}/{self.name}"
        return f"{node}/{_mangled(topic)}/{kind.dds}/{kind.hash}/{quality.told}"


def topic_key(domain: int, topic: str, kind: RosType) -> str:
    """The key of a topic's messages."""
    return f"{domain}/{topic.strip('/')}/{kind.dds}/{kind.hash}"


def topic_of_any_hash(domain: int, topic: str, kind: RosType) -> str:
    """The key expression of a topic's messages, whatever hash its publisher tells: Humble's tell none."""
    return f"{domain}/{topic.strip('/')}/{kind.dds}/*"


def attachment(sequence: int, time_ns: int, gid: bytes) -> bytes:
    """The 33 bytes beside a message: how many its publisher sent, when, ns since the Unix epoch, and its id (16)."""
    return _ATTACHMENT.pack(sequence, time_ns, len(gid), gid)


def owned_keys(place: names.RosPlace, robots: Iterable[str]) -> list[str]:
    """Key expressions of what only the server of these robots may say: their poses, and who publishes them.

    What is asked of a late joiner's caches stands behind `@adv`, which no wildcard of zenoh's takes in.
    """
    topics = [topic(place.namespace, robot) for robot in robots for topic in (names.pose_topic, names.odom_topic)]
    owned = []
    for topic in topics:
        key = f"{place.domain}/{topic.strip('/')}"
        token = f"{_LIVELINESS}/{place.domain}/*/*/*/MP/*/*/*/{_mangled(topic)}/**"
        owned += [f"{key}/**", f"{key}/**/@adv/**", token]
    return owned


def _mangled(name: str) -> str:
    """As one part of a key; empty is the root."""
    return name.replace("/", "%") or "%"
