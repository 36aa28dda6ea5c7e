"""Images in messages of other programs, to the pixels that the chain's grey images are made of.

What a message says of itself is looked at before anything is made of it. Encodings by the names that ROS'
sensor_msgs/image_encodings.hpp and Foxglove's schemas give them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from asterism.protocol.yaml_file import shortened
from asterism.server.sources.foreign.ros_messages import (
    BadMessage,
    CompressedTold,
    RawTold,
    read_compressed,
    read_image,
)
from asterism.server.sources.image_headers import MOST_PIXELS
from asterism.server.sources.images import CheckSize, UnreadableImage, pages_of


class BadEncoding(BadMessage):
    """Pixels of a kind that is not read; every image of the same camera has it."""


class _Pixels(NamedTuple):
    """Bytes of a channel's value, channels, and OpenCV's code to grey where they are not grey."""

    size: int
    channels: int = 1
    code: int | None = None


def _table() -> dict[str, _Pixels]:
    found = {"mono8": _Pixels(1), "8UC1": _Pixels(1), "mono16": _Pixels(2), "16UC1": _Pixels(2)}
    for bits, size in ((8, 1), (16, 2)):
        found[f"rgb{bits}"] = _Pixels(size, 3, cv2.COLOR_RGB2GRAY)
        found[f"bgr{bits}"] = found[f"{bits}UC3"] = _Pixels(size, 3, cv2.COLOR_BGR2GRAY)
        found[f"rgba{bits}"] = _Pixels(size, 4, cv2.COLOR_RGBA2GRAY)
        found[f"bgra{bits}"] = found[f"{bits}UC4"] = _Pixels(size, 4, cv2.COLOR_BGRA2GRAY)
        for colours in ("rggb", "bggr", "gbrg", "grbg"):
            code = getattr(cv2, f"COLOR_Bayer{colours.upper()}2GRAY")
            found[f"bayer_{colours}{bits}"] = _Pixels(size, 1, code)
    for name in ("yuv422", "uyvy"):
        found[name] = _Pixels(1, 2, cv2.COLOR_YUV2GRAY_UYVY)
    for name in ("yuv422_yuy2", "yuyv"):
        found[name] = _Pixels(1, 2, cv2.COLOR_YUV2GRAY_YUY2)
    return found


ENCODINGS = _table()


class Picture(NamedTuple):
    """Pixels (h, w) or (h, w, 3 or 4, BGR), 8 or 16 bit, and what the message tells of their time; 0: nothing."""

    image: NDArray[Any]
    stamp_ns: int


def picture(told: RawTold | CompressedTold, check_size: CheckSize) -> Picture:
    """The pixels of a message; ``check_size`` is asked for width and height before they are decoded.

    Raises BadMessage for a message that holds no whole image, BadEncoding for a kind of pixels that is not read.
    """
    if isinstance(told, RawTold):
        return Picture(_raw(told, check_size), told.stamp_ns)
    data = bytes(told.data)
    try:
        pages = [image for _, image in pages_of(data, "", check_size)]
    except UnreadableImage as problem:
        raise BadMessage(f"{problem} (its format is {shortened(told.format)!r})") from None
    if len(pages) != 1:
        raise BadMessage(f"holds {len(pages)} images, expected one")
    return Picture(pages[0], told.stamp_ns)


def _raw(told: RawTold, check_size: CheckSize) -> NDArray[Any]:
    pixels = ENCODINGS.get(told.encoding)
    if pixels is None:
        raise BadEncoding(f"encoding {shortened(told.encoding)!r}, expected one of {', '.join(ENCODINGS)}")
    width, height, step = told.width, told.height, told.step
    if width < 1 or height < 1 or width * height > MOST_PIXELS:
        raise BadMessage(f"claims to be {width}x{height}, no camera's image")
    row = width * pixels.channels * pixels.size
    if step < row or len(told.data) != step * height:
        raise BadMessage(
            f"{len(told.data)} bytes in rows of {step} bytes, expected {height} rows of at least {row} "
            f"({width}x{height}, {told.encoding})"
        )
    check_size(width, height)
    rows = np.frombuffer(told.data, np.uint8).reshape(height, step)[:, :row]
    values = np.ascontiguousarray(rows).view(f"{'>' if told.big_endian else '<'}u{pixels.size}")
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if pixels.code is None:
        return values
    image = values.reshape(height, width, pixels.channels) if pixels.channels > 1 else values
    try:
        return np.asarray(cv2.cvtColor(image, pixels.code))
    except cv2.error:
        raise BadMessage(f"{width}x{height} pixels do not go with {told.encoding}") from None


def raw_image(payload: bytes) -> RawTold:
    """A foxglove.RawImage. Raises BadMessage."""
    message = _parsed(RawImage(), payload)
    stamp_ns = message.timestamp.seconds * 10**9 + message.timestamp.nanos
    # Foxglove's 16-bit images are little-endian.
    return RawTold(stamp_ns, message.width, message.height, message.step, message.encoding, False, message.data)


def compressed_image(payload: bytes) -> CompressedTold:
    """A foxglove.CompressedImage. Raises BadMessage."""
    message = _parsed(CompressedImage(), payload)
    stamp_ns = message.timestamp.seconds * 10**9 + message.timestamp.nanos
    return CompressedTold(stamp_ns, message.format, message.data)


def _parsed(message: Any, payload: bytes) -> Any:
    try:
        message.ParseFromString(payload)
    except DecodeError:
        raise BadMessage(f"is no {message.DESCRIPTOR.full_name}") from None
    return message


Read = Callable[[bytes], RawTold | CompressedTold]

# By type and encoding of the message.
IMAGE_TYPES: dict[tuple[str, str], Read] = {
    ("foxglove.RawImage", "protobuf"): raw_image,
    ("foxglove.CompressedImage", "protobuf"): compressed_image,
    ("sensor_msgs/msg/Image", "cdr"): read_image,
    ("sensor_msgs/msg/CompressedImage", "cdr"): read_compressed,
    ("sensor_msgs/msg/Image", "ros1"): lambda payload: read_image(payload, ros1=True),
    ("sensor_msgs/msg/CompressedImage", "ros1"): lambda payload: read_compressed(payload, ros1=True),
}
IMAGE_NAMES = "foxglove.RawImage, foxglove.CompressedImage, sensor_msgs/Image, sensor_msgs/CompressedImage"
