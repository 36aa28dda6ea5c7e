"""What a film's lines rest on: where any of it changed since, they are no longer true."""

import hashlib
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from asterism import __version__
from asterism.protocol.rig import Rig
from asterism.server.service.batch.cutting import Piece


class Basis(msgspec.Struct):
    """What a film's lines rest on, each as a short digest."""

    program: str
    rig: str
    source: str
    options: str

    def key(self, pieces: Sequence[Piece]) -> str:
        """All of it, and where the film is cut."""
        return _digest(msgspec.json.encode([self, list(pieces)]))

    def changed(self, before: "Basis") -> str:
        """What is another than before, in words; none of it: nothing."""
        words = {"program": "the program", "rig": "the rig", "source": "the source", "options": "the options"}
        return " and ".join(word for name, word in words.items() if getattr(self, name) != getattr(before, name))


def basis_of(files: Iterable[Path], rig: Rig, options: Sequence[object]) -> Basis:
    """What the lines of a film rest on that is made of those files. Raises OSError for one that cannot be looked at."""
    stats = [(path.name, stat.st_size, stat.st_mtime_ns) for path in files for stat in [path.stat()]]
    with np.printoptions(floatmode="unique", threshold=sys.maxsize):
        told = repr(rig)
    return Basis(
        program(), _digest(told.encode()), _digest(msgspec.json.encode(stats)), _digest(repr(options).encode())
    )


def program() -> str:
    """The version, and a digest of the code that solves."""
    server = Path(__file__).resolve().parents[2]
    contents = hashlib.sha256()
    for room in (server, server.parent / "protocol", server.parent / "recordings"):
        for module in sorted(room.rglob("*.py")):
            contents.update(module.read_bytes())
    return f"{__version__} {contents.hexdigest()[:16]}"


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
