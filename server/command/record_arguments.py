"""Arguments of commands that record."""

import argparse

from asterism.recordings.recorder import FramesKept
from asterism.server.command.number_arguments import count
from asterism.server.command.shared_arguments import named


def add_record(part: argparse.ArgumentParser, frames: str) -> None:
    """Where a recording goes, and which ``frames`` are in it unless it is said."""
    part.add_argument("--record", metavar="DIR", type=named, help="record into a new folder in DIR")
    part.add_argument(
        "--record-frames",
        metavar="all|N|spots|none",
        type=_kept,
        default=_kept(frames),
        help=f"every frame, every Nth, of every one the windows around spots, none (default: {frames})",
    )


def _kept(text: str) -> FramesKept:
    if text in ("all", "none", "spots"):
        return FramesKept(int(text != "none"), text == "spots")
    return FramesKept(count(text))
