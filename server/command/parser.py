"""The command line's grammar. Only the module of the command that is asked for is imported."""

import argparse
import importlib
import re
from types import ModuleType
from typing import Any, NoReturn

from asterism import __version__
from asterism.protocol.program import NAME, program
from asterism.server.command.shared_arguments import add_telling

COMMANDS = {
    "demo": "simulated camera, five robots on a curved surface: serve, record, watch",
    "cameras": "what cameras there are, how to name each as SOURCE, their sizes and rates",
    "serve": "localize the robots that a source shows, publish their poses",
    "fuse": "poses of several cameras joined per robot, live from the network or from recordings",
    "reload": "let a running server read its rig and calibration again",
    "locate": "poses of a folder of images, a video or a recording, as JSON lines or a recording",
    "batch": "poses of many films and recordings at once: all cores, or a Dask cluster",
    "watch": "live table of every robot, its age, its state",
    "router": "a zenoh router with our defaults, where cameras and robots of several hosts meet",
    "record": "record what servers publish, by listening to them",
    "replay": "publish a recording again with its timing, every key behind replay/",
    "review": "look at a recording in the rerun viewer",
    "compare": "differences of two recordings, per robot and field",
    "export": "poses as CSV, TUM, Parquet or a ROS 2 bag, for other programs; surveys from spreadsheets",
    "coverage": "where robots' tools have been on the surface: how long, how often, how fast, when",
    "recover": "make a recording that was cut off readable again",
    "example": "a folder to try everything in without hardware, with a README.md to follow",
    "simulate": "frames of simulated robots, with truth",
    "calibrate": "camera, LED positions, world of one or more, LED offset, Z, a tool's tip: find, remove what is off",
    "board": "a calibration board to print, true to scale",
    "report": "the error budget of a rig and its workspace, with plots",
    "design": "constellations that cannot be confused, with a drill plan",
    "doctor": "focus, exposure, clutter, calibration, time stamps: what is wrong, and what to do",
    "check": "how well a rig's robots can be told apart, and what can go wrong",
}

EXAMPLES = """\
asterism demo                                     five simulated robots: localized, published, recorded, watched
asterism serve rig.yaml /dev/video0               localize what a camera sees
asterism locate rig.yaml frames/ -o poses.jsonl   poses of a folder of images
asterism watch                                    live table of every robot
asterism review RECORDING                         look at a recording in the rerun viewer
"""


class Parser(argparse.ArgumentParser):
    """Help begins with lines to copy; a wrong argument gets one sentence."""

    examples = ""

    def format_help(self) -> str:
        """The examples, by the name that this program was started with, then argparse's own help."""
        examples = re.sub(f"^{NAME} ", lambda _: f"{program()} ", self.examples, flags=re.MULTILINE)
        return f"{examples}\n{super().format_help()}" if examples else super().format_help()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """What is not known is refused by the command that it was given to, which has the help for it."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """One sentence and exit code 2."""
        self.exit(2, f"{self.prog}: {message}; see {self.prog.replace(NAME, program(), 1)} --help\n")


def module_of(command: str) -> ModuleType:
    """The module of a command; of `calibrate world` it is `calibrate_world`."""
    return importlib.import_module(f"asterism.server.command.{command.replace(' ', '_')}")


def parser(words: list[str] | None = None) -> Parser:
    """What reads the command line ``words``: the commands that they name have their arguments; without words, all."""
    whole = Parser(prog="asterism", description="Fixed cameras, several robots with six LEDs each.")
    whole.examples = EXAMPLES
    whole.add_argument("--version", action="version", version=f"asterism {__version__}")
    add_commands(whole, COMMANDS, "", words)
    return whole


def add_commands(
    whole: argparse.ArgumentParser, commands: dict[str, str], before: str, words: list[str] | None
) -> None:
    """Add the parts of ``whole``, by name with what they do; ``before`` is the command that they are parts of."""
    dest = "kind" if before else "command"
    parts = whole.add_subparsers(dest=dest, metavar=dest.upper(), required=True, parser_class=Parser)
    for name, summary in commands.items():
        part = parts.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        if words is None or name in words:
            module = module_of(f"{before} {name}".strip())
            part.examples = module.EXAMPLES
            if hasattr(module, "SUBCOMMANDS"):
                add_commands(part, module.SUBCOMMANDS, name, words)
            else:
                module.add_arguments(part)
                add_telling(part)
