"""asterism locate: poses of images, a video or a recording, as JSON lines or as a recording."""

import argparse
import logging
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import msgspec

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.lines import BOTH_WAYS, line, smoothed
from asterism.server.chain.pipeline import localize
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.lines_output import lines_output
from asterism.server.command.number_arguments import bits
from asterism.server.command.record_arguments import add_record
from asterism.server.command.recorded_film import film_recorder
from asterism.server.command.shared_arguments import FINITE_SOURCE, add_out, add_smoothing_ways, add_topic
from asterism.server.output import check_file, check_folder_of_many
from asterism.server.pose.track import Tracks
from asterism.server.service.adviser import Adviser
from asterism.server.service.live_line import LiveLine, Now
from asterism.server.service.say import say, say_warnings
from asterism.server.service.stop import Stop, stop_on_signals
from asterism.server.service.surface_watch import SurfaceWatch
from asterism.server.service.tally import Tally
from asterism.server.sources.open_source import refuse_endless
from asterism.server.sources.source import Source

EXAMPLES = (
    "asterism locate rig.yaml frames/ -o poses.jsonl\n"
    "asterism locate rig.yaml 'frames/*.png' -o poses.jsonl --independent\n"
    "asterism locate rig.yaml frames/ -o poses.jsonl --smooth both\n"
    "asterism locate rig.yaml frames/ --record recordings\n"
)

_LOG = logging.getLogger(__name__)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("rig", metavar="RIG", help="rig.yaml")
    part.add_argument("source", metavar="SOURCE", help=FINITE_SOURCE)
    add_topic(part)
    add_out(part, "OUT", "where the lines go; - for the terminal", required=False)
    add_record(part, "none")
    part.add_argument("--independent", action="store_true", help="each frame alone, without what came before")
    part.add_argument(
        "--bits",
        metavar="N",
        type=bits,
        help="of 16-bit images that are the camera's (default: the rig's, or what is seen)",
    )
    add_smoothing_ways(part)


def run(options: argparse.Namespace) -> int:
    """Localize every frame; nothing is waited for, nothing is dropped."""
    if options.independent and options.smooth:
        raise InputError("--independent and --smooth exclude each other: each frame alone, or joined to those before")
    _check_outputs(options)
    rig = load_rig(options.rig)
    if options.bits is not None:
        rig = replace(rig, capture=replace(rig.capture, bits=options.bits))
    say_warnings(rig)
    refuse_endless(options.source, "locate")
    rig, source = open_fitting(options.source, rig, say, options.topic)
    warm_up(*localizing(rig, options.source))
    encoder, stop = msgspec.json.Encoder(), Stop()
    tally = Tally(robot.id for robot in rig.robots)
    adviser, surface = Adviser(rig, tally, say), SurfaceWatch(rig, say)
    with lines_output(options.out, options.force) as out, film_recorder(options, rig, source) as record:
        with stop_on_signals(stop), _live_line(options.out, source, tally):
            located = _watched(_located(source.frames(), rig, options.independent), tally, adviser, stop)
            located = surface.watched(located)
            for frame, result in smoothed(located, rig, options.smooth):
                if out is not None:
                    out.write(encoder.encode(line(frame, result)) + b"\n")
                if record is not None:
                    record(frame, result)
        _tell(source, tally, adviser, stop())
        if surface.problem:
            say(f"{surface.problem}; {surface.remedy}")
        if stop():
            raise KeyboardInterrupt  # so that half of it does not stand under the name of the whole
    return 0


def _check_outputs(options: argparse.Namespace) -> None:
    if options.out is None and options.record is None:
        raise InputError("nothing is to be written, expected -o OUT for lines, --record DIR for a recording, or both")
    if options.out is not None and str(options.out) != "-":
        check_file(options.out, options.force)
    if options.record is None:
        if options.record_frames.every:
            raise InputError("--record-frames is for a recording; add --record DIR")
        return
    check_folder_of_many(options.record)
    if options.smooth == BOTH_WAYS and options.record_frames.every:
        raise InputError(
            "--smooth both keeps no images while it waits for what comes after; expected --record-frames none"
        )


def _tell(source: Source, tally: Tally, adviser: Adviser, stopped: bool) -> None:
    if source.unreadable:
        say(f"{source.unreadable} images could not be read and were skipped")
    say(f"{tally.frames} frames" + (f" of {source.length}" if stopped and source.length else ""))
    for told in adviser.summary():
        say(told)


def _located(frames: Iterator[Frame], rig: Rig, independent: bool) -> Iterator[tuple[Frame, FrameResult]]:
    tracks = Tracks.none()
    for frame in frames:
        result, after = localize(frame, rig, tracks)
        if not independent:
            tracks = after
        yield frame, result


def _watched(
    located: Iterator[tuple[Frame, FrameResult]], tally: Tally, adviser: Adviser, stop: Stop
) -> Iterator[tuple[Frame, FrameResult]]:
    """The same, counted and looked at, until it is to stop."""
    for frame, result in located:
        _log(frame, result)
        tally.add(frame, result)
        adviser.look()
        yield frame, result
        if stop():
            return


def _live_line(out: Path | None, source: Source, tally: Tally) -> AbstractContextManager[object]:
    """How it goes; nothing where the lines themselves run over the terminal."""
    if str(out) == "-" and sys.stdout.isatty():
        return nullcontext()

    def now() -> Now:
        notes = [f"{source.unreadable} unreadable"] if source.unreadable else []
        return Now(tally.frames, source.length, tally.rate_hz(), tally.newest(), notes)

    return LiveLine(now)


def _log(frame: Frame, result: FrameResult) -> None:
    """For --verbose: what a frame showed."""
    if _LOG.isEnabledFor(logging.DEBUG):
        states = ", ".join(f"{robot} {answer.state}" for robot, answer in result.answers.items())
        _LOG.debug("%s: %d spots; %s", frame.name, len(result.blobs.fates), states)
