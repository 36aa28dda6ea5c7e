"""A job, done: frames to lines, in whatever process this runs."""

import contextlib
import os
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.lines import line, smoothed
from asterism.server.chain.pipeline import localize
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.pose.track import Tracks
from asterism.server.service.adviser import Adviser
from asterism.server.service.batch.jobs import LINES, MARKS, STATE, TOLD, Film, Job, Told, file_of
from asterism.server.service.batch.memory import MARK_BYTES, mark, restored, stored
from asterism.server.service.tally import Tally
from asterism.server.sources.open_source import open_source
from asterism.server.sources.source import Cuttable, Source

MOST_SAID = 20  # sentences of a source
FLUSH_S = 0.25  # how often it shows how far it is
PARTIAL = ".partial-"

_rigs: dict[str, Rig] = {}  # those of the newest film: plans are made once for each


def solve(job: Job) -> Told:
    """Do it, and leave its files. What is wrong with the source or the disk is told as its problem."""
    warm_up(*localizing(job.film.rig))
    try:
        return _Solving(job).run()
    except (InputError, WorldError) as error:
        return Told(problem=str(error))
    except MemoryError:
        return Told(problem="there is not enough memory for this")
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        return Told(problem=f"{name}{error.strerror or error}")


class _Solving:
    """One job in work."""

    def __init__(self, job: Job) -> None:
        self._job, self._film = job, job.film
        self._rig = _rig_of(job.film)
        self._told = Told()
        self._source = open_source(self._film.source, self._rig, self._say, topic=self._film.topic)
        self._tracks = _before(job)
        self._until = _marks(job)
        self._tally = Tally(robot.id for robot in self._rig.robots)

    def run(self) -> Told:
        began = time.monotonic()
        with _files(self._job) as (lines, marks):
            results = smoothed(self._located(marks), self._rig, self._film.smooth)
            encoder = msgspec.json.Encoder()
            for frame, result in results:
                lines.write(encoder.encode(line(frame, result)) + b"\n")
        told = self._told
        told.unreadable = self._source.unreadable
        if not self._job.before and not self._job.first:
            told.notes = self._notes()
        told.seconds = time.monotonic() - began
        self._leave()
        return told

    def _located(self, marks: BinaryIO) -> Iterator[tuple[Frame, FrameResult]]:
        """Frame after frame; one mark goes with each, by which others see how far it is."""
        told, independent, flushed = self._told, self._film.independent, time.monotonic()
        for count, frame in enumerate(_frames(self._source, self._job)):
            result, after = localize(frame, self._rig, Tracks.none() if independent else self._tracks)
            self._tracks = after
            self._tally.add(frame, result)
            told.in_order &= frame.exposed_ns >= told.last_ns or not count
            told.first_ns = told.first_ns if count else frame.exposed_ns
            told.frames, told.last_ns = count + 1, frame.exposed_ns
            own = mark(after, frame.exposed_ns) if self._job.marked or self._job.until else bytes(MARK_BYTES)
            marks.write(own)
            if time.monotonic() > flushed + FLUSH_S:
                marks.flush()
                flushed = time.monotonic()
            yield frame, result
            if own == self._until[count * MARK_BYTES : (count + 1) * MARK_BYTES]:
                told.agreed = True
                return

    def _notes(self) -> list[str]:
        """What can be done about it, as `locate` says at its end."""
        adviser = Adviser(self._rig, self._tally, self._say)
        lines = self._tally.lines() if self._tally.frames else []
        return [] if self._job.end is not None else adviser.summary()[len(lines) :]

    def _say(self, text: str) -> None:
        if text not in self._told.said and len(self._told.said) < MOST_SAID:
            self._told.said.append(text)

    def _leave(self) -> None:
        """The memory at its end, and last of all what says that the piece is finished."""
        for kind, data in ((STATE, stored(self._tracks)), (TOLD, msgspec.json.encode(self._told))):
            target = file_of(self._film, self._job.name, kind)
            part = target.with_name(f"{target.name}{PARTIAL}{uuid.uuid4().hex[:8]}")
            part.write_bytes(data)
            part.replace(target)


def _rig_of(film: Film) -> Rig:
    if film.key not in _rigs:
        _rigs.clear()
        _rigs[film.key] = film.rig
    return _rigs[film.key]


def _before(job: Job) -> Tracks:
    return restored(file_of(job.film, job.before, STATE).read_bytes()) if job.before else Tracks.none()


def _marks(job: Job) -> bytes:
    return file_of(job.film, job.until, MARKS).read_bytes() if job.until else b""


def _frames(source: Source, job: Job) -> Iterator[Frame]:
    if job.end is None:
        return source.frames()
    assert isinstance(source, Cuttable)
    return source.part(job.first, job.end)


@contextlib.contextmanager
def _files(job: Job) -> Iterator[tuple[BinaryIO, BinaryIO]]:
    """Streams for lines and marks; what they hold takes their names when it is whole."""
    targets = [file_of(job.film, job.name, kind) for kind in (LINES, MARKS)]
    # Two that write the same, one of which nobody waits for any more, do not meet.
    parts = [path.with_name(f"{path.name}{PARTIAL}{uuid.uuid4().hex[:8]}") for path in targets]
    try:
        with parts[0].open("wb") as lines, parts[1].open("wb") as marks:
            yield lines, marks
            lines.flush()
            os.fsync(lines.fileno())
        for part, target in zip(parts, targets, strict=True):
            part.replace(target)
    except BaseException:
        for part in parts:
            part.unlink(missing_ok=True)
        raise


def frames_done(folder: Path) -> int:
    """How many frames of a film its pieces in work and those that are finished hold by now."""
    sizes = 0
    with contextlib.suppress(OSError):
        for entry in os.scandir(folder):
            if MARKS in entry.name and "+" not in entry.name:
                with contextlib.suppress(OSError):
                    sizes += entry.stat().st_size
    return sizes // MARK_BYTES
