"""A node of ROS 2 as far as DDS knows of nodes: publishers in a domain, on topics named as ROS names them there."""

import ctypes
import logging

from cyclonedds.core import Policy, Qos
from cyclonedds.internal import DDS
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Sample, Topic

from asterism.protocol.ros2.cdr import encode
from asterism.protocol.ros2.types import RosType
from asterism.protocol.ros2.values import RosMessage
from asterism.protocol.ros2.wire import Quality
from asterism.server.service.dds.idl import TYPES
from asterism.server.service.dds.participant import Participant

_LOG = logging.getLogger(__name__)
# The way by `DataWriter.write` takes 250 us to make CDR of Python objects, and holds Python's lock while it sends.
_WRITE = DDS._dll_handle["dds_write"]
_WRITE.argtypes, _WRITE.restype = [ctypes.c_int, ctypes.c_void_p], ctypes.c_int


def _write(writer: DataWriter, coded: bytes) -> bool:
    """Write CDR, with the four bytes before it; returns whether it was taken."""
    padded = ctypes.c_char_p(coded + bytes(-len(coded) % 4))
    sample = Sample(ctypes.cast(padded, ctypes.c_void_p), len(coded) + -len(coded) % 4)
    taken: bool = _WRITE(writer._ref, ctypes.byref(sample)) >= 0
    return taken


class DdsPublisher:
    """Publishes the messages of one topic. One thread at a time may put."""

    def __init__(self, participant: Participant, topic: str, kind: RosType, quality: Quality) -> None:
        self._topic = topic
        self._unsent = 0
        qos = _qos(quality)
        self._writer = DataWriter(participant.dds, Topic(participant.dds, f"rt{topic}", TYPES[kind], qos=qos), qos=qos)

    def put(self, message: RosMessage) -> None:
        """Publish a message; it is dropped rather than waited for."""
        if not _write(self._writer, encode(message)):
            if not self._unsent:
                _LOG.warning("DDS: %s: who reads it does not keep up, messages are dropped", self._topic)
            self._unsent += 1

    def close(self) -> None:
        """Take the topic back."""
        if self._unsent:
            _LOG.warning("DDS: %s: %d messages were dropped", self._topic, self._unsent)
        del self._writer


class DdsNode:
    """Publishers of one participant; ``where`` says who hears them.

    DDS has no nodes: `ros2 node list` shows those of ROS's own library alone.
    """

    def __init__(self, domain: int) -> None:
        self._participant = Participant(domain)
        self.where = self._participant.where

    def publisher(self, topic: str, kind: RosType, quality: Quality, newest_only: bool = False) -> DdsPublisher:  # noqa: ARG002
        """Publish on a topic."""
        return DdsPublisher(self._participant, topic, kind, quality)

    def close(self) -> None:
        """Leave the domain."""
        self._participant.close()


def _qos(quality: Quality) -> Qos:
    """As ROS's publishers have it; but a write never waits for who reads: what is not taken in time is replaced."""
    reliability = Policy.Reliability.BestEffort if quality.best_effort else Policy.Reliability.Reliable(0)
    durability = Policy.Durability.TransientLocal if quality.transient_local else Policy.Durability.Volatile
    return Qos(reliability, durability, Policy.History.KeepLast(quality.depth))
