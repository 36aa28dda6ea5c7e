"""asterism calibrate KIND: what the kinds of calibration have in common. Each kind has a module of its own."""

import argparse

from asterism.server.command.parser import module_of
from asterism.server.command.shared_arguments import FINITE_SOURCE, add_out, add_topic

EXAMPLES = (
    "asterism calibrate camera frames/ --target chessboard:9x6:0.025 -o camera.yaml\n"
    "asterism calibrate leds rig.yaml film/ --robot alpha --distance 0,3=0.0862 -o rig2.yaml\n"
    "asterism calibrate world rig.yaml frames/ --truth points.jsonl -o rig2.yaml\n"
)

SUBCOMMANDS = {
    "camera": "the camera's lens model from views of a planar target",
    "leds": "a robot's six LED positions from a film of it moved about",
    "world": "T_world_camera from a target on the floor, robots at surveyed points, or what is fixed",
    "cameras": "where several cameras stand in one world, from robots that two or more of them see",
    "offset": "how far LEDs seem to move with the angle they are seen at",
    "point": "a point of a robot, such as its tool's tip, by pivoting the robot about it",
    "surface": "the surface that robots drive on, from their poses",
    "z": "physical refit of the rig, then the super-plane for Z, from surveyed poses",
}

TARGET = "KIND:COLSxROWS:PITCH, PITCH in m: chessboard (inner corners), circles, acircles, charuco; or leds:BOARD.yaml"
TRUTH = "surveyed poses: JSON lines as `asterism locate` writes them, or a spreadsheet's CSV"


def add_source_and_out(part: argparse.ArgumentParser, out: str) -> None:
    """The arguments of every kind that has a rig; ``out`` is what is written."""
    part.add_argument("rig", metavar="RIG", help="rig.yaml")
    part.add_argument("source", metavar="SOURCE", help=FINITE_SOURCE)
    add_topic(part)
    add_out(part, out, "what is written")


def run(options: argparse.Namespace) -> int:
    """Run the kind that is asked for."""
    code: int = module_of(f"calibrate {options.kind}").run(options)
    return code
