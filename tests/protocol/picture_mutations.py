"""Image files with something wrong inside their chunks, segments and directories, where a check sum would hide it."""

import struct
import zlib

import numpy as np

from tests.protocol.mutations import mutated_bytes

_SIZES = (0, 1, 47, 48, 64, 65, 255, 20_000, 65_535, (1 << 31) - 1, (1 << 32) - 1)
_PNG = b"\x89PNG\r\n\x1a\n"
_CHUNKS = (b"IHDR", b"IDAT", b"IEND", b"PLTE", b"tRNS", b"tEXt", b"zTXt", b"iTXt", b"iCCP", b"eXIf", b"acTL", b"fcTL",
           b"fdAT", b"gAMA", b"cHRM", b"sBIT", b"bKGD", b"hIST", b"pHYs", b"tIME", b"ABCD")  # fmt: skip
_TAGS = (254, 256, 257, 258, 259, 262, 266, 269, 273, 277, 278, 279, 284, 317, 320, 322, 323, 324, 325, 330, 338, 339,
         34665, 34675)  # fmt: skip
_MARKERS = (0xC0, 0xC1, 0xC2, 0xC3, 0xC4, 0xC9, 0xCC, 0xD0, 0xD8, 0xD9, 0xDA, 0xDB, 0xDD, 0xE0, 0xE1, 0xE2, 0xEE, 0xFE)


def mutated_png(data: bytes, rng: np.random.Generator) -> bytes:
    """Chunks with right check sums and wrong contents; at times the bytes as they are."""
    if rng.random() < 0.2:
        return mutated_bytes(data, rng)
    chunks = _png_chunks(data)
    for _ in range(int(rng.integers(1, 4))):
        _edit_png(chunks, rng)
    tail = rng.bytes(int(rng.integers(200))) if rng.random() < 0.1 else b""
    return _PNG + b"".join(_png_chunk(kind, body) for kind, body in chunks) + tail


