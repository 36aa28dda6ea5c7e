"""The arguments of what finds and removes a rig's errors: calibrate, report, design, check."""

import argparse
from collections.abc import Callable
from pathlib import Path

from asterism.server.command.number_arguments import count, positive

Command = Callable[[str, str, str], argparse.ArgumentParser]  # name, summary, examples

_SOURCE = "a folder or glob of images, a video, or a recording"
_TARGET = "KIND:COLSxROWS:PITCH, PITCH in m: chessboard (inner corners), circles, acircles, charuco; or leds:BOARD.yaml"
_TRUTH = "surveyed poses: JSON lines as `asterism locate` writes them"


def add_calibration(command: Command) -> None:
    """Add the parsers to the command line; ``command`` makes one for a name, a summary and examples."""
    _calibrate(command)
    report = command(
        "report",
        "the error budget of a rig and its workspace, with plots",
        "asterism report rig.yaml -o report\nasterism report rig.yaml --truth truth.jsonl frames/ -o report\n",
    )
    report.add_argument("rig", metavar="RIG", help="rig.yaml")
    report.add_argument(
        "--truth", metavar=("TRUTH", "SOURCE"), nargs=2, help=f"measured beside predicted: {_TRUTH}, and {_SOURCE}"
    )
    report.add_argument("-o", "--out", metavar="DIR", type=Path, required=True, help="where page and plots go")

    design = command(
        "design",
        "constellations that cannot be confused, with a drill plan",
        "asterism design --robots 8 --disc 0.1 --spacing 0.02 --distance 1.5 --sigma 0.05 -o plates\n",
    )
    design.add_argument("--robots", metavar="K", type=count, required=True, help="how many constellations")
    design.add_argument("--disc", metavar="M", type=positive, required=True, help="diameter of the plates, m")
    design.add_argument("--spacing", metavar="M", type=positive, required=True, help="between two LEDs at least, m")
    design.add_argument("--distance", metavar="M", type=positive, required=True, help="from the camera at most, m")
    design.add_argument("--sigma", metavar="PX", type=positive, required=True, help="of an LED's centre, px")
    design.add_argument("-o", "--out", metavar="DIR", type=Path, required=True, help="a new folder")

    check = command(
        "check", "how well a rig's robots can be told apart, and what can go wrong", "asterism check rig.yaml\n"
    )
    check.add_argument("rig", metavar="RIG", help="rig.yaml")


def _calibrate(command: Command) -> None:
    calibrate = command(
        "calibrate",
        "camera, LED positions, world, LED offset, Z: find what is off and remove it",
        "asterism calibrate camera frames/ --target chessboard:9x6:0.025 -o camera.yaml\n"
        "asterism calibrate leds rig.yaml film/ --robot alpha --distance 0,3=0.0862 -o rig2.yaml\n"
        "asterism calibrate world rig.yaml frames/ --truth points.jsonl -o rig2.yaml\n",
    )
    kinds = calibrate.add_subparsers(dest="what", metavar="WHAT", required=True)

    def kind(name: str, summary: str, out: str, rig: bool = True) -> argparse.ArgumentParser:
        part: argparse.ArgumentParser = kinds.add_parser(
            name, help=summary, description=summary[0].upper() + summary[1:] + "."
        )
        if rig:
            part.add_argument("rig", metavar="RIG", help="rig.yaml")
        part.add_argument("source", metavar="SOURCE", help=_SOURCE)
        part.add_argument("-o", "--out", metavar=out, type=Path, required=True, help="what is written")
        part.add_argument("--force", action="store_true", help=f"replace {out}; the old one is kept beside it")
        return part

    camera = kind("camera", "the camera's lens model from views of a planar target", "camera.yaml", rig=False)
    camera.add_argument("--target", metavar="TARGET", required=True, help=_TARGET)
    camera.add_argument(
        "--model",
        choices=["auto", "plumb_bob", "rational_polynomial", "equidistant"],
        default="auto",
        help="auto: the one with the least held-out error (default)",
    )

    leds = kind("leds", "a robot's six LED positions from a film of it moved about", "rig.yaml")
    leds.add_argument("--robot", metavar="ID", required=True, help="which robot")
    leds.add_argument(
        "--distance",
        metavar="I,J=METRES",
        type=_distance,
        required=True,
        help="measured between two of its LEDs, counted from 0",
    )

    world = kind("world", "T_world_camera from a target on the floor or robots at surveyed points", "rig.yaml")
    of = world.add_mutually_exclusive_group(required=True)
    of.add_argument("--target", metavar="TARGET", help=_TARGET)
    of.add_argument("--truth", metavar="POINTS", type=Path, help=_TRUTH)

    offset = kind("offset", "how far LEDs seem to move with the angle they are seen at", "led.yaml")
    offset.add_argument("--truth", metavar="TRUTH", type=Path, required=True, help=_TRUTH)
    cover = offset.add_mutually_exclusive_group()
    cover.add_argument(
        "--dome",
        metavar="n,radius,depth",
        type=_numbers(3),
        help="refraction at a dome: index, radius, chip depth, m",
    )
    cover.add_argument(
        "--window", metavar="n,depth", type=_numbers(2), help="refraction at a flat window: index, chip depth, m"
    )

    z = kind("z", "physical refit of the rig, then the super-plane for Z, from surveyed poses", "rig.yaml")
    z.add_argument("--truth", metavar="TRUTH", type=Path, required=True, help=_TRUTH)
    z.add_argument("--no-refit", action="store_true", help="leave camera and LED positions as they are")
    z.add_argument("--no-plane", action="store_true", help="no super-plane")


def _numbers(count: int) -> Callable[[str], tuple[float, ...]]:
    def parse(text: str) -> tuple[float, ...]:
        parts = text.split(",")
        if len(parts) != count:
            raise argparse.ArgumentTypeError(f"{text!r}, expected {count} numbers with commas between them")
        return tuple(positive(part) for part in parts)

    return parse


def _distance(text: str) -> tuple[int, int, float]:
    pair, _, metres = text.partition("=")
    leds = pair.split(",")
    if len(leds) != 2 or not all(led.isdigit() and int(led) < 6 for led in leds) or leds[0] == leds[1] or not metres:
        raise argparse.ArgumentTypeError(
            f"{text!r}, expected I,J=METRES: two LEDs from 0 to 5, and what is between them"
        )
    return int(leds[0]), int(leds[1]), positive(metres)
