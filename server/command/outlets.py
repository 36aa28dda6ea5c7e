"""Options of serve that show or hand on what it publishes in other programs' ways, and what each opens."""

import argparse
from contextlib import ExitStack

from asterism.protocol.rig import Rig
from asterism.server.command.number_arguments import port
from asterism.server.service.outlets import Outlet

WEB_PORT = 9090  # rerun's own
FOXGLOVE_PORT = 8765  # what Foxglove and PlotJuggler propose


def add_outlets(part: argparse.ArgumentParser) -> None:
    """Which outlets there are to be."""
    part.add_argument("--rerun", action="store_true", help="show everything in the rerun viewer while it happens")
    part.add_argument(
        "--web",
        metavar="PORT",
        type=port,
        nargs="?",
        const=WEB_PORT,
        help=f"the same in a browser, at http://127.0.0.1:PORT (default: {WEB_PORT}; uses PORT + 1 too)",
    )
    part.add_argument(
        "--foxglove",
        metavar="PORT",
        type=port,
        nargs="?",
        const=FOXGLOVE_PORT,
        help=f"for Foxglove and PlotJuggler, at ws://127.0.0.1:PORT (default: {FOXGLOVE_PORT})",
    )


def open_outlets(options: argparse.Namespace, rig: Rig, stack: ExitStack) -> tuple[Outlet, ...]:
    """Open those that were asked for; ``stack`` closes them."""
    opened: list[Outlet] = []

    def add(outlet: Outlet) -> None:
        stack.callback(outlet.close)
        opened.append(outlet)

    if options.rerun or options.web is not None:
        from asterism.server.service.live_view import LiveView

        for words in [()] * options.rerun + [(str(options.web),)] * (options.web is not None):
            add(LiveView(rig, *words))
    if options.foxglove is not None:
        from asterism.server.service.foxglove_outlet import FoxgloveOutlet

        add(FoxgloveOutlet(rig, options.foxglove))
    return tuple(opened)