def _png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    found, at = [], len(_PNG)
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        found.append((kind, data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def _png_chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _edit_png(chunks: list[tuple[bytes, bytes]], rng: np.random.Generator) -> None:
    if not chunks:
        return
    at, way = int(rng.integers(len(chunks))), int(rng.integers(8))
    kind, body = chunks[at]
    if way == 0:
        chunks[at] = kind, mutated_bytes(body, rng)
    elif way == 1:
        del chunks[at]
    elif way == 2:
        chunks.insert(int(rng.integers(len(chunks) + 1)), chunks[at])
    elif way == 3:
        chunks[at] = _one(_CHUNKS, rng), body
    elif way == 4:
        chunks.insert(at, (_one(_CHUNKS, rng), rng.bytes(int(rng.integers(40)))))
    elif way == 5 and chunks[0][0] == b"IHDR" and len(chunks[0][1]) == 13:
        chunks[0] = b"IHDR", _png_head(chunks[0][1], rng)
    else:
        for place, (kind, body) in enumerate(chunks):
            if kind == b"IDAT":
                chunks[place] = kind, _other_pixels(body, rng)


def _png_head(head: bytes, rng: np.random.Generator) -> bytes:
    fields = list(struct.unpack(">IIBBBBB", head))
    at = int(rng.integers(7))
    fields[at] = int(rng.choice(_SIZES if at < 2 else (0, 1, 2, 3, 4, 6, 8, 16, 255)))
    return struct.pack(">IIBBBBB", *fields)


def _other_pixels(body: bytes, rng: np.random.Generator) -> bytes:
    """Filters and pixels changed under zlib's own check sum, fewer of them, more."""
    try:
        pixels = zlib.decompressobj().decompress(body, 1 << 20)
    except zlib.error:
        return body
    return zlib.compress(mutated_bytes(pixels, rng) + pixels[: int(rng.choice([0, 0, 1, 1000]))], 1)


def mutated_jpeg(data: bytes, rng: np.random.Generator) -> bytes:
    """Segments changed, moved, missing, of other kinds."""
    if rng.random() < 0.3:
        return mutated_bytes(data, rng)
    segments, scan = _jpeg_segments(data)
    for _ in range(int(rng.integers(1, 4))):
        scan = _edit_jpeg(segments, scan, rng)
    heads = (bytes([0xFF, kind]) + struct.pack(">H", len(body) + 2 & 0xFFFF) + body for kind, body in segments)
    return b"\xff\xd8" + b"".join(heads) + scan


def _jpeg_segments(data: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """What stands before the first scan's data, and the rest."""
    found, at = [], 2
    while True:
        kind, length = data[at + 1], struct.unpack_from(">H", data, at + 2)[0]
        found.append((kind, data[at + 4 : at + 2 + length]))
        at += 2 + length
        if kind == 0xDA:
            return found, data[at:]


def _edit_jpeg(segments: list[tuple[int, bytes]], scan: bytes, rng: np.random.Generator) -> bytes:
    way = int(rng.integers(8))
    if way < 2 or not segments:
        return mutated_bytes(scan, rng)
    at = int(rng.integers(len(segments)))
    kind, body = segments[at]
    if way == 2:
        segments[at] = kind, mutated_bytes(body, rng)
    elif way == 3:
        del segments[at]
    elif way == 4:
        segments.insert(int(rng.integers(len(segments) + 1)), segments[at])
    elif way == 5:
        segments[at] = int(rng.choice(_MARKERS)), body
    elif way == 6:
        segments.insert(at, (int(rng.choice(_MARKERS)), rng.bytes(int(rng.integers(60)))))
    else:
        for place, (kind, body) in enumerate(segments):
            if kind in (0xC0, 0xC2) and len(body) >= 6:
                segments[place] = kind, _jpeg_frame(body, rng)
    return scan


def _jpeg_frame(body: bytes, rng: np.random.Generator) -> bytes:
    """The head of the frame: bits, height, width, components and their sampling."""
    fields = list(struct.unpack_from(">BHHB", body))
    at = int(rng.integers(5))
    if at == 4:
        return body[:6] + mutated_bytes(body[6:], rng)
    choices = ((0, 1, 8, 12, 16, 255), _SIZES[:9], _SIZES[:9], (0, 1, 2, 3, 4, 255))[at]
    fields[at] = int(rng.choice(choices))
    return struct.pack(">BHHB", *fields) + body[6:]


def mutated_tiff(data: bytes, rng: np.random.Generator) -> bytes:
    """Entries of its directories changed: tags, types, counts, values, and where the next directory is."""
    if rng.random() < 0.2:
        return mutated_bytes(data, rng)
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        _edit_tiff(changed, rng)
    return bytes(changed[: int(rng.integers(len(changed)))] if rng.random() < 0.1 else changed)


def _edit_tiff(data: bytearray, rng: np.random.Generator) -> None:
    order = "<" if data[:2] == b"II" else ">"
    places = _tiff_directories(data, order)
    if not places:
        return
    at, count = places[int(rng.integers(len(places)))]
    way = int(rng.integers(6))
    entry = at + 2 + 12 * int(rng.integers(max(count, 1)))
    if entry + 12 > len(data):
        return
    if way == 0:
        struct.pack_into(order + "H", data, entry, int(rng.choice(_TAGS)))
    elif way == 1:
        struct.pack_into(order + "H", data, entry + 2, int(rng.integers(19)))
    elif way == 2:
        struct.pack_into(order + "I", data, entry + 4, int(rng.choice([0, 1, 2, 48, 1 << 16, 1 << 28, (1 << 32) - 1])))
    elif way == 3:
        struct.pack_into(order + "I", data, entry + 8, int(rng.choice([*_SIZES, 2, 3, 5, 7, 8, 16, 32_773, 34_712])))
    elif way == 4 and at + 6 + 12 * count <= len(data):
        offsets = [0, 8, at, at + 2, len(data) - 2, (1 << 32) - 1]
        struct.pack_into(order + "I", data, at + 2 + 12 * count, int(rng.choice(offsets)))
    else:
        struct.pack_into(order + "H", data, at, int(rng.choice([0, 1, count + 1, max(count - 1, 0), 65_535])))


def _tiff_directories(data: bytearray, order: str) -> list[tuple[int, int]]:
    """Where each begins and how many entries it has, as far as that can be followed."""
    found: list[tuple[int, int]] = []
    at = struct.unpack_from(order + "I", data, 4)[0] if len(data) >= 8 else 0
    while at and at + 2 <= len(data) and all(at != place for place, _ in found):
        count = struct.unpack_from(order + "H", data, at)[0]
        found.append((at, count))
        behind = at + 2 + 12 * count
        at = struct.unpack_from(order + "I", data, behind)[0] if behind + 4 <= len(data) else 0
    return found


def mutated_bmp(data: bytes, rng: np.random.Generator) -> bytes:
    """Fields of its header changed."""
    if rng.random() < 0.3:
        return mutated_bytes(data, rng)
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.choice([2, 10, 14, 18, 22, 26, 28, 30, 34, 46, 50]))
        number = int(rng.choice([*_SIZES, 3, 4, 8, 12, 16, 24, 32, 40, 124, (1 << 32) - 48]))
        struct.pack_into("<I", changed, at, number)
    return bytes(changed)


def _one(choices: tuple[bytes, ...], rng: np.random.Generator) -> bytes:
    return choices[int(rng.integers(len(choices)))]
