"""Image files and raw camera images to the (h, w) uint8 grey images that the chain takes."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError

EXTENSIONS = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")


class UnreadableImage(Exception):
    """A file that is no whole image; the text says what is wrong with it."""


def natural_key(path: Path) -> list[tuple[int, int | str]]:
    """Sort key by which frame2 comes before frame10."""
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]


def read_image(path: Path, bits: int | None) -> NDArray[np.uint8]:
    """The image in a PNG, TIFF, JPEG or BMP file as (h, w) uint8; `bits` as in `to_grey8`.

    Raises UnreadableImage for a file that is missing, cut off or no image.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UnreadableImage(f"cannot be read ({error.strerror})") from None
    if not data:
        raise UnreadableImage("is empty")
    # Decoders fill what is missing with grey, or complain on the terminal: look for the end of the image first.
    if (data.startswith(b"\x89PNG") and b"IEND" not in data[-256:]) or (
        data.startswith(b"\xff\xd8") and b"\xff\xd9" not in data[-4096:]
    ):
        raise UnreadableImage("is cut off")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise UnreadableImage("is no whole image")
    return to_grey8(image, bits, str(path))


def to_grey8(image: NDArray[Any], bits: int | None, name: str) -> NDArray[np.uint8]:
    """Grey 8-bit image (h, w) of an image (h, w) or (h, w, 3 or 4, BGR), 8 or 16 bit.

    16-bit pixels hold ``bits`` significant bits (None: all 16), of which the upper eight are kept; what exceeds
    them saturates. Raises InputError for other pixel types; ``name`` is what the sentence calls the image.
    """
    if image.ndim == 3 and image.shape[2] in (3, 4):
        code = cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
        image = cv2.cvtColor(image, code)
    elif image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{name}: the image is {image.dtype} of shape {image.shape}, expected 8 or 16 bit, grey or colour"
        )
    if image.dtype == np.uint16:
        image = np.minimum(image >> ((bits or 16) - 8), 255).astype(np.uint8)
    return np.ascontiguousarray(image, np.uint8)
