"""Options of serve that show or hand on what it publishes in other programs' ways, and what each opens."""

import argparse
from contextlib import ExitStack
from typing import TYPE_CHECKING

from asterism.protocol.rig import Rig
from asterism.server.service.outlets import Outlet

if TYPE_CHECKING:
    from asterism.server.service.mavlink.endpoint import Endpoint


def add_outlets(part: argparse.ArgumentParser) -> None:
    """Which outlets there are to be."""
    part.add_argument("--rerun", action="store_true", help="show everything in the rerun viewer while it happens")
    part.add_argument(
        "--mavlink",
        metavar="ROBOT=HOST:PORT",
        action="append",
        type=_flight_controller,
        default=[],
        help="send a robot's poses to its flight controller over UDP; may be given for several",
    )


def _flight_controller(text: str) -> "Endpoint":
    from asterism.server.service.mavlink.endpoint import endpoint

    return endpoint(text)


def open_outlets(options: argparse.Namespace, rig: Rig, stack: ExitStack) -> tuple[Outlet, ...]:
    """Open those that were asked for; ``stack`` closes them."""
    opened: list[Outlet] = []

    def add(outlet: Outlet) -> None:
        stack.callback(outlet.close)
        opened.append(outlet)

    if options.rerun:
        from asterism.server.service.live_view import LiveView

        add(LiveView(rig))
    if options.mavlink:
        from asterism.server.service.mavlink.outlet import Mavlink

        add(Mavlink(rig, options.mavlink))
    return tuple(opened)
