"""asterism demo: five simulated robots, served, recorded and watched, without camera, router or display."""

import argparse
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

from asterism.clients.asking import asking
from asterism.clients.watch import show
from asterism.clients.watched import RobotTable
from asterism.protocol import keys
from asterism.protocol.errors import InputError
from asterism.protocol.program import typed
from asterism.protocol.rig import load_rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.number_arguments import positive
from asterism.server.command.shared_arguments import add_server, add_smoothing, client_words, named
from asterism.server.output import check_folder_of_many
from asterism.server.service.on_air import Place, on_air
from asterism.server.service.serve import Outlets, Run
from asterism.server.service.stop import Stop, stop_on_signals
from asterism.server.simulation.demo_rig import DEMO_WORKPIECE
from asterism.server.simulation.simulate import Look
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.simulated import Simulated

EXAMPLES = "asterism demo\nasterism demo --seconds 5 --record /tmp\n"

RECORD = Path("recordings-demo")
# A well-shaded camera: its dark background packs well, so that the demonstration's recording stays small.
LOOK = Look(background=4.0, read_noise=0.2)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("--seconds", metavar="N", type=positive, default=20.0, help="how long (default: 20)")
    part.add_argument("--forever", action="store_true", help="until Ctrl-C")
    part.add_argument("--record", metavar="DIR", type=named, default=RECORD, help="default: recordings-demo")
    add_smoothing(part)
    add_server(part)


def run(options: argparse.Namespace) -> int:
    """Run for --seconds, or until Ctrl-C, then say where to look."""
    check_folder_of_many(options.record)
    rig = load_rig(DEMO_WORKPIECE)
    console = Console()
    clock, stop = SessionClock(), Stop()
    place = Place(options.listen, options.connect, options.zenoh)
    with ExitStack() as last, ExitStack() as stack:
        air = stack.enter_context(on_air(place, rig, clock, stop.interrupt))
        warm_up(*localizing(rig, "sim"))
        last.enter_context(stop_on_signals(stop))
        source = Simulated(rig, look=LOOK)
        table, drawn = RobotTable(), threading.Event()
        stack.callback(table.subscribe(air.session).clear)
        stack.enter_context(asking(air.session, keys.rig(rig.camera.name), table.servers))
        drawing = threading.Thread(target=show, args=(table, console, drawn), name="table")
        recorder = Recorder(options.record, rig, source.name, FramesKept(), wait=True)
        served = Run(rig, source, Outlets(air.publisher, recorder), stop, clock)
        drawing.start()
        try:
            if not options.forever:
                timer = threading.Timer(options.seconds, stop.set)
                timer.daemon = True
                timer.start()
                stack.callback(timer.cancel)
            began = time.monotonic()
            served.serve(smoothed=options.smooth)
            seconds = time.monotonic() - began
        finally:
            drawn.set()
            drawing.join()
            recorder.close(served.ending())
    frames, *robots = served.summary()
    print(f"\n{frames}, in {seconds:.0f} s; recorded in\n  {recorder.folder}")
    print("\n".join([*(f"  {line}" for line in robots), *_next(options, recorder.folder)]))
    if air.rivals.sentence:
        raise InputError(air.rivals.sentence)
    if recorder.problem:
        print(recorder.problem)
        return 1
    return 0


def _next(options: argparse.Namespace, folder: Path) -> list[str]:
    """What to look at next: commands that work as they are printed."""
    server = _given(options, "listen", "connect", "zenoh")
    client = client_words(options)
    record = _given(options, "record") if options.record != RECORD else []
    return [
        "",
        "look at it:",
        f"  {typed('review', folder)}",
        "play it again, and watch that in another terminal:",
        f"  {typed('replay', folder, '--loop', *server)}",
        f"  {typed('watch', '--prefix', 'replay/', *client)}",
        "let it run, and watch it in another terminal:",
        f"  {typed('demo', '--forever', *record, *server)}",
        f"  {typed('watch', *client)}",
    ]


def _given(options: argparse.Namespace, *names: str) -> list[object]:
    """Those of the options that were given, as they are typed."""
    return [word for name in names if (value := getattr(options, name)) for word in (f"--{name}", value)]
