"""One file of a recording, damaged in any way, through every reader and through `recover`."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import rerun as rr

from asterism.protocol.messages import Message
from asterism.recordings.decodable import read_report
from asterism.recordings.drawing import Drawing
from asterism.recordings.reader import Recording
from tests.recordings.judge import read_all, recovered
from tests.recordings.mutations import MUTATIONS, hand_made, rig, write_file, write_old

FRAMES, A_CHUNK = 4, 5
_SHARED_MEMORY = Path("/dev/shm")


@contextmanager
def _recording(data: bytes) -> Iterator[Path]:
    where = _SHARED_MEMORY if _SHARED_MEMORY.is_dir() else None  # thousands of files, none worth a disk
    with tempfile.TemporaryDirectory(dir=where) as folder:
        (Path(folder) / "poses-0001.mcap").write_bytes(data)
        yield Path(folder)


def read(data: bytes) -> list[bytes]:
    """Through every reader; raises InputError where they refuse it."""
    with _recording(data) as folder:
        found = read_all(folder)
        Recording(folder).rig()
        return found


def recover(data: bytes) -> list[bytes]:
    """Mended, and read by every reader, others' among them."""
    with _recording(data) as folder:
        return recovered(folder, [])


@cache
def _drawing() -> Drawing:
    stream = rr.RecordingStream("mutated")
    stream.save(os.devnull)
    return Drawing(stream, rig())


def review(payload: bytes) -> None:
    """A frame's report of a recording, drawn into rerun."""
    _drawing().report(read_report(payload, Path("recording")))


@cache
def files() -> tuple[bytes, ...]:
    """Good ones: poses and images, of today and of version 0.1, packed and not."""
    told, images = hand_made(FRAMES, np.random.default_rng(5))
    found = []
    for messages, compression in ((told, "zstd"), (told, ""), (images, "lz4")):
        for write in (_new, write_old):
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "poses-0001.mcap"
                write(file, messages, compression, A_CHUNK)
                found.append(file.read_bytes())
    return tuple(found)


def _new(file: Path, messages: list[Message], compression: str, a_chunk: int) -> None:
    write_file(file.parent, "poses", messages, compression, a_chunk)


def mutated_file(data: bytes, rng: np.random.Generator) -> bytes:
    """Damaged in one way, at times in two."""
    kinds = list(MUTATIONS)
    mutated = MUTATIONS[kinds[int(rng.integers(len(kinds)))]](data, rng).data
    if mutated and rng.random() < 0.3:
        at = int(rng.integers(len(mutated)))
        mutated = mutated[:at] + bytes([mutated[at] ^ (1 << int(rng.integers(8)))]) + mutated[at + 1 :]
    return mutated
