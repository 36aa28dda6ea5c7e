"""What one worker does at a time, and what it tells of it. Both travel between processes, and hosts."""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from asterism.protocol.rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """A source with the rig for its images, and how it is to be solved. ``key`` names all of that; ``folder`` is where
    its pieces go. ``smooth`` is as `lines.smoothed` takes it.
    """

    source: str
    topic: str | None
    rig: Rig
    key: str
    independent: bool
    smooth: str | None
    folder: Path


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """Solve a piece of a film, its places from ``first`` up to ``end``; None: all of it, however long it is.

    ``before`` names the piece whose memory it begins with, none for an empty one. It then goes only as far as its
    memory is not yet that of the piece which began empty, whose marks are in the file ``until``. ``marked``: others are
    to compare their memory with its own.
    """

    film: Film
    name: str
    first: int
    end: int | None
    before: str = ""
    until: str = ""
    marked: bool = False


class Told(msgspec.Struct):
    """What came of a job: how many ``frames``; ``agreed`` says whether the memories met before its end, in its last
    frame. ``in_order``: no frame was taken before the one before it, from ``first_ns`` to ``last_ns``.
    """

    frames: int = 0
    seconds: float = 0.0
    unreadable: int = 0
    agreed: bool = False
    in_order: bool = True
    first_ns: int = 0
    last_ns: int = 0
    said: list[str] = []
    notes: list[str] = []
    problem: str = ""


LINES, MARKS, STATE, TOLD = ".jsonl", ".marks", ".npz", ".json"


def file_of(film: Film, name: str, kind: str) -> Path:
    """One of a piece's files. When the one that tells of it is there, all are."""
    return film.folder / (name + kind)


def told_of(film: Film, name: str) -> Told | None:
    """What came of a piece, if it is finished."""
    try:
        return msgspec.json.decode(file_of(film, name, TOLD).read_bytes(), type=Told)
    except (OSError, msgspec.DecodeError):
        return None
