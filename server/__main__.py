"""The command line: `asterism COMMAND ...`. Only what a command needs is imported, so `--help` is there at once."""

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from asterism import __version__
from asterism.protocol.errors import InputError, WorldError
from asterism.server.command.calibration_arguments import add_calibration
from asterism.server.command.number_arguments import count, number, positive

_EXAMPLES = """\
asterism demo                                     five simulated robots: localized, published, recorded, watched
asterism serve rig.yaml /dev/video0               localize what a camera sees
asterism locate rig.yaml frames/ -o poses.jsonl   poses of a folder of images
asterism watch                                    live table of every robot
asterism review RECORDING                         look at a recording in the rerun viewer
"""

_SOURCE = "a camera (0, /dev/video0), a folder or glob of images, a video, a recording, or sim"
_ENDPOINT = "a zenoh endpoint such as tcp/127.0.0.1:7447"


class _Parser(argparse.ArgumentParser):
    """Help begins with lines to copy; a wrong argument gets one sentence."""

    examples = ""

    def format_help(self) -> str:
        return f"{self.examples}\n{super().format_help()}" if self.examples else super().format_help()

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="asterism", description="One camera, several robots with six LEDs each.")
    parser.examples = _EXAMPLES
    parser.add_argument("--version", action="version", version=f"asterism {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)

    def command(name: str, summary: str, examples: str) -> argparse.ArgumentParser:
        part = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        part.examples = examples
        return part

    def network(part: argparse.ArgumentParser, server: bool) -> None:
        if server:
            part.add_argument("--listen", metavar="EP", help="listen there instead of tcp/127.0.0.1:7447")
            part.add_argument("--connect", metavar="EP", help="join the zenoh router there, as a client")
        else:
            part.add_argument("--connect", metavar="EP", help=f"where the server is: {_ENDPOINT}")
        part.add_argument("--zenoh", metavar="FILE", type=Path, help="any zenoh options, as JSON5")

    def smoothing(part: argparse.ArgumentParser) -> None:
        part.add_argument(
            "--smooth", action="store_true", help="join poses to those before by a motion model, and label them so"
        )

    demo = command(
        "demo",
        "simulated camera, five robots on a curved surface: serve, record, watch",
        "asterism demo\nasterism demo --seconds 5 --record /tmp\n",
    )
    demo.add_argument("--seconds", metavar="N", type=positive, default=20.0, help="how long (default: 20)")
    demo.add_argument("--forever", action="store_true", help="until Ctrl-C")
    demo.add_argument(
        "--record", metavar="DIR", type=Path, default=Path("recordings-demo"), help="default: recordings-demo"
    )
    smoothing(demo)
    network(demo, server=True)

    serve = command(
        "serve",
        "localize the robots that a source shows, publish their poses",
        "asterism serve rig.yaml /dev/video0 --record recordings\n"
        "asterism serve rig.yaml frames/ --rate 60\n"
        "asterism serve rig.yaml sim --rerun\n",
    )
    serve.add_argument("rig", metavar="RIG", help="rig.yaml")
    serve.add_argument("source", metavar="SOURCE", help=_SOURCE)
    serve.add_argument("--rate", metavar="HZ", type=positive, help="play images or a video at this rate")
    serve.add_argument("--record", metavar="DIR", type=Path, help="record into a new folder in DIR")
    serve.add_argument(
        "--record-frames",
        metavar="all|N|none",
        type=_every,
        default=1,
        help="every frame, every Nth, none (default: all)",
    )
    serve.add_argument("--rerun", action="store_true", help="show everything in the rerun viewer while it happens")
    smoothing(serve)
    network(serve, server=True)

    locate = command(
        "locate",
        "poses of a folder of images, a video or a recording, as JSON lines",
        "asterism locate rig.yaml frames/ -o poses.jsonl\n"
        "asterism locate rig.yaml 'frames/*.png' -o poses.jsonl --independent\n",
    )
    locate.add_argument("rig", metavar="RIG", help="rig.yaml")
    locate.add_argument("source", metavar="SOURCE", help="a folder or glob of images, a video, or a recording")
    locate.add_argument(
        "-o", "--out", metavar="OUT", type=Path, required=True, help="where the lines go; - for the terminal"
    )
    locate.add_argument("--independent", action="store_true", help="each frame alone, without what came before")
    smoothing(locate)

    watch = command(
        "watch",
        "live table of every robot, its age, its state",
        "asterism watch\nasterism watch alpha bravo\n",
    )
    watch.add_argument("robots", metavar="ID", nargs="*", help="only these robots")
    network(watch, server=False)

    replay = command(
        "replay",
        "publish a recording again with its timing, every key behind replay/",
        "asterism replay RECORDING\nasterism replay RECORDING --speed 0.5 --loop\n"
        "asterism replay RECORDING --solve rig.yaml\n",
    )
    replay.add_argument("recording", metavar="RECORDING", type=Path, help="a recording's folder")
    replay.add_argument("--speed", metavar="X", type=positive, default=1.0, help="times faster (default: 1)")
    replay.add_argument("--loop", action="store_true", help="again and again, until Ctrl-C")
    replay.add_argument("--solve", metavar="RIG", help="solve the recorded frames again, with this rig")
    replay.add_argument(
        "--as-live",
        action="store_true",
        help="under the original keys; refused while that camera's server is alive",
    )
    network(replay, server=True)

    review = command(
        "review",
        "look at a recording in the rerun viewer",
        "asterism review RECORDING\nasterism review RECORDING -o recording.rrd\n",
    )
    review.add_argument("recording", metavar="RECORDING", type=Path, help="a recording's folder")
    review.add_argument("-o", "--out", metavar="FILE.rrd", type=Path, help="write it instead of opening the viewer")

    compare = command(
        "compare",
        "differences of two recordings, per robot and field",
        "asterism compare RECORDING_A RECORDING_B\nasterism compare A B --position 0.0001 --rotation 0.001\n",
    )
    compare.add_argument("a", metavar="A", type=Path, help="a recording's folder")
    compare.add_argument("b", metavar="B", type=Path, help="another")
    compare.add_argument("--position", metavar="M", type=_not_negative, default=1e-6, help="allowed, m (default: 1e-6)")
    compare.add_argument(
        "--rotation", metavar="RAD", type=_not_negative, default=1e-6, help="allowed, rad (default: 1e-6)"
    )

    simulate = command(
        "simulate",
        "frames of simulated robots, with truth",
        "asterism simulate rig.yaml out --frames 300\n"
        "asterism simulate rig.yaml out --hide 0.05 --glints 10 --seed 3\n"
        "asterism simulate rig.yaml film --hand alpha --frames 300\n",
    )
    simulate.add_argument("rig", metavar="RIG", help="rig.yaml")
    simulate.add_argument("out", metavar="OUT", type=Path, help="a new folder")
    simulate.add_argument("--frames", metavar="N", type=count, default=60, help="how many (default: 60)")
    simulate.add_argument("--rate", metavar="HZ", type=positive, help="default: the rig's capture.rate, or 60")
    simulate.add_argument("--seed", metavar="N", type=int, default=0, help="default: 0")
    simulate.add_argument(
        "--hide", metavar="P", type=_share, default=0.0, help="probability that an LED is hidden (default: 0)"
    )
    simulate.add_argument(
        "--hand", metavar="ROBOT", help="this robot alone, shown by hand from all sides: a film to calibrate with"
    )
    simulate.add_argument("--glints", metavar="N", type=int, default=0, help="glints a frame (default: 0)")

    recover = command("recover", "make a recording that was cut off readable again", "asterism recover RECORDING\n")
    recover.add_argument("recording", metavar="RECORDING", type=Path, help="a recording's folder")
    add_calibration(command)
    return parser


def _not_negative(text: str) -> float:
    value = number(text)
    if not value >= 0:
        raise argparse.ArgumentTypeError(f"{text}, expected a number, 0 or more")
    return value


def _share(text: str) -> float:
    value = number(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text}, expected a number from 0 to 1")
    return value


def _every(text: str) -> int:
    if text in ("all", "none"):
        return int(text == "all")
    return count(text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 1 the world failed, 2 the user's input is wrong."""
    options = _parser().parse_args(arguments)
    try:
        name = f"calibrate_{options.what}" if options.command == "calibrate" else options.command
        module = importlib.import_module(f"asterism.server.command.{name}")
        code: int = module.run(options)
    except InputError as error:
        print(f"asterism: {error}", file=sys.stderr)
        return 2
    except WorldError as error:
        print(f"asterism: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("asterism"):
            raise
        print(
            f"asterism: {options.command} needs {error.name}; "
            "install it with: pip install 'asterism-localization[all]'",
            file=sys.stderr,
        )
        return 2
    except BrokenPipeError:
        return 1
    except KeyboardInterrupt:
        return 130
    return code


if __name__ == "__main__":
    sys.exit(main())
