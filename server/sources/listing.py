"""What cameras there are, and how to name each as a source."""

from collections.abc import Sequence
from contextlib import closing
from typing import NamedTuple

from asterism.server.sources.genicam.listing import list_genicam
from asterism.server.sources.genicam.offers import offers_of
from asterism.server.sources.v4l2.camera import trouble
from asterism.server.sources.v4l2.node import KERNEL, Mode, Node, System
from asterism.server.sources.v4l2.offers import Offer, read_offers
from asterism.server.sources.v4l2.pixels import FORMATS
from asterism.server.sources.v4l2.place import best_names


class Found(NamedTuple):
    """A camera."""

    name: str  # to use as SOURCE
    what: str  # it is
    offers: tuple[str, ...] = ()  # what it gives, a line for each pixel format
    problem: str = ""  # why it cannot be used


def v4l2_cameras(system: System = KERNEL) -> list[Found]:
    """V4L2 cameras, and nodes that may be some but do not open; what gives no images is left out."""
    nodes = system.nodes()
    names = best_names(nodes)
    return [found for path in nodes if (found := _look(path, names[path], system)) is not None]


def genicam_cameras() -> tuple[list[Found], str]:
    """GenICam cameras; and why there can be none, or ""."""
    cameras, problem = list_genicam()
    found = []
    for one in cameras:
        what = f"{one.vendor} {one.model}, serial {one.serial}, {one.place.address or 'USB'}, GenICam"
        found.append(Found(one.name, what, *offers_of(one.place.id, one.place.address)))
    return found, problem


def _look(path: str, name: str, system: System) -> Found | None:
    try:
        with closing(Node(path, system)) as node:
            if node.not_a_camera():
                return None
            return Found(name, f"{node.card}, V4L2, {path}", tuple(_offers(read_offers(node))))
    except OSError as error:
        return Found(name, f"V4L2, {path}", problem=trouble(path, error))


def _offers(offers: Sequence[Offer]) -> list[str]:
    """A line for each pixel format, or for several of the same sizes and rates, and one for those that are not read."""
    by_sizes: dict[str, list[str]] = {}
    for offer in offers:
        by_sizes.setdefault(_sizes(offer) if offer.fourcc in FORMATS else "not read", []).append(offer.fourcc)
    unread = by_sizes.pop("not read", [])
    lines = [": ".join(filter(None, [" ".join(fourccs), sizes])) for sizes, fourccs in by_sizes.items()]
    return [*lines, *([f"not read: {' '.join(unread)}"] if unread else [])]


def _sizes(offer: Offer) -> str:
    """Sizes of the same rate together, fastest first."""
    if offer.span is not None:
        return offer.sizes_text() + _rate(offer.modes[0].rates[:1])
    by_rate: dict[tuple[float, ...], list[Mode]] = {}
    for mode in offer.modes:
        by_rate.setdefault(mode.rates[:1], []).append(mode)
    parts = []
    for rates, modes in sorted(by_rate.items(), reverse=True):
        sizes = sorted((mode.size for mode in modes), key=lambda size: -size[0] * size[1])
        parts.append(" ".join(f"{width}x{height}" for width, height in sizes) + _rate(rates))
    return "; ".join(parts)


def _rate(rates: tuple[float, ...]) -> str:
    return f" at up to {rates[0]:.4g} Hz" if rates else ""
