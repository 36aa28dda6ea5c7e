"""What `asterism fuse` does without recordings: join what servers publish, and publish that."""

import argparse
import json
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.network import DEFAULT_ENDPOINT, FUSED_ENDPOINT, server_config
from asterism.server.chain.kernel_list import FUSE
from asterism.server.chain.warm_up import warm_up
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.report import rig_report
from asterism.server.service.fusing.ears import Ears
from asterism.server.service.fusing.joining import Joining
from asterism.server.service.live_line import LiveLine
from asterism.server.service.on_air import Place, on_air_as
from asterism.server.service.say import say
from asterism.server.service.stop import Stop, stop_on_signals
from asterism.server.sources.session_clock import SessionClock


class Joined(NamedTuple):
    """Which cameras are joined (none: all), where they are heard, and where what comes of it is published."""

    hears: tuple[str, ...]
    speaks: Place
    cameras: tuple[str, ...] = ()

    @property
    def places(self) -> str:
        """Where cameras are heard, in words."""
        return ", ".join([*self.hears, *([self.speaks.connect] if self.speaks.connect else [])])


def fuse_live(options: argparse.Namespace) -> int:
    """Join until Ctrl-C. Raises InputError and WorldError as `on_air_as` and `Ears` do."""
    for name in options.camera:
        if problem := keys.key_problem(name):
            raise InputError(f"--camera {name!r}: the name {problem}")
    hears = tuple(dict.fromkeys(options.connect)) or (() if options.join else (DEFAULT_ENDPOINT,))
    listen = options.listen or (None if options.join or _listens(options.zenoh) else FUSED_ENDPOINT)
    speaks = Place(listen, options.join, options.zenoh, joining="--join")
    stop = Stop()
    with stop_on_signals(stop):  # until all is closed: a second Ctrl-C changes nothing
        join_until(stop, Joined(hears, speaks, tuple(options.camera)))
    return 0


def join_until(stop: Stop, joined: Joined) -> None:
    """The same, until ``stop`` is set."""
    clock = SessionClock()
    with ExitStack() as stack:
        nobody = to_bytes(rig_report(Fleet.of([])))
        air = stack.enter_context(on_air_as(keys.FUSED, nobody, joined.speaks, clock, stop.interrupt))
        joining = Joining(air.publisher, clock, stop, joined.cameras, joined.places)
        ears = stack.enter_context(Ears(joined.hears, joined.speaks.options, joined.cameras, joining.hear))
        if joined.speaks.connect is not None:
            ears.hear(air.session)
        warm_up(FUSE)
        say(f"joining the cameras at {joined.places}; poses are at {joined.speaks}")
        with LiveLine(joining.now):
            joining.run(ears)
        for line in joining.summary():
            say(line)
    if air.rivals.sentence:
        raise InputError(air.rivals.sentence)


def _listens(options: Path | None) -> bool:
    """Whether a file of zenoh's options says where to listen."""
    told = json.loads(server_config(options=options).get_json("listen/endpoints"))
    return bool(told != [DEFAULT_ENDPOINT])
