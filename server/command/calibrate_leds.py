"""asterism calibrate leds: a robot's six LED positions from a film of it moved about."""

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.constellation import LEDS
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import load_rig
from asterism.server.budget.uncertainty import LedError
from asterism.server.budget.uncertainty_file import check_uncertainty_file, write_uncertainty_file
from asterism.server.calibration.leds.bundle import Adjusted
from asterism.server.calibration.leds.calibration import (
    LedCalibration,
    calibrate_leds,
    given_sigmas,
    moved_by,
    shape_sigma,
    tilt_spread_deg,
)
from asterism.server.calibration.leds.gauge import Gauge
from asterism.server.calibration.result_file import check_result_file
from asterism.server.calibration.rig_texts import RigTexts, check_rig_files, told_of
from asterism.server.chain.frame import Frame
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.calibrate import add_source_and_out
from asterism.server.command.fitted_rig import fitting
from asterism.server.command.number_arguments import positive
from asterism.server.command.progress import progress, working
from asterism.server.service.say import say
from asterism.server.sources.open_source import open_source, refuse_endless

EXAMPLES = "asterism calibrate leds rig.yaml film/ --robot alpha --distance 0,3=0.0862 -o rig2.yaml\n"

DECIMALS = 7  # of positions in m: a tenth of a micrometre
DISTANCE_SIGMA_M = 1e-4  # assumed of the measured distance: calipers between the middles of two LEDs
TAG = "asterism calibrate leds"


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_source_and_out(part, "rig.yaml")
    part.add_argument("--robot", metavar="ID", required=True, help="which robot")
    part.add_argument(
        "--distance",
        metavar="I,J=METRES",
        type=_distance,
        required=True,
        help="measured between two of its LEDs, counted from 0",
    )
    part.add_argument(
        "--frame",
        metavar="I,J",
        type=_two_leds,
        help="LEDs that hold the robot's frame: I stays where the rig has it, J in its direction (default: best fit to "
        "all)",
    )


def _two_leds(text: str) -> tuple[int, int]:
    leds = text.split(",")
    if len(leds) != 2 or not all(led.isdigit() and int(led) < LEDS for led in leds) or leds[0] == leds[1]:
        raise argparse.ArgumentTypeError(f"{text!r}, expected I,J: two LEDs from 0 to {LEDS - 1}")
    return int(leds[0]), int(leds[1])


def _distance(text: str) -> tuple[int, int, float]:
    pair, _, metres = text.partition("=")
    leds = pair.split(",")
    if len(leds) != 2 or not all(led in tuple("012345") for led in leds) or leds[0] == leds[1] or not metres:
        raise argparse.ArgumentTypeError(
            f"{text!r}, expected I,J=METRES: two LEDs from 0 to 5, and what is between them"
        )
    return int(leds[0]), int(leds[1]), positive(metres)


def run(options: argparse.Namespace) -> int:
    """Fit, write the rig with the new positions, print them with their standard deviations."""
    check_result_file(options.out, options.force)
    check_uncertainty_file(options.out, options.force)
    refuse_endless(options.source, "calibrate leds")
    rig = fitting(options.source, load_rig(options.rig), say, options.topic)
    check_rig_files(rig, options.out, options.force)
    ids = [robot.id for robot in rig.robots]
    if options.robot not in ids:
        raise InputError(f"--robot {options.robot}: is not in {options.rig}, expected one of {', '.join(ids)}")
    rounds = iter(("finding the LEDs", "learning where they are", "measuring", "fitting their places"))
    fit = ExitStack()
    quiet = False  # the second round meets the same unreadable images again

    def frames() -> Iterator[Frame]:
        nonlocal quiet
        source = open_source(options.source, rig, (lambda _: None) if quiet else say, topic=options.topic)
        quiet = True
        fit.close()
        yield from progress(source.frames(), source.length, next(rounds))
        fit.enter_context(working(next(rounds)))

    warm_up(*localizing(rig))
    robot = rig.robot(options.robot)
    gauge = Gauge(robot.leds, options.distance, options.frame)
    with fit:
        found = calibrate_leds(rig, options.robot, frames, options.source, gauge)
    adjusted, normal = found.adjusted, robot.T_robot_plane.rotation[:, 2]
    leds = adjusted.leds.round(DECIMALS) + 0.0
    place = ("robots", options.robot, "leds")
    texts = RigTexts.of(rig, options.rig).rewritten({place: leds.tolist()})
    texts = texts.annotated(place, TAG, _comments(adjusted, gauge, normal))
    texts.check(rig.camera_text, options.out)
    written = texts.write(options.out, options.force)
    _tell(found, moved_by(adjusted.leds, robot.leds), tilt_spread_deg(robot, adjusted.views))
    for line in _relative_to(adjusted, gauge, normal):
        print(line)
    for line in told_of(written, rig):
        print(line)
    frame = gauge.frame_sigmas(*given_sigmas(adjusted.leds, gauge.given, normal), normal)
    known = LedError(shape_sigma(adjusted), DISTANCE_SIGMA_M / options.distance[2], "calibrate leds", *frame)
    for line in write_uncertainty_file(Path(options.rig), options.out, {options.robot: known}, options.force):
        print(line)
    return 0


