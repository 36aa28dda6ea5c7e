"""Protobuf messages with something wrong at any depth: fields as they lie on the wire, edited and written again.

Wire format: https://protobuf.dev/programming-guides/encoding.
"""

import struct

import numpy as np

from tests.protocol.mutations import mutated_bytes

Field = tuple[int, int, int | bytes]  # number, wire type, value
_VARINT, _EIGHT, _LENGTH, _FOUR = 0, 1, 2, 5
_WHOLE = (0, 1, 2, 3, 4, 5, 6, 7, 99, 1 << 31, (1 << 31) - 1, 1 << 32, 1 << 63, (1 << 63) - 1, (1 << 64) - 1)
_REAL = (np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 1e-3, 1e6, 1e155, 1e308, -1e308, 5e-324)
_TEXTS = (
    b"",
    b"0",
    b"-1",
    b"4",
    b"7",
    b"1e999",
    b"nan",
    b"inf",
    b"-inf",
    b"0x10",
    b"1_0",
    b" 5 ",
    b"9" * 19,
    b"9" * 21,
    b"9" * 400,
    b"9" * 5000,
    "٣".encode(),
    "²".encode(),
    b"\x1b[2J\x1b]52;c;eA==\x07",
    b"a/b",
    b"**",
    b"a\nb",
    b"\x00",
    b"\xff\xfe",
    "\u202e\u2028".encode(),
    b"TRACKED",
    b"LOST",
    b"state",
    b"leds",
    b"session",
    b"published_ns",
    b"x" * 3000,
)
_DEEPEST = 6


def mutated_message(data: bytes, rng: np.random.Generator) -> bytes:
    """The message with one to three things wrong, mostly in its fields, at times in its bytes."""
    if rng.random() < 0.15:
        return mutated_bytes(data, rng)
    for _ in range(int(rng.integers(1, 4))):
        data = _edited(data, rng, 0)
    return data


def fields_of(data: bytes) -> list[Field] | None:
    """A message's fields in their order, or None for bytes that are no message."""
    found: list[Field] = []
    at = 0
    try:
        while at < len(data):
            tag, at = _read_varint(data, at)
            number, wire = tag >> 3, tag & 7
            if number == 0 or wire not in (_VARINT, _EIGHT, _LENGTH, _FOUR):
                return None
            if wire == _VARINT:
                value, at = _read_varint(data, at)
                found.append((number, wire, value))
                continue
            length = {_EIGHT: 8, _FOUR: 4}.get(wire)
            if length is None:
                length, at = _read_varint(data, at)
            if at + length > len(data):
                return None
            found.append((number, wire, data[at : at + length]))
            at += length
    except IndexError:
        return None
    return found


def message_of(fields: list[Field]) -> bytes:
    """The bytes of these fields."""
    parts = []
    for number, wire, value in fields:
        parts.append(_varint(number << 3 | wire))
        if isinstance(value, int):
            parts.append(_varint(value))
        else:
            parts += [_varint(len(value)), value] if wire == _LENGTH else [value]
    return b"".join(parts)


def _edited(data: bytes, rng: np.random.Generator, depth: int) -> bytes:
    fields = fields_of(data)
    if not fields:
        return _other_text(data, rng)
    at = int(rng.integers(len(fields)))
    number, wire, value = fields[at]
    if isinstance(value, bytes) and wire == _LENGTH and depth < _DEEPEST and rng.random() < 0.75:
        fields[at] = number, wire, _edited(value, rng, depth + 1)
        return message_of(fields)
    way = int(rng.integers(10))
    if way < 5:
        fields[at] = number, wire, _other_value(wire, value, rng)
    elif way == 5:
        del fields[at]
    elif way == 6:
        fields.insert(int(rng.integers(len(fields) + 1)), fields[at])
    elif way == 7:
        fields[at] = int(rng.choice([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 1000, (1 << 29) - 1])), wire, value
    elif way == 8:
        other = int(rng.integers(len(fields)))
        fields[at], fields[other] = fields[other], fields[at]
    else:
        return _length_lies(fields, at, rng)
    return message_of(fields)


def _other_value(wire: int, value: int | bytes, rng: np.random.Generator) -> int | bytes:
    if isinstance(value, int):
        return int(_WHOLE[int(rng.integers(len(_WHOLE)))])
    if wire == _EIGHT:
        return _eight(rng)
    if wire == _FOUR:
        return struct.pack("<f", np.float32(np.clip(_real(rng), -3e38, 3e38)))
    return _other_text(value, rng)


def _other_text(value: bytes, rng: np.random.Generator) -> bytes:
    """Of a text, or of numbers that are packed."""
    way = int(rng.integers(5))
    if way == 0 and len(value) >= 8:
        at = int(rng.integers(len(value) // 8)) * 8
        return value[:at] + _eight(rng) + value[at + 8 :]
    if way == 1:
        return value[: int(rng.integers(len(value) + 1))]
    if way == 2:
        return value + value[: 8 * int(rng.integers(4))]
    if way == 3:
        return mutated_bytes(value, rng)
    return _TEXTS[int(rng.integers(len(_TEXTS)))]


def _length_lies(fields: list[Field], at: int, rng: np.random.Generator) -> bytes:
    number, _, value = fields[at]
    length = int(rng.choice([0, 1, 127, 1 << 20, (1 << 31) - 1, 1 << 40]))
    body = value if isinstance(value, bytes) else _varint(value)
    lie = _varint(number << 3 | _LENGTH) + _varint(length) + body
    return message_of(fields[:at]) + lie + message_of(fields[at + 1 :])


def _eight(rng: np.random.Generator) -> bytes:
    if rng.random() < 0.7:
        return struct.pack("<d", _real(rng))
    return struct.pack("<Q", _WHOLE[int(rng.integers(len(_WHOLE)))])


def _real(rng: np.random.Generator) -> float:
    return float(_REAL[int(rng.integers(len(_REAL)))])


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    number = shift = 0
    while True:
        byte = data[at]
        at += 1
        number |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return number & (1 << 64) - 1, at
        if shift > 63:
            raise IndexError("a number of more than ten bytes")


def _varint(number: int) -> bytes:
    coded = bytearray()
    while number > 0x7F:
        coded.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*coded, number])
