"""One camera's frame reports from its recordings, one after the other, with the rig that was in force for each; and
those of several cameras, exposure by exposure.
"""

import heapq
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.recordings.decodable import read_report
from asterism.recordings.reader import Recording

SINCE_1980_NS = 10 * 365 * 86400 * 10**9  # from then on a time is one of the epoch's; films count from 0


class Span(NamedTuple):
    """From the first exposure to the last, ns since the Unix epoch."""

    first_ns: int
    last_ns: int

    def meets(self, other: "Span") -> bool:
        """Whether they have a time in common."""
        return self.first_ns <= other.last_ns and other.first_ns <= self.last_ns

    def __str__(self) -> str:
        return f"{_time(self.first_ns)} to {_time(self.last_ns)}"


@dataclass(frozen=True, slots=True)
class Part:
    """One recording of a camera: its ``frames``, and when they were taken."""

    recording: Recording
    camera: str
    frames: int
    span: Span


@dataclass(frozen=True, slots=True)
class Tape:
    """All recordings of one camera, in the order of time."""

    camera: str
    parts: tuple[Part, ...]

    @property
    def frames(self) -> int:
        """How many frames tell something."""
        return sum(part.frames for part in self.parts)

    @property
    def span(self) -> Span:
        """Of all of them."""
        return Span(self.parts[0].span.first_ns, self.parts[-1].span.last_ns)

    def reports(self) -> "Iterator[tuple[pb.FrameReport, Rig]]":
        """Every frame report with its rig. Raises InputError for a recording that is damaged."""
        for part in self.parts:
            yield from _reports(part.recording)


class Shown(NamedTuple):
    """A frame report of a camera, and the rig that was in force for it."""

    camera: str
    report: "pb.FrameReport"
    rig: Rig


def exposures_of(tapes: Sequence[Tape]) -> Iterator[list[Shown]]:
    """What all cameras told, in the order of time: one after the other the exposures of any camera, each with the
    frames, one or more, that were exposed at exactly that time, by the cameras' names.
    """
    everything = heapq.merge(*(_shown(tape) for tape in tapes), key=_when)
    for _, together in groupby(everything, key=lambda shown: shown.report.exposed_ns):
        yield list(together)


def _shown(tape: Tape) -> Iterator[Shown]:
    return (Shown(tape.camera, report, rig) for report, rig in tape.reports())


def _when(shown: Shown) -> tuple[int, str]:
    return shown.report.exposed_ns, shown.camera


def refuse_apart(tapes: Sequence[Tape]) -> None:
    """Raises InputError for a camera that has no time in common with any other."""
    for tape in tapes:
        others = [part for other in tapes if other is not tape for part in other.parts]
        if others and not any(part.span.meets(other.span) for part in tape.parts for other in others):
            spans = ", ".join(f"{each.camera} {each.span}" for each in tapes)
            raise InputError(
                f"camera '{tape.camera}' has no time in common with any other ({spans}), expected recordings of one "
                "time, by clocks that agree (images tell theirs in a times.csv)"
            )


def tapes_of(folders: Sequence[Path], besides: str = "") -> list[Tape]:
    """The tapes of recordings, and of folders that hold recordings, by the cameras' names: the order in which the
    folders are given changes nothing. Recordings of camera ``besides`` are passed over where such a folder holds them.

    Raises InputError for what is no recording, holds no frame reports, is told of twice, or is damaged; where the time
    of one runs backwards; and where two of one camera overlap.
    """
    paths = sorted({path.resolve(): path for folder in folders for path in recordings_in(folder)}.items())
    recordings = [Recording(path) for _, path in paths]
    told = [each for each in recordings if each.path in folders or each.metadata.get("camera") != besides]
    parts = sorted(map(_part, told or recordings), key=lambda part: (part.camera, part.span, part.recording.path))
    cameras: dict[str, list[Part]] = {}
    for part in parts:
        cameras.setdefault(part.camera, []).append(part)
        _refuse_overlap(cameras[part.camera])
    return [Tape(camera, tuple(each)) for camera, each in cameras.items()]


def recordings_in(folder: Path) -> list[Path]:
    """The folder, or those in it where it holds recordings, as `asterism record` makes one for every camera."""
    if not folder.is_dir() or any(folder.glob("*.mcap")):
        return [folder]
    return sorted(path for path in folder.iterdir() if path.is_dir() and any(path.glob("*.mcap"))) or [folder]


def _part(recording: Recording) -> Part:
    path = recording.path
    first_ns, last_ns, frames = 0, -1, 0
    for message in recording.messages():
        if message.kind.schema != FRAME_REPORT.schema:
            continue
        if message.log_ns <= last_ns:
            raise InputError(
                f"{path}: frame {message.sequence} is {(last_ns - message.log_ns) * 1e-9:.3f} s older than the one "
                "before it (its clock was set), expected times that run forwards, to put frames beside other cameras'"
            )
        first_ns, last_ns, frames = message.log_ns if not frames else first_ns, message.log_ns, frames + 1
    if not frames:
        raise InputError(f"{path}: holds no frame reports, {_without_reports(recording)}")
    return Part(recording, recording.rig().camera.name, frames, Span(first_ns, last_ns))


def _without_reports(recording: Recording) -> str:
    if recording.count_frames():
        return f"only images; find what they show first: {typed('locate', 'RIG', recording.path)} --record DIR"
    return "expected a recording in which frames were solved"


def _refuse_overlap(parts: Sequence[Part]) -> None:
    """Of one camera, the newest against the one before."""
    if len(parts) > 1 and parts[-1].span.first_ns <= parts[-2].span.last_ns:
        one, other = parts[-2:]
        raise InputError(
            f"{one.recording.path} ({one.span}) and {other.recording.path} ({other.span}) are both of camera "
            f"'{one.camera}' at the same time, expected a name of its own for every camera (camera_name), and every "
            "recording once"
        )


def _reports(recording: Recording) -> "Iterator[tuple[pb.FrameReport, Rig]]":
    rigs = deque(recording.rigs())
    rig = rigs.popleft()[1]
    for message in recording.messages():
        if message.kind.schema == FRAME_REPORT.schema:
            while rigs and message.sequence >= rigs[0][0]:
                rig = rigs.popleft()[1]
            yield read_report(message.payload, recording.path), rig


def _time(time_ns: int) -> str:
    if time_ns < SINCE_1980_NS:
        return f"{time_ns * 1e-9:.3f} s"
    second = datetime.fromtimestamp(time_ns // 10**9, UTC)
    return f"{second:%Y-%m-%d %H:%M:%S}.{time_ns // 10**6 % 1000:03d} UTC"
