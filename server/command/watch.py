"""asterism watch: a live table of every robot."""

import argparse

from asterism.clients.watch import watch
from asterism.server.command.shared_arguments import add_client

EXAMPLES = (
    "asterism watch\n"
    "asterism watch alpha bravo\n"
    "asterism watch --prefix replay/\n"
    "asterism watch --json --connect tcp/192.168.1.2:7447\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("robots", metavar="ID", nargs="*", help="only these robots")
    part.add_argument(
        "--prefix", metavar="PREFIX", default="", help="what stands before every key: replay/ to watch a replay"
    )
    part.add_argument("--json", action="store_true", help="every frame and event as a line of JSON")
    add_client(part)


def run(options: argparse.Namespace) -> int:
    """Watch until Ctrl-C."""
    watch(options.robots, options.connect, options.zenoh, options.prefix, options.json)
    return 0
