"""Arguments that several commands take, described once."""

import argparse
import json
from pathlib import Path

SOURCE = "a camera (0, /dev/video0), a folder or glob of images, a video, a recording, or sim"
FINITE_SOURCE = "a folder or glob of images, a video, or a recording"


def add_server(part: argparse.ArgumentParser) -> None:
    """Where a command that publishes is to be found."""
    part.add_argument("--listen", metavar="EP", help="listen there instead of tcp/127.0.0.1:7447")
    part.add_argument("--connect", metavar="EP", help="join the zenoh router there, as a client")
    _add_zenoh(part)


def add_client(part: argparse.ArgumentParser) -> None:
    """Where a command that listens finds the server."""
    part.add_argument(
        "--connect", metavar="EP", help="where the server is: a zenoh endpoint such as tcp/127.0.0.1:7447"
    )
    _add_zenoh(part)


def _add_zenoh(part: argparse.ArgumentParser) -> None:
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


def add_recording(part: argparse.ArgumentParser) -> None:
    """The recording that a command reads."""
    part.add_argument("recording", metavar="RECORDING", type=Path, help="a recording's folder")
