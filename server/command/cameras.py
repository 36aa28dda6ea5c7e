"""asterism cameras: what cameras there are, and how to name each as SOURCE."""

import argparse
import shutil
import textwrap
from collections.abc import Sequence

from asterism.protocol.program import typed
from asterism.server.sources.listing import Found, genicam_cameras, v4l2_cameras

EXAMPLES = "asterism cameras\n"

LEAST_WIDTH = 60  # of a text that is wrapped; names are never


def add_arguments(part: argparse.ArgumentParser) -> None:
    """None beside those of every command."""


def run(_options: argparse.Namespace) -> int:
    """Print every camera with its name, sizes, rates and formats; where there is none, where was looked for it."""
    genicam, problem = genicam_cameras()
    for line in told(v4l2_cameras(), genicam, problem, shutil.get_terminal_size().columns):
        print(line)
    return 0


def told(v4l2: Sequence[Found], genicam: Sequence[Found], genicam_problem: str, width: int) -> list[str]:
    """What is printed, in lines of at most ``width`` letters; a name stands alone in its line, however long it is."""
    lines = [line for found in (*v4l2, *genicam) for line in _told(found, width)]
    remarks = []
    if not v4l2:
        remarks.append("no V4L2 camera: there is no /dev/video* that gives images; is it plugged in?")
    if genicam_problem:
        remarks.append(f"no GenICam camera: {genicam_problem}")
    elif not genicam:
        remarks.append(
            "no GenICam camera: none answers on this machine's networks or USB; is it switched on, and its address in "
            "the same network?"
        )
    for remark in remarks:
        lines += _wrapped(remark, "", width)
    if usable := next((found.name for found in (*v4l2, *genicam) if not found.problem), ""):
        lines += [*([""] if remarks else []), "to localize what it sees:", f"  {typed('serve', 'rig.yaml', usable)}"]
    return lines


def _told(found: Found, width: int) -> list[str]:
    lines = [found.name, *_wrapped(found.what, "  ", width)]
    for text in (*found.offers, *filter(None, [found.problem])):
        lines += _wrapped(text, "  ", width)
    return [*lines, ""]


def _wrapped(text: str, indent: str, width: int) -> list[str]:
    return textwrap.wrap(
        text,
        max(width, LEAST_WIDTH),
        initial_indent=indent,
        subsequent_indent=f"{indent}  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
