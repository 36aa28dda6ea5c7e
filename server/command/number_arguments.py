"""Numbers on the command line, with one sentence for what is none."""

import argparse
import math
import re

from asterism.protocol.ros2.names import LARGEST_DOMAIN
from asterism.protocol.yaml_file import describe

MOST_DIGITS = 15
LEAST_SIZE = 10_000_000  # bytes
_SIZE = re.compile(r"(\d{1,9}(?:\.\d{1,9})?) ?([kMGT])(i?)B", re.ASCII | re.IGNORECASE)


def positive(text: str) -> float:
    """A number above 0."""
    value = number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text}, expected a number above 0")
    return value


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{describe(text)}, expected a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{describe(text)}, expected a finite number")
    return value


def count(text: str) -> int:
    """A whole number above 0."""
    value = _digits(text)
    if not value:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a whole number above 0")
    return value


def port(text: str) -> int:
    """A port to listen on."""
    value = _digits(text)
    if not value or value > 65_535:
        raise argparse.ArgumentTypeError(f"{describe(text)}, expected a port, 1 to 65535")
    return value


def ros_domain(text: str) -> int:
    """A domain of ROS 2."""
    value = _digits(text)
    if value is None or value > LARGEST_DOMAIN:
        raise argparse.ArgumentTypeError(f"{describe(text)}, expected a domain of ROS 2, 0 to {LARGEST_DOMAIN}")
    return value


def bits(text: str) -> int:
    """Significant bits of a pixel."""
    value = _digits(text)
    if value is None or not 8 <= value <= 16:
        raise argparse.ArgumentTypeError(f"{describe(text)}, expected a number of bits, 8 to 16")
    return value


def size(text: str) -> int:
    """Bytes of a size such as 50GB, 1.5TB or 500MiB."""
    match = _SIZE.fullmatch(text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{describe(text)}, expected a size such as 50GB, 500MB or 1.5TiB")
    number_of, unit, binary = match.groups()
    found = int(float(number_of) * (1024 if binary else 1000) ** ("KMGT".index(unit.upper()) + 1))
    if found < LEAST_SIZE:
        raise argparse.ArgumentTypeError(f"{describe(text)}, expected at least 10MB")
    return found


def whole(text: str) -> int:
    """A whole number, 0 or more."""
    value = _digits(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a whole number, 0 or more")
    return value


def _digits(text: str) -> int | None:
    """The number, None for what is none; what no computer counts to is refused as such."""
    if not (text.isascii() and text.isdigit()):
        return None
    if len(text) > MOST_DIGITS:
        raise argparse.ArgumentTypeError(f"{describe(text)}, expected a number of at most {MOST_DIGITS} digits")
    return int(text)


def not_negative(text: str) -> float:
    """A number, 0 or more."""
    value = number(text)
    if not value >= 0:
        raise argparse.ArgumentTypeError(f"{text}, expected a number, 0 or more")
    return value


def share(text: str) -> float:
    """A number from 0 to 1."""
    value = number(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text}, expected a number from 0 to 1")
    return value