def _comments(adjusted: Adjusted, gauge: Gauge, normal: Floats) -> list[str]:
    """What the rig says above the positions: whose frame they are in, and how far it may be trusted."""
    metres = gauge.distance[2]
    return [
        f"positions among one another +- {1e3 * shape_sigma(adjusted):.4f} mm; scale: LEDs {gauge.distance[0]} and "
        f"{gauge.distance[1]} are {1e3 * metres:g} mm apart",
        f"frame: {_frame(gauge)},",
        _frame_sigmas(adjusted, gauge, normal),
    ]


def _frame(gauge: Gauge) -> str:
    if gauge.anchors is None:
        return "the best fit to the positions that stood here before"
    first, second = gauge.anchors
    return f"LED {first} stays where it stood, LED {second} in its direction, the plate in its plane"


def _frame_sigmas(adjusted: Adjusted, gauge: Gauge, normal: Floats) -> str:
    along, across = given_sigmas(adjusted.leds, gauge.given, normal)
    shift, tilt, turn = gauge.frame_sigmas(along, across, normal)
    return (
        f"which were off by {1e3 * along:.2f} mm an axis in the plate and {1e3 * across:.2f} mm out of it; so the "
        f"frame may be off by {1e3 * shift:.2f} mm, tilted by {np.degrees(tilt):.2f} and turned by "
        f"{np.degrees(turn):.2f} "
        "degrees (one sigma)"
    )


def _relative_to(adjusted: Adjusted, gauge: Gauge, normal: Floats) -> list[str]:
    """What the numbers are relative to: shape, frame, scale."""
    block = np.kron(np.eye(LEDS), normal)
    off = np.sqrt(np.diag(block @ adjusted.covariance @ block.T))
    first, second, metres = gauge.distance
    anchor = "" if gauge.anchors else "; --frame I,J holds it on two LEDs instead"
    return [
        f"shape: the LEDs among one another are known to {1e3 * shape_sigma(adjusted):.4f} mm an axis (off the plane: "
        f"{1e3 * off.max():.4f} mm); the sigmas above are relative to frame and scale:",
        f"frame: {_frame(gauge)}, {_frame_sigmas(adjusted, gauge, normal)}{anchor}",
        f"scale: from the distance of LEDs {first} and {second}, whose error it shares ({1e3 * DISTANCE_SIGMA_M:g} mm "
        f"there, which is assumed, is {DISTANCE_SIGMA_M / metres:.2%} of every pose's distance)",
    ]


def _tell(found: LedCalibration, moved: np.ndarray, spread: tuple[float, float]) -> None:
    adjusted = found.adjusted
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    console.print(
        f"{found.complete} of {found.frames} frames show all six LEDs; {len(adjusted.views)} views used, "
        f"{adjusted.left_out} centres left out; tilt varies by {spread[0]:.0f} and {spread[1]:.0f} degrees (one "
        f"sigma); residuals {np.sqrt(adjusted.chi2_per_dof):.2f} times the centres' noise",
        highlight=False,
    )
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("LED", "x mm", "y mm", "z mm", "sigma x", "sigma y", "sigma z", "moved by mm"):
        table.add_column(name, justify="right", no_wrap=True)
    for led, (place, sigma, away) in enumerate(zip(adjusted.leds, adjusted.sigmas, moved, strict=True)):
        table.add_row(
            str(led),
            *(f"{1e3 * value:.4f}" for value in place),
            *(f"{1e3 * value:.4f}" for value in sigma),
            f"{1e3 * away:.3f}",
        )
    console.print(table)
