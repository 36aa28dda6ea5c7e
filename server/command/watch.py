"""asterism watch: a live table of every robot."""

import argparse

from asterism.clients.watch import watch
from asterism.server.command.shared_arguments import add_client

EXAMPLES = "asterism watch\nasterism watch alpha bravo\n"


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("robots", metavar="ID", nargs="*", help="only these robots")
    add_client(part)


def run(options: argparse.Namespace) -> int:
    """Watch until Ctrl-C."""
    watch(options.robots, options.connect, options.zenoh)
    return 0
