"""Image files and raw camera images to the (h, w) uint8 grey images that the chain takes."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.text_file import read_bytes
from asterism.server.sources.image_headers import NoImage, coded_in_one_go, page_sizes

EXTENSIONS = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
LARGEST_FILE = 1 << 32  # bytes; a stack of frames
_AHEAD = 8  # bytes that a JPEG decoder's bits are taken from


class UnreadableImage(Exception):
    """A file that is no whole image; the text says what is wrong with it."""


def natural_key(path: Path) -> list[tuple[int, int | str]]:
    """Sort key by which frame2 comes before frame10."""
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]


CheckSize = Callable[[int, int], None]


def read_pages(path: Path, check_size: CheckSize) -> Iterator[tuple[str, NDArray[Any]]]:
    """The images in a PNG, TIFF, JPEG or BMP file, (h, w) or (h, w, 3 or 4, BGR), 8 or 16 bit, with their names: a TIFF
    may hold many, and the third of stack.tiff is called stack.tiff#2.

    ``check_size`` is asked for width and height of every page before anything is decoded, and raises what it likes.
    Raises UnreadableImage for a file that is missing, cut off or no image; also for a JPEG file whose data ends before
    the image does, because some of it is lost or damaged (not where it is in several scans). Other damage shows in
    nothing: JPEG has no check sum.
    """
    try:
        data = read_bytes(path, "an image", LARGEST_FILE)
    except OSError as error:
        raise UnreadableImage(f"cannot be read ({error.strerror})") from None
    except InputError as error:
        raise UnreadableImage(str(error).removeprefix(f"{path}: ")) from None
    yield from pages_of(data, path.name, check_size)


def pages_of(data: bytes, file: str, check_size: CheckSize) -> Iterator[tuple[str, NDArray[Any]]]:
    """The images in the bytes of such a ``file``, likewise."""
    if not data:
        raise UnreadableImage("is empty")
    try:
        sizes = page_sizes(data)
    except NoImage as problem:
        raise UnreadableImage(str(problem)) from None
    for width, height in sizes:
        check_size(width, height)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    for page in range(len(sizes)):
        name = file if len(sizes) == 1 else f"{file}#{page}"
        image = _decoded(np.frombuffer(open_ended(data), np.uint8), page, len(sizes))
        width, height = sizes[page]
        if image.shape[:2] != (height, width):
            raise UnreadableImage(f"is {image.shape[1]}x{image.shape[0]}, but its header says {width}x{height}")
        yield name, image


def open_ended(data: bytes) -> bytes:
    """A JPEG file without its end marker: a decoder that finds it too early makes up the rest of the image in silence,
    and only says so where the file itself ends. The bytes behind are what it reads ahead.
    """
    coded = coded_in_one_go(data)
    return data if coded is None else coded + bytes(_AHEAD)


def _decoded(data: NDArray[np.uint8], page: int, pages: int) -> NDArray[Any]:
    try:
        if pages == 1:
            image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        else:
            _, found = cv2.imdecodemulti(data, cv2.IMREAD_UNCHANGED, None, (page, page + 1))
            image = found[0] if found else None
    except cv2.error:
        image = None
    if image is None:
        raise UnreadableImage("is no whole image" if pages == 1 else f"page {page} is no whole image")
    return np.asarray(image)


def to_grey8(image: NDArray[Any], bits: int | None, name: str) -> NDArray[np.uint8]:
    """Grey 8-bit image (h, w) of an image (h, w) or (h, w, 3 or 4, BGR), 8 or 16 bit.

    16-bit pixels hold ``bits`` significant bits (None: all 16), of which the upper eight are kept; what exceeds
    them saturates. Raises InputError for other pixel types; ``name`` is what the sentence calls the image.
    """
    other = image.dtype not in (np.uint8, np.uint16)
    if image.ndim == 3 and image.shape[2] in (3, 4) and not other:
        code = cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
        image = cv2.cvtColor(image, code)
    elif image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim != 2 or other:
        raise InputError(
            f"{name}: the image is {image.dtype} of shape {image.shape}, expected 8 or 16 bit, grey or colour"
        )
    if image.dtype == np.uint16:
        image = np.minimum(image >> ((bits or 16) - 8), 255).astype(np.uint8)
    return np.ascontiguousarray(image, np.uint8)
