"""Where a V4L2 camera is: by the name that a person gave, and again after it was plugged in elsewhere."""

import re
from collections.abc import Sequence
from contextlib import closing
from os.path import realpath
from pathlib import Path
from typing import NamedTuple

from asterism.protocol.errors import InputError
from asterism.server.sources.v4l2.node import Node, System

NODE = re.compile(r"/dev/video\d{1,4}")
LINKS = ("/dev/v4l/by-id", "/dev/v4l/by-path")  # udev's: the first stays with the camera, the second with the socket


def is_v4l2(text: str) -> bool:
    """Whether a person means a V4L2 camera: `0`, `/dev/video0`, a link to one, or where such links stand."""
    return text.isdecimal() or text.startswith(("/dev/video", "/dev/v4l/")) or bool(NODE.fullmatch(realpath(text)))


def name_of(text: str) -> str:
    """The name that is kept: as it was given, and of a number the node. Raises InputError for what can be none."""
    name = f"/dev/video{text}" if text.isdecimal() else text
    numbered = name.startswith("/dev/video") and not Path(name).is_symlink()
    if numbered and not NODE.fullmatch(name):
        raise InputError(f"{text}: expected a V4L2 camera such as 0 or /dev/video0, or a link to one")
    return name


def best_names(nodes: Sequence[str], folders: Sequence[str] = LINKS) -> dict[str, str]:
    """The name to use for each node: a link that stays with the camera, or with the socket, or the node itself."""
    names = {node: node for node in nodes}
    for folder in reversed(folders):
        for link in sorted(Path(folder).glob("*"), reverse=True):
            node = realpath(link)
            if node in names:
                names[node] = str(link)
    return names


class Identity(NamedTuple):
    """What stays of a camera that is plugged in again."""

    card: str
    part: str  # which of the camera's nodes it is
    bus: str  # where it is plugged in
    serial: str  # vendor:product:serial; "": it has none, or one that another camera has too

    def same(self, other: "Identity") -> bool:
        """Whether both are one camera: by its own number, or by its socket where it has none."""
        if (self.card, self.part) != (other.card, other.part):
            return False
        return self.serial == other.serial if self.serial else self.bus == other.bus


def identity(node: Node) -> Identity:
    """Who an open node is."""
    serial, part = node.system.hardware(node.path)
    return Identity(node.card, part, node.bus, serial)


def identity_here(node: Node) -> Identity:
    """The same, without a serial number that is not the camera's alone: many makers give all of theirs the same."""
    found = identity(node)
    others = (path for path in node.system.nodes() if path != node.path)
    twins = [
        path
        for path in others
        if found.serial and (other := _identity_at(path, node.system)) and other.same(found) and other.bus != found.bus
    ]
    return found._replace(serial="") if twins else found


def find_again(known: Identity, path: str, system: System) -> str | None:
    """Where a camera is by now: ``path``, where it was, or another node; None while it is away."""
    for candidate in dict.fromkeys([path, *system.nodes()]):
        found = _identity_at(candidate, system)
        if found is not None and known.same(found):
            return candidate
    return None


def _identity_at(path: str, system: System) -> Identity | None:
    try:
        with closing(Node(path, system)) as node:
            return None if node.not_a_camera() else identity(node)
    except OSError:
        return None
