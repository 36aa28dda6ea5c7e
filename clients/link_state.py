"""How a program stands with a server: a word for programs, a sentence for people."""

from enum import Enum
from typing import NamedTuple


class LinkState(Enum):
    """From best to worst."""

    LIVE = "live"
    NO_POSE = "no pose"  # of a robot, for `FRESH_S`; the server lives
    SLOW = "slow"  # what the server sends arrives late
    SILENT = "silent"  # the server stopped answering: frozen, or cut off
    GONE = "gone"  # it ended, or the connection broke
    WAITING = "waiting"  # no server was found yet


class Link(NamedTuple):
    """``state``, and a ``sentence`` that says it with numbers."""

    state: LinkState
    sentence: str


ORDER = tuple(LinkState)
FRESH_S = 0.1


def best(links: list[Link]) -> Link:
    """The link of several that serves best."""
    return min(links, key=lambda link: ORDER.index(link.state))
