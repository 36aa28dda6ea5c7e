"""How large an image file is, how many pages it holds and whether it is whole, from its headers: before it is decoded.

A small file may claim to be a huge image; decoders make room first and look then. Formats: PNG (ISO 15948), JPEG (ITU
T.81, markers), TIFF 6.0 and BigTIFF (directories), BMP (its info header).
"""

import struct
from pathlib import Path

MOST_PAGES = 100_000
MOST_PIXELS = 1 << 28  # larger than any camera's
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_SEQUENTIAL, _SCAN, _END = (0xC0, 0xC1), 0xDA, 0xD9  # JPEG's markers; sequential with Huffman's codes
_TIFFS = {b"II*\0": "<", b"MM\0*": ">", b"II+\0": "<", b"MM\0+": ">"}
_BIG = b"+"
_WIDTH, _HEIGHT = 256, 257  # tags of a TIFF directory
_VALUE_SIZES = {3: "H", 4: "I", 16: "Q"}  # types of whole numbers in it


class NoImage(Exception):
    """Bytes that are no whole image; the text says what is wrong with them."""


def page_sizes(data: bytes) -> list[tuple[int, int]]:
    """Width and height, px, of every page of a PNG, JPEG, TIFF or BMP file. Raises NoImage."""
    try:
        sizes = _sizes(data)
    except (struct.error, IndexError):
        raise NoImage("is cut off") from None
    for width, height in sizes:
        if width <= 0 or height <= 0:
            raise NoImage("is no whole image")
        if width * height > MOST_PIXELS:
            raise NoImage(f"claims to be {width}x{height}, larger than any camera's image")
    return sizes


def _sizes(data: bytes) -> list[tuple[int, int]]:
    if data.startswith(_PNG):
        return [_png(data)]
    if data.startswith(_JPEG):
        return [_jpeg(data)[0]]
    if data[:4] in _TIFFS:
        return _tiff(data)
    if data.startswith(b"BM"):
        width, height = struct.unpack_from("<ii", data, 18)
        return [(width, abs(height))]
    raise NoImage("is no PNG, TIFF, JPEG or BMP image")


def is_tiff(path: Path) -> bool:
    """Whether a file is one, whatever it is called: only these hold several images. One that cannot be read is not."""
    try:
        with path.open("rb") as file:
            return file.read(4) in _TIFFS
    except OSError:
        return False


def _png(data: bytes) -> tuple[int, int]:
    """Chunk by chunk up to the last; what stands behind that is none of the image's."""
    at = len(_PNG)
    size = struct.unpack_from(">II", data, at + 8)
    while True:
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if at > len(data):
            raise NoImage("is cut off")
        if kind == b"IEND":
            return int(size[0]), int(size[1])


def coded_in_one_go(data: bytes) -> bytes | None:
    """A JPEG file up to its end marker, where all of the image is in one sequential scan; else None. Raises NoImage."""
    if not data.startswith(_JPEG):
        return None
    _, end, scans, sequential = _jpeg(data)
    return data[:end] if sequential and scans == 1 else None


def _jpeg(data: bytes) -> tuple[tuple[int, int], int, int, bool]:
    """Marker by marker up to the end of the image; in coded data a 0xff is followed by 0 or a restart.

    Returns its size, where the end marker stands, how many scans there are, and whether they are sequential.
    """
    size, at, scans, sequential = None, 2, 0, False
    while True:
        at = data.find(b"\xff", at)
        if at < 0 or at + 1 >= len(data):
            raise NoImage("is cut off")
        kind = data[at + 1]
        if kind == _END:
            if size is None:
                raise NoImage("is no whole image")
            return size, at, scans, sequential
        if kind in (0x00, 0x01, 0xFF) or 0xD0 <= kind <= 0xD8:
            at += 1 if kind == 0xFF else 2
            continue
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            size, sequential = (width, height), kind in _SEQUENTIAL
        scans += kind == _SCAN
        at += 2 + struct.unpack_from(">H", data, at + 2)[0]


def _tiff(data: bytes) -> list[tuple[int, int]]:
    """Directory by directory: each is a page."""
    order, big = _TIFFS[data[:4]], _BIG in data[:4]
    offset, count, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    at = struct.unpack_from(order + offset, data, 8 if big else 4)[0]
    sizes: list[tuple[int, int]] = []
    seen: set[int] = set()
    while at:
        if at in seen or len(sizes) >= MOST_PAGES:
            raise NoImage("has directories that go round in a circle")
        seen.add(at)
        entries = struct.unpack_from(order + count, data, at)[0]
        first = at + struct.calcsize(order + count)
        sizes.append(_tiff_size(data, order, range(first, first + entries * entry, entry), big))
        at = struct.unpack_from(order + offset, data, first + entries * entry)[0]
    if not sizes:
        raise NoImage("holds no image")
    return sizes


def _tiff_size(data: bytes, order: str, entries: range, big: bool) -> tuple[int, int]:
    found = {}
    for at in entries:
        tag, kind = struct.unpack_from(order + "HH", data, at)
        if tag in (_WIDTH, _HEIGHT) and kind in _VALUE_SIZES:
            found[tag] = struct.unpack_from(order + _VALUE_SIZES[kind], data, at + (12 if big else 8))[0]
        if len(found) == 2:
            break
    return found.get(_WIDTH, 0), found.get(_HEIGHT, 0)
