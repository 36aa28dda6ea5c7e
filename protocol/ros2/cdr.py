"""Messages of ROS 2 as bytes: CDR (OMG DDSI-RTPS 2.3, 10.5; plain CDR), little endian.

Every number stands where its own size divides the place, counted behind the four bytes that tell the order of bytes.
"""

import struct
from functools import singledispatch

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.ros2.values import (
    DiagnosticArray,
    Header,
    Odometry,
    PoseWithCovarianceStamped,
    TFMessage,
)

_HEAD = b"\x00\x01\x00\x00"  # plain CDR, little endian
_POSE = struct.Struct("<7d")
_COVARIANCE = struct.Struct("<36d")
_TWIST = struct.Struct("<42d")
_NUMBER = struct.Struct("<I")
_STAMP = struct.Struct("<iI")
_LAST_STAMP = 2**31 * 10**9  # seconds are 32 bits, with a sign


class _Writer:
    """Appends fields, each at its place."""

    def __init__(self) -> None:
        self.out = bytearray(_HEAD)

    def align(self, size: int) -> None:
        """Go on where ``size`` divides the place; the head is four bytes that do not count."""
        self.out += bytes((len(_HEAD) - len(self.out)) % size)

    def number(self, value: int) -> None:
        """uint32: also how many elements a sequence has."""
        self.align(4)
        self.out += _NUMBER.pack(value)

    def text(self, value: str) -> None:
        """A string, which ends with a zero."""
        coded = value.encode(errors="replace") + b"\0"
        self.number(len(coded))
        self.out += coded

    def header(self, header: Header) -> None:
        """std_msgs/Header."""
        if not 0 <= header.stamp_ns < _LAST_STAMP:
            raise InputError(f"a time of {header.stamp_ns} ns, expected one from 1970 to 2038: ROS knows no others")
        self.align(4)
        self.out += _STAMP.pack(*divmod(header.stamp_ns, 10**9))
        self.text(header.frame_id)

    def pose(self, pose: Pose) -> None:
        """geometry_msgs/Pose, and Transform, which has the same fields."""
        self.align(8)
        self.out += _POSE.pack(*pose.position.tolist(), *pose.orientation.tolist())


@singledispatch
def encode(message: object) -> bytes:
    """The bytes of a message, as rmw_zenoh and bags carry them. Raises InputError for a time that ROS has none for."""
    raise TypeError(f"{type(message).__name__} is no message")


@encode.register
def _(message: PoseWithCovarianceStamped) -> bytes:
    writer = _Writer()
    writer.header(message.header)
    writer.pose(message.pose)
    writer.out += _COVARIANCE.pack(*message.covariance)
    return bytes(writer.out)


@encode.register
def _(message: Odometry) -> bytes:
    writer = _Writer()
    writer.header(message.header)
    writer.text(message.child_frame_id)
    writer.pose(message.pose)
    writer.out += _COVARIANCE.pack(*message.covariance)
    writer.out += _TWIST.pack(*message.linear, *message.angular, *message.twist_covariance)
    return bytes(writer.out)


@encode.register
def _(message: TFMessage) -> bytes:
    writer = _Writer()
    writer.number(len(message.transforms))
    for transform in message.transforms:
        writer.header(transform.header)
        writer.text(transform.child_frame_id)
        writer.pose(transform.pose)
    return bytes(writer.out)


@encode.register
def _(message: DiagnosticArray) -> bytes:
    writer = _Writer()
    writer.header(message.header)
    writer.number(len(message.status))
    for status in message.status:
        writer.out.append(status.level)
        for text in (status.name, status.message, status.hardware_id):
            writer.text(text)
        writer.number(len(status.values))
        for key, value in status.values:
            writer.text(key)
            writer.text(value)
    return bytes(writer.out)
