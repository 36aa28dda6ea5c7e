"""A batch's folder: its films' lines, batch.json, and in .batch what a later start goes on with.

DIR/NAME.jsonl          a film's lines, once it is whole
DIR/batch.json          what came of all films
DIR/.batch/plan.json    every film: what it rests on, and where it is cut
DIR/.batch/NAME.KEY/    its pieces; KEY stands for all that they rest on
"""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import msgspec

from asterism.protocol.errors import InputError
from asterism.server.output import check_folder, free_name
from asterism.server.service.batch.basis import Basis
from asterism.server.service.batch.cutting import Piece
from asterism.server.service.batch.outcome import Changes, Robot

RESULT, HIDDEN, PLAN = "batch.json", ".batch", "plan.json"
OUTCOME = "outcome.json"


class Planned(msgspec.Struct):
    """A film as it was planned."""

    basis: Basis
    pieces: list[Piece]


class Outcome(msgspec.Struct):
    """What came of a film. ``state`` is done or failed; ``seconds`` those of all workers together; ``again`` counts
    pieces that were solved again, because memories did not meet.
    """

    name: str
    source: str
    state: str = "failed"
    problem: str = ""
    file: str = ""
    bytes: int = 0
    frames: int = 0
    unreadable: int = 0
    seconds: float = 0.0
    pieces: int = 1
    overlap: int = 0
    again: int = 0
    robots: dict[str, Robot] = {}
    notes: list[str] = []

    @property
    def rate_hz(self) -> float:
        """Frames a second that one worker solves."""
        return self.frames / self.seconds if self.seconds > 0.0 else 0.0


class Result(msgspec.Struct):
    """batch.json."""

    asterism: str
    rig: str
    independent: bool
    smooth: str | None
    topic: str | None
    films: list[Outcome]
    against: str | None = None
    changes: dict[str, Changes] = {}


def read_result(folder: Path) -> Result:
    """A batch's batch.json. Raises InputError where there is none, or it is of something else."""
    path = folder / RESULT
    try:
        return msgspec.json.decode(path.read_bytes(), type=Result)
    except OSError as error:
        unfinished = (folder / HIDDEN).is_dir()
        why = "the batch there is not finished" if unfinished else f"cannot be read ({error.strerror})"
        raise InputError(f"{path}: {why}, expected the folder of a batch") from None
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: {error}; expected what asterism batch writes") from None


def is_batch(folder: Path) -> bool:
    """Whether a folder is a batch's."""
    return folder.is_dir() and ((folder / RESULT).is_file() or (folder / HIDDEN).is_dir())


def prepare(folder: Path, force: bool) -> str:
    """Set aside what is to be replaced, or find the batch to go on with; returns what there is to say about it.

    Raises InputError where it holds something else (unless ``force``: then that is kept beside), or cannot be written.
    """
    if is_batch(folder) and not force:
        return ""
    try:
        check_folder(folder, force)
    except InputError as error:
        text = str(error)
        if "exists already" in text:
            text = (
                f"{folder}: exists already and is no batch's, expected a new or empty folder, that of a batch to go on "
                "with, or --force to replace it (the old one is kept beside)"
            )
        raise InputError(text) from None
    told = ""
    if folder.is_dir() and any(folder.iterdir()):
        _refuse_at_work(folder)
        kept = free_name(folder)
        folder.rename(kept)
        told = f"{folder}: the old one is kept as {kept}"
    return told


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Make the folder, where there is none, and keep other batches out. Raises InputError where one is at work.

    Where nothing came of it, nothing is left.
    """
    hidden, made = folder / HIDDEN, not folder.exists()
    hidden.mkdir(parents=True, exist_ok=True)
    with (hidden / "lock").open("w") as file:
        _lock(file, folder)
        try:
            yield
        finally:
            if not (hidden / PLAN).exists():
                shutil.rmtree(hidden, ignore_errors=True)
                if made:
                    with contextlib.suppress(OSError):
                        folder.rmdir()


def _refuse_at_work(folder: Path) -> None:
    """Raises InputError where a batch is at work: set aside, it would write into what takes its place."""
    with contextlib.suppress(OSError), (folder / HIDDEN / "lock").open("r+") as file:
        _lock(file, folder)


def _lock(file: TextIO, folder: Path) -> None:
    with contextlib.suppress(ImportError):
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder}: another batch is at work in it") from None
        except OSError:
            pass  # a disk without locks


def read_plan(folder: Path) -> dict[str, Planned]:
    """What an earlier start planned; nothing where it did not."""
    try:
        return msgspec.json.decode((folder / HIDDEN / PLAN).read_bytes(), type=dict[str, Planned])
    except (OSError, msgspec.DecodeError):
        return {}


def write(path: Path, told: object) -> None:
    """A file of JSON, whole or not at all."""
    part = path.with_name(path.name + ".partial")
    part.write_bytes(msgspec.json.format(msgspec.json.encode(told), indent=1) + b"\n")
    part.replace(path)


def pieces_folder(folder: Path, name: str, key: str) -> Path:
    """Where a film's pieces go, made; what is there of others of that name, and of those in work, is removed."""
    own = folder / HIDDEN / f"{name}.{key}"
    for entry in (folder / HIDDEN).iterdir():
        if entry.is_dir() and entry.name.rpartition(".")[0] == name and entry != own:
            shutil.rmtree(entry, ignore_errors=True)
    own.mkdir(exist_ok=True)
    for entry in own.iterdir():
        if ".partial" in entry.name:
            entry.unlink(missing_ok=True)
    return own


def outcome_of(folder: Path, own: Path) -> Outcome | None:
    """What came of a film that an earlier start finished; None where its lines are not what they were."""
    try:
        told = msgspec.json.decode((own / OUTCOME).read_bytes(), type=Outcome)
        return told if (folder / told.file).stat().st_size == told.bytes else None
    except (OSError, msgspec.DecodeError):
        return None
