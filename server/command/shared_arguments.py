"""Arguments that several commands take, described once."""

import argparse
import json
from pathlib import Path

from asterism.server.command.number_arguments import ros_domain

FILES = "a folder or glob of images, a video, a recording, an MCAP file or a ROS bag"
CAMERA_OR_FILES = f"a camera (0, /dev/video0 or a link, genicam:SERIAL, zenoh:KEY, ros2:TOPIC), {FILES}"
SOURCE = f"{CAMERA_OR_FILES}, or sim"
FINITE_SOURCE = FILES
FORWARD, BOTH_WAYS = "forward", "both"  # of `--smooth`


def add_topic(part: argparse.ArgumentParser) -> None:
    """Which of a file's topics SOURCE is."""
    part.add_argument("--topic", metavar="TOPIC", help="of an MCAP file or a ROS bag, where several hold images")


def add_ros_domain(part: argparse.ArgumentParser) -> None:
    """The domain of ROS 2."""
    part.add_argument(
        "--ros-domain", metavar="N", type=ros_domain, help="of ROS 2, 0 to 232 as in ROS_DOMAIN_ID (default: 0)"
    )


def add_server(part: argparse.ArgumentParser) -> None:
    """Where a command that publishes is to be found."""
    part.add_argument("--listen", metavar="EP", help="listen there instead of tcp/127.0.0.1:7447")
    part.add_argument("--connect", metavar="EP", help="join the zenoh router there, as a client")
    add_zenoh(part)


def add_client(part: argparse.ArgumentParser) -> None:
    """Where a command that listens finds the server."""
    part.add_argument(
        "--connect", metavar="EP", help="where the server is: a zenoh endpoint such as tcp/127.0.0.1:7447"
    )
    add_zenoh(part)


def add_zenoh(part: argparse.ArgumentParser) -> None:
    """What zenoh itself is to be told."""
    part.add_argument("--zenoh", metavar="FILE", type=Path, help="any zenoh options, as JSON5")


def client_words(options: argparse.Namespace) -> list[str]:
    """The arguments with which `watch`, on this machine, finds what was started with the options of `add_server`."""
    from asterism.protocol.network import DEFAULT_ENDPOINT, server_config

    where = options.connect or options.listen
    if where is None and options.zenoh is not None:
        config = server_config(options=options.zenoh)
        kind = "connect" if json.loads(config.get_json("mode")) == "client" else "listen"
        endpoints = json.loads(config.get_json(f"{kind}/endpoints"))
        where = endpoints[0] if isinstance(endpoints, list) and endpoints else None
    return [] if where in (None, DEFAULT_ENDPOINT) else ["--connect", where]


def add_smoothing(part: argparse.ArgumentParser) -> None:
    """Whether poses are joined to those before."""
    part.add_argument(
        "--smooth", action="store_true", help="join poses to those before by a motion model, and label them so"
    )


def add_smoothing_ways(part: argparse.ArgumentParser) -> None:
    """The same where what comes after a frame is known as well."""
    part.add_argument(
        "--smooth",
        metavar="forward|both",
        nargs="?",
        const=FORWARD,
        type=_way,
        help="join poses to those before by a motion model (both: and to those after), and label them so",
    )


def _way(text: str) -> str:
    if text not in (FORWARD, BOTH_WAYS):
        raise argparse.ArgumentTypeError(
            f"{text!r}, expected nothing, {FORWARD} or {BOTH_WAYS}; RIG and SOURCE go before --smooth"
        )
    return text


def add_out(part: argparse.ArgumentParser, metavar: str, what: str, required: bool = True) -> None:
    """What a command writes, and whether it may replace what is there."""
    part.add_argument("-o", "--out", metavar=metavar, type=named, required=required, help=what)
    add_force(part)


def add_force(part: "argparse._ActionsContainer") -> None:
    """Whether a command may replace what is there."""
    part.add_argument("--force", action="store_true", help="replace what is there, keeping the old one as NAME.old-1")


def add_telling(part: argparse.ArgumentParser) -> None:
    """How much a command tells; every command has it."""
    group = part.add_argument_group("what is told")
    how_much = group.add_mutually_exclusive_group()
    how_much.add_argument("--quiet", action="store_true", help="only results and errors")
    how_much.add_argument("--verbose", action="store_true", help="details too, for finding out what is wrong")
    group.add_argument(
        "--log", metavar="FILE", type=named, help="all of it goes into FILE too, with UTC times; what is there stays"
    )


def named(text: str) -> Path:
    """The path of a file or folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r}, expected a name")
    return Path(text)


def add_recording(part: argparse.ArgumentParser) -> None:
    """The recording that a command reads."""
    part.add_argument("recording", metavar="RECORDING", type=Path, help="a recording's folder")
