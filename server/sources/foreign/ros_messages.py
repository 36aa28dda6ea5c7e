"""Messages of ROS as they lie in bags and MCAP files: images and camera_info, read within their bounds.

ROS 2 writes CDR (OMG DDSI-RTPS 2.3, 10.5; plain CDR): every number stands where its own size divides the place, counted
behind the four bytes that tell the order of bytes. ROS 1 writes the same fields without gaps, and a header with a
sequence number before the time.
"""

import struct
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats

LONGEST_TEXT = 1000  # of an encoding, a format, a model's name
MOST_COEFFICIENTS = 100
_ORDERS = {b"\0\0": ">", b"\0\1": "<"}


class BadMessage(Exception):
    """A payload that is not what its type says; the text says how that shows."""


class RawTold(NamedTuple):
    """An image as pixels. ``stamp_ns`` is 0 where none was given."""

    stamp_ns: int
    width: int
    height: int
    step: int  # bytes from row to row
    encoding: str
    big_endian: bool
    data: memoryview | bytes


class CompressedTold(NamedTuple):
    """An image as a PNG, JPEG, TIFF or BMP file."""

    stamp_ns: int
    format: str
    data: memoryview | bytes


class CameraInfoTold(NamedTuple):
    """A calibration, for the whole sensor; images are its region, binned."""

    name: str
    width: int
    height: int
    model: str
    distortion: Floats
    matrix: Floats  # (3, 3)
    binning: tuple[int, int] = (0, 0)  # 0 is 1
    region: tuple[int, int, int, int] = (0, 0, 0, 0)  # x, y, width, height, px of the whole sensor; no size: all of it


class _Fields:
    """The fields of a message, one after the other. Raises BadMessage."""

    def __init__(self, payload: bytes | memoryview, ros1: bool) -> None:
        self._data = memoryview(payload)
        self._at, self._ros1, self._order = 0, ros1, "<"
        if not ros1:
            head = bytes(self._take(4))
            if head[:2] not in _ORDERS:
                raise BadMessage("is no plain CDR, expected a message as ROS 2 writes it")
            self._order = _ORDERS[head[:2]]
            self._data, self._at = self._data[4:], 0

    def _take(self, length: int) -> memoryview:
        if length > len(self._data) - self._at:
            raise BadMessage("ends too early")
        self._at += length
        return self._data[self._at - length : self._at]

    def _align(self, size: int) -> None:
        if not self._ros1:
            self._take(-self._at % size)

    def number(self, kind: str) -> int:
        """A whole number, of a kind that `struct` knows."""
        size = struct.calcsize(kind)
        self._align(size)
        return int(struct.unpack(self._order + kind, self._take(size))[0])

    def bytes(self) -> memoryview:
        """A sequence of bytes."""
        return self._take(self.number("I"))

    def text(self) -> str:
        """A string; in CDR it ends with a zero."""
        told = self.bytes()
        if len(told) > LONGEST_TEXT:
            raise BadMessage(f"holds a text of {len(told)} bytes, where a name should be")
        try:
            return str(told, "utf-8").rstrip("\0")
        except UnicodeDecodeError:
            raise BadMessage("holds a text that is none") from None

    def doubles(self, count: int | None = None) -> Floats:
        """So many numbers; None: as many as are told first."""
        if count is None:
            count = self.number("I")
            if count > MOST_COEFFICIENTS:
                raise BadMessage(f"holds {count} numbers, where a lens has fewer than {MOST_COEFFICIENTS}")
            if count == 0:
                return np.zeros(0)
        self._align(8)
        return np.frombuffer(self._take(8 * count), self._order + "f8").astype(np.float64)

    def header(self) -> tuple[int, str]:
        """Time, ns, and frame_id."""
        if self._ros1:
            self.number("I")
        seconds = self.number("I" if self._ros1 else "i")
        return seconds * 10**9 + self.number("I"), self.text()


def read_image(payload: bytes | memoryview, ros1: bool = False) -> RawTold:
    """A sensor_msgs/Image. Raises BadMessage."""
    fields = _Fields(payload, ros1)
    stamp_ns, _ = fields.header()
    height, width, encoding = fields.number("I"), fields.number("I"), fields.text()
    big_endian, step = bool(fields.number("B")), fields.number("I")
    return RawTold(stamp_ns, width, height, step, encoding, big_endian, fields.bytes())


def read_compressed(payload: bytes | memoryview, ros1: bool = False) -> CompressedTold:
    """A sensor_msgs/CompressedImage. Raises BadMessage."""
    fields = _Fields(payload, ros1)
    stamp_ns, _ = fields.header()
    return CompressedTold(stamp_ns, fields.text(), fields.bytes())


def read_camera_info(payload: bytes | memoryview, ros1: bool = False) -> CameraInfoTold:
    """A sensor_msgs/CameraInfo. Raises BadMessage."""
    fields = _Fields(payload, ros1)
    fields.header()
    height, width, model = fields.number("I"), fields.number("I"), fields.text()
    distortion, matrix = fields.doubles(), fields.doubles(9).reshape(3, 3)
    fields.doubles(9 + 12)
    binning = (fields.number("I"), fields.number("I"))
    x, y, region_height, region_width = (fields.number("I") for _ in range(4))
    region = (x, y, region_width, region_height)
    return CameraInfoTold("", width, height, model, distortion, matrix, binning, region)
