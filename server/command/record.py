"""asterism record: record what servers publish, by listening to them."""

import argparse
from contextlib import suppress

from asterism.clients.waiting import waited_for
from asterism.clients.watch import check_prefix
from asterism.server.command.shared_arguments import add_client, named
from asterism.server.output import check_folder_of_many
from asterism.server.service.listening import Listening
from asterism.server.service.say import say
from asterism.server.service.stop import Stop, stop_on_signals

EXAMPLES = (
    "asterism record recordings\n"
    "asterism record recordings --connect tcp/192.168.1.2:7447\n"
    "asterism record recordings --prefix replay/\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("folder", metavar="DIR", type=named, help="every camera that is heard gets a new folder in it")
    part.add_argument(
        "--prefix", metavar="PREFIX", default="", help="what stands before every key: replay/ to record a replay"
    )
    add_client(part)


def run(options: argparse.Namespace) -> int:
    """Record until Ctrl-C; exit code 1 if nothing was, or not all that arrived."""
    check_folder_of_many(options.folder)
    check_prefix(options.prefix)
    stop, problems = Stop(), [f"{options.folder}: nothing was recorded: no server was found"]
    with (
        stop_on_signals(stop),
        suppress(KeyboardInterrupt),  # before there was a server
        waited_for(options.connect, options.zenoh, say, stop) as (session, endpoint),
    ):
        say(f"recording into {options.folder} what is published at {endpoint}, which is all but images; Ctrl-C ends it")
        listening = Listening(session, options.folder, options.prefix, endpoint)
        try:
            while not stop():
                listening.step()
        finally:
            problems = listening.close()
    for problem in problems:
        say(problem)
    return int(bool(problems))
