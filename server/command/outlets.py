"""Options of serve that show or hand on what it publishes in other programs' ways, and what each opens."""

import argparse
from contextlib import ExitStack

from asterism.protocol.rig import Rig
from asterism.server.service.outlets import Outlet


def add_outlets(part: argparse.ArgumentParser) -> None:
    """Which outlets there are to be."""
    part.add_argument("--rerun", action="store_true", help="show everything in the rerun viewer while it happens")


def open_outlets(options: argparse.Namespace, rig: Rig, stack: ExitStack) -> tuple[Outlet, ...]:
    """Open those that were asked for; ``stack`` closes them."""
    opened: list[Outlet] = []

    def add(outlet: Outlet) -> None:
        stack.callback(outlet.close)
        opened.append(outlet)

    if options.rerun:
        from asterism.server.service.live_view import LiveView

        add(LiveView(rig))
    return tuple(opened)
