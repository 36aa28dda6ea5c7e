"""Grey pixel formats of GenICam cameras (Pixel Format Naming Convention), unpacked."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


class Format(NamedTuple):
    """A pixel format: its name and number, bits of a pixel that are the sensor's, and of the wire."""

    name: str
    number: int
    bits: int
    wire_bits: int
    unpack: Callable[[Bytes], NDArray[np.generic]]  # (n,) bytes to (pixels,) uint8 or uint16


def _bytes(data: Bytes) -> Bytes:
    return data


def _words(data: Bytes) -> NDArray[np.uint16]:
    return data.view("<u2")


def _gige(low_bits: int) -> Callable[[Bytes], NDArray[np.uint16]]:
    """GigE Vision's own packing: two pixels in three bytes, their low bits in the one between."""

    def unpack(data: Bytes) -> NDArray[np.uint16]:
        three = data.reshape(-1, 3)
        out = np.empty((len(three), 2), np.uint16)
        between, mask = three[:, 1], (1 << low_bits) - 1
        for k, low in enumerate((between & mask, between >> 4 & mask)):
            np.bitwise_or(np.left_shift(three[:, 2 * k], low_bits, dtype=np.uint16), low, out=out[:, k])
        return out.reshape(-1)

    return unpack


def _twelve(data: Bytes) -> NDArray[np.uint16]:
    """Two pixels in three bytes, the lowest bit first."""
    three = data.reshape(-1, 3)
    out = np.empty((len(three), 2), np.uint16)
    middle = three[:, 1].astype(np.uint16)
    np.bitwise_or(three[:, 0], (middle & 15) << 8, out=out[:, 0])
    np.bitwise_or(middle >> 4, np.left_shift(three[:, 2], 4, dtype=np.uint16), out=out[:, 1])
    return out.reshape(-1)


def _ten(data: Bytes) -> NDArray[np.uint16]:
    """Four pixels in five bytes, the lowest bit first."""
    five = data.reshape(-1, 5)
    out = np.empty((len(five), 4), np.uint16)
    for k in range(4):
        low = np.right_shift(five[:, k], 2 * k, dtype=np.uint16)
        high = np.left_shift(five[:, k + 1], 8 - 2 * k, dtype=np.uint16)
        np.bitwise_and(low | high, 1023, out=out[:, k])
    return out.reshape(-1)


FORMATS = (
    Format("Mono8", 0x01080001, 8, 8, _bytes),
    Format("Mono10", 0x01100003, 10, 16, _words),
    Format("Mono10Packed", 0x010C0004, 10, 12, _gige(2)),
    Format("Mono10p", 0x010A0046, 10, 10, _ten),
    Format("Mono12", 0x01100005, 12, 16, _words),
    Format("Mono12Packed", 0x010C0006, 12, 12, _gige(4)),
    Format("Mono12p", 0x010C0047, 12, 12, _twelve),
    Format("Mono14", 0x01100025, 14, 16, _words),
    Format("Mono16", 0x01100007, 16, 16, _words),
)
BY_NAME = {one.name: one for one in FORMATS}
BY_NUMBER = {one.number: one for one in FORMATS}


def unpacked(data: Bytes, form: Format, width: int, height: int, padding: int = 0) -> NDArray[np.generic]:
    """The image (h, w) uint8 or uint16 of a frame's bytes; where nothing is packed a view of them.

    ``padding`` are bytes behind every row. Raises ValueError where there are too few.
    """
    if padding:  # then rows begin at whole bytes; else pixels run on
        used = -(-width * form.wire_bits // 8)
        rows = range(0, height * (used + padding), used + padding)
        return np.stack([_run(data[row : row + used], form, width) for row in rows])
    size = -(-width * height * form.wire_bits // 8)
    return _run(data[:size], form, width * height).reshape(height, width)


def _run(data: Bytes, form: Format, pixels: int) -> NDArray[np.generic]:
    """So many pixels in a row."""
    group = {10: 5, 12: 3, 16: 2, 8: 1}[form.wire_bits]
    if len(data) * 8 < pixels * form.wire_bits:
        raise ValueError(f"{len(data)} bytes are too few for {pixels} pixels of {form.name}")
    if left := -len(data) % group:
        data = np.concatenate([data, np.zeros(left, np.uint8)])
    return form.unpack(data)[:pixels]
