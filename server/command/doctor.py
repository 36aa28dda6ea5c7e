"""asterism doctor: what a few seconds of frames say of camera, lens, light and rig, and what to do about it."""

import argparse
import contextlib
import math
import time
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.live import Live

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.yaml_file import read_yaml
from asterism.server.chain.frame import Frame
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.joined import joined
from asterism.server.command.number_arguments import positive
from asterism.server.command.progress import progress
from asterism.server.command.shared_arguments import SOURCE, add_ros_domain, add_server, add_topic
from asterism.server.doctor.blink import check_delay
from asterism.server.doctor.examine import examine
from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.doctor.gather import Gathered, Gatherer
from asterism.server.doctor.host import check_disk, check_port
from asterism.server.doctor.live import page, watch
from asterism.server.doctor.page import summary, table_of
from asterism.server.doctor.reading import read_live
from asterism.server.service.say import say
from asterism.server.sources.paced import paced
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.source import LiveSource, Source

EXAMPLES = (
    "asterism doctor rig.yaml /dev/video0\n"
    "asterism doctor rig.yaml /dev/video0 --watch      while you turn the lens\n"
    "asterism doctor rig.yaml frames/\n"
)

SECONDS = 5.0
WIDTH = 80  # columns, where there is no terminal
REFRESH_HZ = 10.0


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("rig", metavar="RIG", help="rig.yaml")
    part.add_argument("source", metavar="SOURCE", help=SOURCE)
    add_topic(part)
    add_ros_domain(part)
    add_server(part)
    part.add_argument(
        "--seconds", metavar="S", type=positive, default=SECONDS, help=f"how long to look (default {SECONDS:g})"
    )
    part.add_argument("--watch", action="store_true", help="a live page for focusing, until Ctrl-C")
    part.add_argument(
        "--blink",
        metavar="HZ",
        type=positive,
        help="an LED is on for the first half of every 1/HZ s of this computer's clock: tell capture.delay_us by it",
    )


def run(options: argparse.Namespace) -> int:
    """Look at the frames; 1 where something is wrong."""
    if options.watch and options.blink:
        raise InputError("--watch and --blink exclude each other: a live page, or the delay of the stamps")
    rig, source = open_fitting(options.source, load_rig(options.rig), say, options.topic, options.ros_domain)
    warm_up(*localizing(rig, options.source))
    with joined(source, options):
        if options.watch:
            return _watch(rig, source)
        gatherer = Gatherer(rig)
        count = round(options.seconds * source.rate_hz)
        for frame in progress(_looked_at(source, options.seconds, gatherer), count, "looking"):
            gatherer.add(frame)
    findings = _findings(options, gatherer.gathered())
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    console.print(table_of(findings))
    console.print(f"\n{len(gatherer)} frames of {source.name}: {summary(findings)}", highlight=False, soft_wrap=True)
    return int(any(found.verdict == Verdict.WRONG for found in findings))


def _findings(options: argparse.Namespace, gathered: Gathered) -> list[Finding]:
    rig = Path(options.rig)
    camera_file = rig.parent / read_yaml(rig).text("camera")
    return [
        *examine(gathered, options.rig, camera_file, time.time()),
        check_delay(gathered, options.blink),
        check_port(),
        check_disk(gathered.rig, Path.cwd()),
    ]


def _looked_at(source: Source, seconds: float, gatherer: Gatherer) -> Iterator[Frame]:
    """The frames of the first seconds: of a camera those that there is time for, else all, by their own times.

    Raises InputError where there is none, WorldError where none comes.
    """
    if isinstance(source, LiveSource):
        yield from read_live(source, seconds, gatherer.note)
        return
    end_ns = None
    for frame in source.frames():
        end_ns = frame.exposed_ns + 1e9 * seconds if end_ns is None else end_ns
        if frame.exposed_ns >= end_ns:
            return
        gatherer.note(frame)
        yield frame
    if end_ns is None:
        raise InputError(f"{source.name}: has no frames")


def _watch(rig: Rig, source: Source) -> int:
    """Draw until Ctrl-C or the end of the source; a film is played as fast as it was taken."""
    console = Console()
    with contextlib.suppress(KeyboardInterrupt):
        if isinstance(source, LiveSource):
            frames = read_live(source, math.inf, lambda _: None, ahead=1)
        else:
            frames = paced(source.frames(), None, lambda: False, SessionClock())
        if not console.is_terminal:
            for now in watch(rig, frames):
                console.print(f"{now.blur_px:.2f} px of blur, robots seen: {now.robots} of {now.of}", highlight=False)
            return 0
        with Live(console=console, refresh_per_second=REFRESH_HZ) as live:
            for now in watch(rig, frames):
                live.update(page(now))
    return 0
