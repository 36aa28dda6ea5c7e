"""What a V4L2 camera offers, and which of it is best for what a rig wants."""

from collections.abc import Sequence
from typing import NamedTuple

from asterism.protocol.errors import InputError
from asterism.server.sources.v4l2.node import Mode, Node, Span
from asterism.server.sources.v4l2.pixels import FORMATS

NEARLY = 0.99  # of a rate: cameras have 59.94 Hz for 60


class Offer(NamedTuple):
    """A pixel format and its sizes. Neither modes nor a span: the driver does not say."""

    fourcc: str
    description: str
    modes: tuple[Mode, ...]
    span: Span | None = None  # then the modes are the largest size's and the wanted one's

    def at(self, size: tuple[int, int]) -> Mode | None:
        """Its mode of that size."""
        if not self.modes and self.span is None:
            return Mode(*size)
        return next((mode for mode in self.modes if mode.size == size), None)

    def sizes_text(self) -> str:
        """Its sizes in words."""
        sizes = [mode.size for mode in self.modes] if self.span is None else self.span[:2]
        return (" " if self.span is None else " to ").join(f"{width}x{height}" for width, height in sizes)


class Choice(NamedTuple):
    """What is taken of it."""

    fourcc: str
    mode: Mode


def read_offers(node: Node, wanted: tuple[int, int] | None = None) -> list[Offer]:
    """All that a camera offers; ``wanted`` is a size that is asked for, where a range of them is offered."""
    offers = []
    for fourcc, description in node.formats():
        sizes = node.sizes(fourcc)
        span = sizes if isinstance(sizes, Span) else None
        if isinstance(sizes, Span):
            sizes = [sizes.most, *([wanted] if wanted not in (None, sizes.most) and sizes.has(wanted) else [])]
        offers.append(Offer(fourcc, description, tuple(node.mode(fourcc, size) for size in sizes), span))
    return offers


def choose(
    offers: Sequence[Offer], name: str, pixel_format: str | None, size: tuple[int, int], rate_hz: float | None
) -> Choice:
    """The best pixel format for a size and rate: grey, then 16, 14, 12, 10 bit, YUV, JPEG; a rate that none has at
    that size goes to the fastest.

    Raises InputError for a format or a size that the camera lacks, with those that it has.
    """
    able = [offer for offer in offers if offer.fourcc in FORMATS]
    if not able:
        has = _list([offer.fourcc for offer in offers])
        raise InputError(f"{name}: the camera has pixel formats {has}; expected one of {_list(list(FORMATS))}")
    if pixel_format is not None:
        able = [offer for offer in able if offer.fourcc == pixel_format.strip().upper()]
        if not able:
            raise InputError(_no_format(offers, name, pixel_format))
    fits = [Choice(offer.fourcc, mode) for offer in able if (mode := offer.at(size)) is not None]
    if not fits:
        raise InputError(f"{name}: the camera has no images of {size[0]}x{size[1]}; it has {_sizes(able)}")
    best = list(FORMATS)
    return min(fits, key=lambda choice: (-_share(choice.mode, rate_hz), best.index(choice.fourcc)))


def rates_text(mode: Mode) -> str:
    """The rates of a mode in words."""
    if mode.between:
        return f"{mode.rates[1]:.4g} to {mode.rates[0]:.4g} Hz"
    return f"{', '.join(f'{rate:.4g}' for rate in mode.rates)} Hz"


def _share(mode: Mode, rate_hz: float | None) -> float:
    """How much of a wanted rate a mode reaches; a driver that does not say is taken to."""
    if rate_hz is None or not mode.rates:
        return 1.0
    share = mode.rates[0] / rate_hz
    return 1.0 if share >= NEARLY else share


def _no_format(offers: Sequence[Offer], name: str, pixel_format: str) -> str:
    has = [offer.fourcc for offer in offers]
    why = "is not read" if pixel_format.strip().upper() in has else "the camera lacks it"
    readable = _list([fourcc for fourcc in has if fourcc in FORMATS])
    return f"{name}: capture.pixel_format {pixel_format}: {why}; expected one of {readable}"


def _sizes(offers: Sequence[Offer]) -> str:
    """Formats with their sizes, those of the same sizes together."""
    formats: dict[str, list[str]] = {}
    for offer in offers:
        formats.setdefault(offer.sizes_text(), []).append(offer.fourcc)
    return "; ".join(f"{sizes} ({_list(fourccs)})" for sizes, fourccs in formats.items())


def _list(names: list[str]) -> str:
    return ", ".join(names) if names else "none"
