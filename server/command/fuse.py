"""asterism fuse: poses of several cameras joined per robot, live from the network or from recordings."""

import argparse
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.server.command.shared_arguments import add_force, named

EXAMPLES = (
    "asterism fuse --connect tcp/192.168.1.2:7447 --connect tcp/192.168.1.3:7447\n"
    "asterism fuse --join tcp/192.168.1.1:7447 --camera left --camera right\n"
    "asterism fuse recordings/left recordings/right -o fused.jsonl\n"
    "asterism fuse recordings -o fused.jsonl --record fused\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument(
        "recordings", metavar="RECORDING", nargs="*", type=Path, help="a camera's recording; none: live from servers"
    )
    part.add_argument(
        "--camera", metavar="NAME", action="append", default=[], help="only this one; may be given for several"
    )
    files = part.add_argument_group("of recordings")
    files.add_argument("-o", "--out", metavar="OUT", type=named, help="where the lines go; - for the terminal")
    files.add_argument("--record", metavar="DIR", type=named, help="record what is joined into a new folder in DIR")
    add_force(files)
    live = part.add_argument_group("live")
    live.add_argument(
        "--connect",
        metavar="EP",
        action="append",
        default=[],
        help="where a camera's server is (default: tcp/127.0.0.1:7447); may be given for several",
    )
    live.add_argument("--listen", metavar="EP", help="listen there instead of tcp/127.0.0.1:7448")
    live.add_argument("--join", metavar="ROUTER", help="hear and speak through the zenoh router there, as a client")
    live.add_argument("--zenoh", metavar="FILE", type=Path, help="any zenoh options, as JSON5")


def run(options: argparse.Namespace) -> int:
    """Fuse recordings where there are any, else what servers publish, until Ctrl-C."""
    if options.recordings:
        refuse_live_options(options)
        from asterism.server.command.fuse_recordings import fuse_recordings

        return fuse_recordings(options)
    if options.out is not None:
        raise InputError("-o is for recordings; expected `asterism fuse RECORDING ... -o OUT`, or neither for live")
    if options.record is not None:
        raise InputError(
            "--record is for recordings; what is joined live is recorded by `asterism record DIR --connect "
            "tcp/127.0.0.1:7448`"
        )
    from asterism.server.command.fuse_live import fuse_live

    return fuse_live(options)


def refuse_live_options(options: argparse.Namespace) -> None:
    """Raises InputError for what has no meaning with recordings, and without a place for the lines."""
    for option in ("connect", "listen", "join", "zenoh"):
        if getattr(options, option):
            raise InputError(f"--{option} is for fusing live; with recordings there is no network")
    if options.out is None and options.record is None:
        raise InputError("nothing is to be written, expected -o OUT for lines, --record DIR for a recording, or both")
