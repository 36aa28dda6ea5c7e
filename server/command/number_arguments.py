"""Numbers on the command line, with one sentence for what is none."""

import argparse
import math

from asterism.protocol.yaml_file import describe

MOST_DIGITS = 15


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
    value = count(text)
    if value > 65_535:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a port, 1 to 65535")
    return value


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
