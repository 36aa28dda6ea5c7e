"""asterism watch: a live table of every robot."""

import argparse

from asterism.clients.watch import watch


def run(options: argparse.Namespace) -> int:
    """Watch until Ctrl-C."""
    watch(options.robots, options.connect, options.zenoh)
    return 0
