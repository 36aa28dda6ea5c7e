"""Buffers of V4L2's pixel formats to grey images.

Layouts: the kernel's documentation of V4L2, "Image Formats".
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.server.sources.image_headers import NoImage, page_sizes
from asterism.server.sources.images import open_ended, to_grey8


class Pixels(NamedTuple):
    """How grey lies in a buffer: every ``step`` bytes a value of ``bits``, from byte ``first``; no step: JPEG."""

    bits: int = 8
    step: int = 1
    first: int = 0


# Best first: what is not compressed before what is; more than 8 bits take more of the cable and are reduced to 8.
FORMATS = {
    "GREY": Pixels(),
    "Y16": Pixels(16, 2),
    "Y14": Pixels(14, 2),
    "Y12": Pixels(12, 2),
    "Y10": Pixels(10, 2),
    "YUYV": Pixels(8, 2),
    "UYVY": Pixels(8, 2, 1),
    "NV12": Pixels(),  # the plane of grey comes first
    "MJPG": Pixels(step=0),
}


class Damaged(Exception):
    """A buffer that holds no whole image; the text says what is wrong with it."""


class Layout(NamedTuple):
    """An image in a buffer."""

    fourcc: str
    width: int  # px
    height: int
    stride: int  # bytes from row to row
    bits: int | None  # of 16, where the rig says so


def to_grey(data: memoryview, layout: Layout, name: str) -> NDArray[np.uint8]:
    """The image (height, width) in a buffer's used bytes, as a copy. Raises Damaged."""
    pixels = FORMATS[layout.fourcc]
    if not pixels.step:
        return _jpeg(bytes(data), layout)
    width, height = layout.width, layout.height
    stride = max(layout.stride, width * pixels.step)
    used = stride * (height - 1) + width * pixels.step  # the last row may lack its padding
    if len(data) < used:
        raise Damaged(f"is cut off after {len(data)} of {used} bytes")
    rows = np.lib.stride_tricks.as_strided(
        np.frombuffer(data, np.uint8), (height, width, pixels.step), (stride, pixels.step, 1), writeable=False
    )
    if pixels.bits > 8:
        return to_grey8(rows.view("<u2")[:, :, 0], layout.bits or pixels.bits, name)
    return np.array(rows[:, :, 0]) if pixels.step == 1 else np.asarray(cv2.extractChannel(rows, pixels.first), np.uint8)


def _jpeg(data: bytes, layout: Layout) -> NDArray[np.uint8]:
    if not data.startswith(b"\xff\xd8"):
        raise Damaged("is no JPEG image")
    try:
        size = page_sizes(data)[0]
        if size != (layout.width, layout.height):
            raise Damaged(f"is {size[0]}x{size[1]}, expected {layout.width}x{layout.height}")
        image = cv2.imdecode(np.frombuffer(open_ended(data), np.uint8), cv2.IMREAD_GRAYSCALE)
    except (NoImage, cv2.error) as problem:
        raise Damaged(str(problem) if isinstance(problem, NoImage) else "is no whole image") from None
    if image is None:
        raise Damaged("is no whole image")
    return np.asarray(image, np.uint8)
