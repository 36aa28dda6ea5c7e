"""NatNet 3.1: what a server of rigid bodies tells, little endian.

Source: the layout that OptiTrack's SDK shows in its sample `PythonClient`, and the reader of PyPI `natnet` 0.3.0.
"""

import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Robot

VERSION = (3, 1, 0, 0)  # of the protocol
TICKS_HZ = 10**9  # of the clock that stamps frames: ns since the Unix epoch
LONGEST = 65_000  # bytes of a message

_NAME = 256  # bytes of the server's name
_HEAD = struct.Struct("<HH")
_NUMBER = struct.Struct("<i")
_BODY = struct.Struct("<i7ffH")
_END = struct.Struct("<IIdQQQHI")  # time code and its part, seconds, three stamps, what changed, the end
_NONE = _NUMBER.pack(0)
_RIGID_BODY = 1  # kind of a description
_NO_PARENT = -1
_NOWHERE = (float("nan"),) * 7


class Id(IntEnum):
    """What a message is."""

    CONNECT = 0
    SERVER_INFO = 1
    REQUEST = 2
    REQUEST_DESCRIPTIONS = 4
    DESCRIPTIONS = 5
    FRAME = 7
    DISCONNECT = 9
    KEEP_ALIVE = 10
    UNRECOGNIZED = 100


class Body(NamedTuple):
    """A rigid body in one frame. ``error_m`` is the mean of its markers; without a pose it was not seen."""

    number: int
    pose: Pose | None
    error_m: float


class Times(NamedTuple):
    """Of a frame, ns since the Unix epoch: mid-exposure, in memory, sent."""

    exposed_ns: int
    arrived_ns: int
    published_ns: int


def message(kind: Id, payload: bytes = b"") -> bytes:
    """A message with its head."""
    return _HEAD.pack(kind, len(payload)) + payload


def kind_of(datagram: bytes) -> int | None:
    """What a message that came is, or None for bytes that are none."""
    if len(datagram) < _HEAD.size:
        return None
    kind, length = _HEAD.unpack_from(datagram)
    return int(kind) if length <= len(datagram) - _HEAD.size else None


def server_info(name: str, version: Sequence[int], port: int) -> bytes:
    """Who serves, and how: data go to each client by itself, from ``port``."""
    told = name.encode()[: _NAME - 1].ljust(_NAME, b"\0") + bytes(version[:4]).ljust(4, b"\0") + bytes(VERSION)
    return message(Id.SERVER_INFO, told + struct.pack("<QHB4s", TICKS_HZ, port, 0, bytes(4)))


def descriptions(robots: Sequence[Robot]) -> bytes:
    """The rigid bodies there are: numbers from 1 in the rig's order, names, LEDs as their markers."""
    told = bytearray(_NUMBER.pack(len(robots)))
    for number, robot in enumerate(robots, start=1):
        told += _NUMBER.pack(_RIGID_BODY) + robot.id.encode() + b"\0"
        told += struct.pack("<ii3f", number, _NO_PARENT, 0.0, 0.0, 0.0)
        told += _NUMBER.pack(len(robot.leds))
        told += robot.leds.astype("<f4").tobytes()
        told += struct.pack(f"<{len(robot.leds)}i", *([0] * len(robot.leds)))  # no labels of active markers
    return message(Id.DESCRIPTIONS, bytes(told))


def frame(number: int, bodies: Sequence[Body], times: Times, changed: bool) -> bytes:
    """One frame. A body that was not seen is there, not valid and nowhere: who counts bodies, or looks at no flag, is
    not led astray. ``changed``: there are other bodies than in the frame before.
    """
    told = bytearray(_NUMBER.pack(number & 0x7FFF_FFFF) + _NONE + _NONE)  # no sets of markers, none without a body
    told += _NUMBER.pack(len(bodies))
    for body in bodies:
        seen = body.pose is not None
        place = (*body.pose.position, *body.pose.orientation) if body.pose is not None else _NOWHERE
        told += _BODY.pack(body.number, *place, body.error_m, seen)
    told += 4 * _NONE  # no skeletons, labelled markers, force plates, devices
    told += _END.pack(0, 0, times.exposed_ns * 1e-9, *times, 2 * changed, 0)
    return message(Id.FRAME, bytes(told))
