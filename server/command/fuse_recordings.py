"""What `asterism fuse RECORDING ... -o OUT` does: lines, a recording, or both, of what several cameras recorded."""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path

import msgspec

from asterism.protocol.codec import stamped
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.keys import FUSED
from asterism.protocol.messages import Clock
from asterism.protocol.program import typed
from asterism.protocol.rig import parse_rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.recordings.tape import Shown, Tape, exposures_of, refuse_apart, tapes_of
from asterism.server.chain.kernel_list import FUSE
from asterism.server.chain.warm_up import warm_up
from asterism.server.command.fused_line import FusedTally, fused_line
from asterism.server.command.lines_output import lines_output
from asterism.server.command.progress import progress, working
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.offline import Exposure, Watching, fused_offline
from asterism.server.fusing.report import CAMERA_TEXT, Told, report, rig_text
from asterism.server.output import check_file, check_folder_of_many
from asterism.server.service.fusing.ways import Ways, told_of_times
from asterism.server.service.say import say


def fuse_recordings(options: argparse.Namespace) -> int:
    """Join the recordings' frames, exposure by exposure. Raises InputError for recordings that do not fit together."""
    if options.out is not None and str(options.out) != "-":
        check_file(options.out, options.force)
    if options.record is not None:
        check_folder_of_many(options.record)
    with working("reading when frames were taken"):
        tapes = _chosen(tapes_of(options.recordings, besides=FUSED), options.camera)
    refuse_apart(tapes)
    watching = Watching()
    for part in (tape.parts[0] for tape in tapes):
        watching.take(part.recording.rig(), str(part.recording.path))
    for tape in tapes:
        say(f"{tape.camera}: {tape.frames} frames, {tape.span}")
    if len(tapes) == 1:
        say(f"there is nothing to join: all of it is of one camera, '{tapes[0].camera}'")
    encoder, tally = msgspec.json.Encoder(), FusedTally()
    warm_up(FUSE)
    ways = Ways()
    exposures = _watched(progress(exposures_of(tapes), None, "fusing"), ways)
    with lines_output(options.out, options.force) as out, _recorder(options, tapes) as record:
        for exposure in fused_offline(watching, exposures):
            tally.add(exposure.fused)
            if out is not None:
                out.write(encoder.encode(fused_line(exposure)) + b"\n")
            if record is not None:
                record(exposure)
    say(f"{tally.exposures} exposures")
    for line in [*tally.summary(), *_of_times(ways, tapes)]:
        say(line)
    return 0


def _watched(exposures: Iterator[list[Shown]], ways: Ways) -> Iterator[list[Shown]]:
    for exposure in exposures:
        for shown in exposure:
            ways.add(shown.camera, shown.report)
        yield exposure


def _of_times(ways: Ways, tapes: Sequence[Tape]) -> list[str]:
    """What is wrong with the cameras' times, by the newest seconds of all."""
    for _ in combinations(tapes, 2):
        ways.look(0)
    periods = [(tape.span.last_ns - tape.span.first_ns) * 1e-9 / (tape.frames - 1) for tape in tapes if tape.frames > 1]
    return told_of_times(ways, min(periods, default=math.inf))


def _chosen(tapes: list[Tape], names: Sequence[str]) -> list[Tape]:
    there = [tape.camera for tape in tapes]
    for name in names:
        if name not in there:
            raise InputError(f"--camera {name}: is in none of the recordings, expected of {', '.join(there)}")
    return [tape for tape in tapes if not names or tape.camera in names]


@contextmanager
def _recorder(options: argparse.Namespace, tapes: Sequence[Tape]) -> Iterator[Callable[[Exposure], None] | None]:
    """What records every exposure where --record asks for it. Raises WorldError where not all could be written."""
    if options.record is None:
        yield None
        return
    parts = [part.recording.path for tape in tapes for part in tape.parts]
    recorded = _Recorded(options.record, ", ".join(map(str, parts)))
    try:
        yield recorded.add
    finally:
        recorded.close(parts)
    if recorded.recorder is not None and recorded.recorder.problem:
        raise WorldError(recorded.recorder.problem)


class _Recorded:
    """A recording of what is joined, begun with the first exposure; ``source`` is what it is made of."""

    def __init__(self, parent: Path, source: str) -> None:
        self.recorder: Recorder | None = None
        self._parent, self._source = parent, source
        self._fleet: Fleet | None = None
        self._count = 0

    def add(self, exposure: Exposure) -> None:
        """Record one exposure."""
        recorder = self._recorder_for(exposure.fleet)
        at = exposure.fused.exposed_ns
        told = report(exposure.fused, exposure.fleet, Told(self._count, clock=Clock.FILE))
        recorder.write([stamped(message, at) for message in told], None, at, self._count)
        self._count += 1

    def close(self, parts: Sequence[Path]) -> None:
        """Finish, and say how to look at it."""
        if self.recorder is not None:
            self.recorder.close({"frames": str(self._count), "dropped": "0"})
            say(f"recorded in {self.recorder.folder}; look at it, and at what each camera saw, with")
            say(f"  {typed('review', self.recorder.folder, *parts)}")

    def _recorder_for(self, fleet: Fleet) -> Recorder:
        if self.recorder is not None and fleet is self._fleet:
            return self.recorder
        self._fleet, rig = fleet, parse_rig(rig_text(fleet), CAMERA_TEXT, FUSED)
        if self.recorder is None:
            self.recorder = Recorder(self._parent, rig, self._source, FramesKept(0), wait=True, timed=False)
        self.recorder.take_rig(rig)
        return self.recorder
