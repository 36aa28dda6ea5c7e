"""asterism serve: localize what a source shows, publish it, record it."""

import argparse
from contextlib import ExitStack

from asterism.protocol.codec import encode_rig
from asterism.protocol.errors import InputError
from asterism.protocol.network import DEFAULT_ENDPOINT, open_server
from asterism.protocol.rig import load_rig
from asterism.recordings.recorder import Recorder
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.service.publish import Publisher
from asterism.server.service.say import say, say_warnings
from asterism.server.service.serve import Sink, Stop, serve, stop_on_signals
from asterism.server.sources.open_source import open_source


def run(options: argparse.Namespace) -> int:
    """Serve until the source ends or Ctrl-C; exit code 1 if the recording had to end early."""
    rig = load_rig(options.rig)
    say_warnings(rig)
    if options.listen and options.connect:
        raise InputError("--listen and --connect exclude each other; --connect joins what is there as a client")
    source = open_source(options.source, rig, say)
    if source.live and options.rate is not None:
        raise InputError("--rate is for images and videos; a camera's rate stands in the rig (capture.rate)")
    stop = Stop()
    with ExitStack() as stack:
        session = open_server(options.listen, options.connect, options.zenoh)
        publisher = stack.enter_context(Publisher(session, rig.camera.name, encode_rig(rig)))
        warm_up(*localizing(rig, options.source))
        sinks: tuple[Sink, ...] = ()
        if options.rerun:
            from asterism.server.service.live_view import LiveView

            sinks = (stack.enter_context(LiveView(rig)).write,)
        recorder = None
        if options.record is not None:
            recorder = Recorder(options.record, rig, source.name, options.record_frames, wait=not source.live)
        where = options.connect or options.listen or options.zenoh or DEFAULT_ENDPOINT
        say(f"serving {len(rig.robots)} robots of camera '{rig.camera.name}' from {source.name} at {where}")
        if recorder is not None:
            say(f"recording to {recorder.folder}")
        summary = None
        try:
            with stop_on_signals(stop):
                summary = serve(rig, source, publisher, recorder, stop, options.rate, sinks, options.smooth)
        finally:
            if recorder is not None:
                ending = {} if summary is None else {"frames": str(summary.frames), "dropped": str(summary.dropped)}
                recorder.close(ending)
    say(
        f"{summary.frames} frames, {summary.dropped} dropped, {summary.unreadable} unreadable"
        + (f", {summary.left_out} not recorded" if recorder is not None else "")
    )
    if recorder is not None and recorder.problem:
        say(recorder.problem)
        return 1
    return 0
