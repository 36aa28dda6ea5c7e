"""asterism demo: five simulated robots, served, recorded and watched, without camera, router or display."""

import argparse
import threading
import time
from contextlib import ExitStack

import zenoh
from rich.console import Console

from asterism.clients.watch import RobotTable, show
from asterism.protocol.codec import encode_rig
from asterism.protocol.network import DEFAULT_ENDPOINT, open_server
from asterism.protocol.rig import load_rig
from asterism.recordings.recorder import Recorder
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.service.publish import Publisher
from asterism.server.service.serve import Stop, serve, stop_on_signals
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look
from asterism.server.sources.simulated import Simulated

# A well-shaded camera: its dark background packs well, so that the demonstration's recording stays small.
LOOK = Look(background=4.0, read_noise=0.2)


def run(options: argparse.Namespace) -> int:
    """Run for --seconds, or until Ctrl-C, then say where to look."""
    rig = load_rig(DEMO_RIG)
    console = Console()
    stop = Stop()
    with ExitStack() as stack:
        session: zenoh.Session = open_server(options.listen, options.connect, options.zenoh)
        publisher = stack.enter_context(Publisher(session, rig.camera.name, encode_rig(rig)))
        warm_up(*localizing(rig, "sim"))
        source = Simulated(rig, look=LOOK)
        table, drawn = RobotTable(), threading.Event()
        stack.callback(table.subscribe(session).clear)
        drawing = threading.Thread(target=show, args=(table, console, drawn), name="table")
        recorder = Recorder(options.record, rig, source.name, 1, wait=True)
        drawing.start()
        try:
            if not options.forever:
                timer = threading.Timer(options.seconds, stop.set)
                timer.daemon = True
                timer.start()
                stack.callback(timer.cancel)
            with stop_on_signals(stop):
                began = time.monotonic()
                summary = serve(rig, source, publisher, recorder, stop, smoothed=options.smooth)
                seconds = time.monotonic() - began
        finally:
            drawn.set()
            drawing.join()
            recorder.close({})
    where = options.listen or options.connect or DEFAULT_ENDPOINT
    option = "" if where == DEFAULT_ENDPOINT else f" --connect {where}"
    again = "" if options.record == options.record.parent / "recordings-demo" else f" --record {options.record}"
    print(f"\n{summary.frames} frames in {seconds:.0f} s, recorded in {recorder.folder}\n")
    print(f"watch it live:   asterism demo --forever{again}   and, in another terminal:   asterism watch{option}")
    print(f"play it again:   asterism replay {recorder.folder}")
    print(f"look at it:      asterism review {recorder.folder}")
    if recorder.problem:
        print(recorder.problem)
        return 1
    return 0
