"""asterism serve: localize what a source shows, publish it, record it."""

import argparse
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

from asterism.protocol.errors import InputError
from asterism.protocol.network import joins
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig, load_rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.number_arguments import port, positive, size
from asterism.server.command.outlets import add_outlets, check_outlets, open_outlets, ros_keys
from asterism.server.command.record_arguments import add_record
from asterism.server.command.shared_arguments import SOURCE, add_server, add_smoothing, add_topic
from asterism.server.output import check_folder_of_many
from asterism.server.service.live_line import LiveLine
from asterism.server.service.on_air import Place, on_air
from asterism.server.service.recovery import Recovery
from asterism.server.service.reload import reload_on_hangup
from asterism.server.service.ros2.told_camera import difference
from asterism.server.service.say import say, say_warnings
from asterism.server.service.serve import Outlets, Run
from asterism.server.service.stop import Stop, stop_on_signals
from asterism.server.sources.camera import clock_of
from asterism.server.sources.foreign.arriving import ArrivingImages
from asterism.server.sources.foreign.ros_images import RosImages
from asterism.server.sources.source import Source

if TYPE_CHECKING:
    from asterism.server.service.metrics import Collector

EXAMPLES = (
    "asterism serve rig.yaml /dev/video0 --record recordings\n"
    "asterism serve rig.yaml frames/ --rate 60\n"
    "asterism serve rig.yaml sim --rerun\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("rig", metavar="RIG", help="rig.yaml")
    part.add_argument("source", metavar="SOURCE", help=SOURCE)
    add_topic(part)
    part.add_argument("--rate", metavar="HZ", type=positive, help="play images or a video at this rate")
    add_record(part, "all")
    part.add_argument(
        "--record-limit",
        metavar="SIZE",
        type=size,
        help="at most so much, such as 50GB: the oldest frames are deleted, poses stay",
    )
    part.add_argument(
        "--metrics", metavar="PORT", type=port, help="health for Prometheus at http://127.0.0.1:PORT/metrics"
    )
    add_outlets(part)
    add_smoothing(part)
    add_server(part)


def run(options: argparse.Namespace) -> int:
    """Serve until the source ends or Ctrl-C; exit code 1 if the recording had to end early."""
    if options.record is not None:
        check_folder_of_many(options.record)
    elif options.record_limit is not None:
        raise InputError("--record-limit is for a recording; add --record DIR")
    rig = load_rig(options.rig)
    say_warnings(rig)
    check_outlets(options, rig)
    place = Place(options.listen, options.connect, options.zenoh, ros_keys(options, rig))
    rig, source = open_fitting(options.source, rig, say, options.topic, options.ros_domain)
    if source.live and options.rate is not None:
        raise InputError("--rate is for images and videos; a camera's rate stands in the rig (capture.rate)")
    clock, stop = clock_of(source), Stop()
    with ExitStack() as last, ExitStack() as stack:
        collector = _metrics(options, rig, stack)
        air = stack.enter_context(on_air(place, rig, clock, stop.interrupt))
        warm_up(*localizing(rig, options.source))
        if isinstance(source, RosImages):
            source.compare = partial(difference, rig.camera)
        if isinstance(source, ArrivingImages):
            source.join(air.session, listens=not joins(place.connect, place.options))
        last.enter_context(stop_on_signals(stop))  # until all is closed: a second Ctrl-C changes nothing
        others = open_outlets(options, rig, air, stack)
        robots = f"{len(rig.robots)} robot{'s' * (len(rig.robots) > 1)}"
        say(f"serving {robots} of camera '{rig.camera.name}' from {source.name} at {place}")
        recorder = _recorder(options, rig, source)
        begun = None
        if recorder is not None:
            begun = stack.enter_context(Recovery(options.record, rig.camera.name, say)).begin
        served = Run(rig, source, Outlets(air.publisher, recorder, others, begun), stop, clock, options.rig)
        if served.reloader is not None:
            last.enter_context(reload_on_hangup(served.reloader))
        if collector is not None:
            collector.run = served
        try:
            with LiveLine(served.now):
                served.serve(options.rate, options.smooth)
        finally:
            if recorder is not None:
                recorder.close(served.ending())
                say(f"recorded in {recorder.folder}; look at it with")
                say(f"  {typed('review', recorder.folder)}")
        for line in served.summary():
            say(line)
    if air.rivals.sentence:
        raise InputError(air.rivals.sentence)
    if recorder is not None and recorder.problem:
        say(recorder.problem)
        return 1
    return 0


def _metrics(options: argparse.Namespace, rig: Rig, stack: ExitStack) -> "Collector | None":
    """Listening from now on, so that a port which is taken is said before anything is begun."""
    if options.metrics is None:
        return None
    from asterism.server.service.metrics import metrics

    return stack.enter_context(metrics(rig.camera.name, options.metrics))


def _recorder(options: argparse.Namespace, rig: Rig, source: Source) -> Recorder | None:
    if options.record is None:
        return None
    kept, limit = options.record_frames, options.record_limit
    recorder = Recorder(options.record, rig, source.name, kept, wait=not source.live, limit_bytes=limit)
    say(f"recording to {recorder.folder}{_rate(rig, source, kept)}")
    return recorder


def _rate(rig: Rig, source: Source, kept: FramesKept) -> str:
    """What whole frames take, before anything is measured."""
    if kept.every == 0 or kept.spots:
        return ""
    rate = rig.camera.width * rig.camera.height * source.rate_hz / kept.every
    return f": frames take {rate / 1e6:.0f} MB/s, {rate * 3600 / 1e9:.0f} GB an hour"
