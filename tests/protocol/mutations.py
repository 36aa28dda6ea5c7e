"""Files and messages as bad luck and bad people make them: seeded mutations of good ones."""

import re

import numpy as np

# What readers of YAML have stumbled over, to stand where a value stood.
STRANGE_VALUES = (
    "2001-99-99",
    "!!float x",
    "!!int x",
    "!!timestamp x",
    "!!binary x",
    "!!python/name:os.system",
    "!<x> y",
    '"\\U00110000"',
    '"\\uD800"',
    "9" * 400,
    "9" * 5000,
    "-" + "9" * 400,
    "1e999",
    "-.inf",
    ".nan",
    "0x" + "f" * 300,
    "0o777",
    "1_000",
    "12:30:45",
    "~",
    "",
    "{}",
    "[]",
    "[" * 200 + "]" * 200,
    "{a: " * 100 + "1" + "}" * 100,
    "&a [*a]",
    "*nowhere",
    "? x",
    "- x",
    "| \n x",
    "no",
    "true",
    "<<: *a",
    "\t",
    "2001-01-01T00:00:00+99:99",
    "0b" + "1" * 70,
    "'",
    '"',
    "%YAML 9.9",
    "x" * 100_000,
    "\u2028",
    "\ufeff",
)
STRANGE_LINES = (
    "%YAML 9.9\n---\n",
    "%TAG ! x\n",
    "---\n---\n",
    "...\n",
    "\x00",
    "\ufeff",
    "- a\n",
    "? [a, b]\n: c\n",
    "1: 2\n",
)


_NUMBERS = (
    "0",
    "-0.0",
    "-1",
    "1",
    "1e-300",
    "1e300",
    "1e-9",
    "3",
    "180",
    "100000",
    "2147483648",
    "1e16",
    "0.5",
    "-1e9",
)
_NAMES = ("a/b", "*", '"a b"', '""', "alpha", "tool", "x", "é", '"\\x1b[2J"', "..", "0", "../../etc/passwd")


def mutated_yaml(text: str, rng: np.random.Generator) -> str:
    """The text with one to three things wrong."""
    for _ in range(int(rng.integers(1, 4))):
        text = _YAML_WAYS[int(rng.integers(len(_YAML_WAYS)))](text, rng)
    return text


def mutated_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one to four things wrong."""
    for _ in range(int(rng.integers(1, 5))):
        data = _BYTE_WAYS[int(rng.integers(len(_BYTE_WAYS)))](data, rng)
    return data


_VALUE = re.compile(r"(?<=[:,\[\-] )[^\s,\[\]{}]+|(?<=\[)[^\s,\[\]{}]+")
_NUMBER = re.compile(r"(?<=[\s\[,])-?\d[\d.e-]*")
_KEY = re.compile(r"(?<![A-Za-z_\"])[A-Za-z_\"]++(?=:)")  # in one pass, also over words of 100 000 letters
_LIST = re.compile(r"\[[^\[\]]*\]|\{[^{}]*\}")


def _strange_value(text: str, rng: np.random.Generator) -> str:
    return _replaced(_VALUE, text, STRANGE_VALUES[int(rng.integers(len(STRANGE_VALUES)))], rng)


def _other_number(text: str, rng: np.random.Generator) -> str:
    return _replaced(_NUMBER, text, _NUMBERS[int(rng.integers(len(_NUMBERS)))], rng)


def _other_name(text: str, rng: np.random.Generator) -> str:
    return _replaced((_KEY, _VALUE)[int(rng.integers(2))], text, _NAMES[int(rng.integers(len(_NAMES)))], rng)


def _swapped(text: str, rng: np.random.Generator) -> str:
    """Two values, keys or lists in each other's place."""
    places = list((_VALUE, _KEY, _LIST)[int(rng.integers(3))].finditer(text))
    if len(places) < 2:
        return text
    a, b = sorted(rng.choice(len(places), 2, replace=False).tolist())
    one, other = places[a], places[b]
    return text[: one.start()] + other.group() + text[one.end() : other.start()] + one.group() + text[other.end() :]


def _value_gone(text: str, rng: np.random.Generator) -> str:
    """One value of a list less, or one twice."""
    places = list(re.finditer(r"(?<![^\s,\[\]{}])[^\s,\[\]{}]++, ", text))
    if not places:
        return text
    place = places[int(rng.integers(len(places)))]
    return text[: place.start()] + place.group() * int(2 * rng.integers(2)) + text[place.end() :]


def _replaced(what: re.Pattern[str], text: str, by: str, rng: np.random.Generator) -> str:
    places = list(what.finditer(text))
    if not places:
        return text
    place = places[int(rng.integers(len(places)))]
    return text[: place.start()] + by + text[place.end() :]


def _strange_line(text: str, rng: np.random.Generator) -> str:
    lines = text.splitlines(keepends=True)
    lines.insert(int(rng.integers(len(lines) + 1)), str(rng.choice(STRANGE_LINES)))
    return "".join(lines)


def _without_a_line(text: str, rng: np.random.Generator) -> str:
    lines = text.splitlines(keepends=True)
    if lines:
        del lines[int(rng.integers(len(lines)))]
    return "".join(lines)


def _line_twice(text: str, rng: np.random.Generator) -> str:
    lines = text.splitlines(keepends=True)
    if lines:
        lines.insert(int(rng.integers(len(lines))), lines[int(rng.integers(len(lines)))])
    return "".join(lines)


def _other_character(text: str, rng: np.random.Generator) -> str:
    at = int(rng.integers(len(text) + 1))
    return text[:at] + str(rng.choice(list("&*!|>%@`{}[]:,-?#'\"\\\t \n\x00\x07é\ud7ff0"))) + text[at + 1 :]


def _cut(text: str, rng: np.random.Generator) -> str:
    return text[: int(rng.integers(len(text) + 1))]


_YAML_WAYS = (
    _strange_value, _strange_value, _other_number, _other_number, _other_number, _other_name, _swapped, _swapped,
    _value_gone, _strange_line, _without_a_line, _line_twice, _other_character, _cut,
)  # fmt: skip


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    if not data:
        return data
    at = int(rng.integers(len(data)))
    return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]


def _other_byte(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(data) + 1))
    return data[:at] + bytes([int(rng.choice([0, 1, 0x7F, 0x80, 0xFF, int(rng.integers(256))]))]) + data[at + 1 :]


def _truncated(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data) + 1))]


def _range_moved(data: bytes, rng: np.random.Generator) -> bytes:
    first, last, at = sorted(int(i) for i in rng.integers(0, len(data) + 1, 3))
    return data[:first] + data[last:at] + data[first:last] + data[at:]


def _range_filled(data: bytes, rng: np.random.Generator) -> bytes:
    first, last = sorted(int(i) for i in rng.integers(0, len(data) + 1, 2))
    last = min(last, first + 16)
    return data[:first] + bytes([int(rng.choice([0, 0xFF]))]) * (last - first) + data[last:]


def _strange_number(data: bytes, rng: np.random.Generator) -> bytes:
    """A double or a length that no reader expects, somewhere."""
    number = float(rng.choice([np.nan, np.inf, -np.inf, 1e308, -0.0, 5e-324]))
    at = int(rng.integers(len(data) + 1))
    return data[:at] + np.float64(number).tobytes() + data[at + 8 :]


_BYTE_WAYS = (_flip, _flip, _other_byte, _truncated, _range_moved, _range_filled, _strange_number)
