"""asterism calibrate point: a named point of a robot, such as its tool's tip, by pivoting the robot about it."""

import argparse
import math
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.keys import key_problem
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.budget.budget import Poses
from asterism.server.budget.common_causes import common_causes, led_shapes
from asterism.server.budget.uncertainty import Uncertainty, lens_error_of, read_uncertainty
from asterism.server.budget.uncertainty_file import check_uncertainty_file, write_uncertainty_file
from asterism.server.calibration.leds.observations import Sighting, observe
from asterism.server.calibration.lens.lens_error import LensError
from asterism.server.calibration.point.calibration import Known, PointCalibration, calibrate_point
from asterism.server.calibration.result_file import check_result_file
from asterism.server.calibration.rig_texts import RigTexts, check_rig_files, told_of
from asterism.server.calibration.survey.world import without_world
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.calibrate import add_source_and_out
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.progress import progress, working
from asterism.server.service.say import say
from asterism.server.sources.open_source import refuse_endless

EXAMPLES = "asterism calibrate point rig.yaml pivot/ --robot alpha --name tool -o rig2.yaml\n"

DECIMALS = 7  # of positions in m: a tenth of a micrometre
TAG = "asterism calibrate point"
OFTEN_OFF = 2.0  # times farther than told, from which on it is said that LEDs are off


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_source_and_out(part, "rig.yaml")
    part.add_argument("--robot", metavar="ID", required=True, help="which robot")
    part.add_argument("--name", metavar="NAME", required=True, help="of the point, as poses are to carry it")


def run(options: argparse.Namespace) -> int:
    """Fit, write the rig with the point, print it with its standard deviations."""
    check_result_file(options.out, options.force)
    check_uncertainty_file(options.out, options.force)
    refuse_endless(options.source, "calibrate point")
    rig = load_rig(options.rig)
    check_rig_files(rig, options.out, options.force)
    path = _path(options, rig)
    RigTexts.of(rig, options.rig).rewritten({path: [0.0, 0.0, 0.0]})  # whether it can be, before the work
    rig, source = open_fitting(options.source, rig, say, options.topic)
    camera_path = Path(options.rig).parent / parse_yaml(rig.rig_text, options.rig).text("camera")
    uncertainty = read_uncertainty(Path(options.rig), rig.centre, camera_path)
    lens = lens_error_of(rig.camera, camera_path, uncertainty)
    alone = without_world(rig)  # of two tilts the right one is that by which the point rests
    warm_up(*localizing(alone))
    sightings, frames = [], 0
    for _, seen in progress(observe(source.frames(), alone), source.length, "localizing"):
        frames += 1
        sightings += [one for one in seen if one.robot == options.robot]
    with working("fitting the point"):
        found = _fitted(alone, options, sightings, uncertainty, lens)
    point = found.point.round(DECIMALS) + 0.0
    texts = RigTexts.of(rig, options.rig).rewritten({path: point.tolist()})
    texts = texts.annotated(path, f"{TAG} {options.name}", [_comment(found)])
    texts.check(rig.camera_text, options.out)
    written = texts.write(options.out, options.force)
    old = rig.robot(options.robot).points.get(options.name)
    _tell(found, options, frames, old, _shares(found, uncertainty, options.robot, lens))
    for line in _warnings(found, options.robot):
        say(line)
    for line in told_of(written, rig):
        print(line)
    for line in write_uncertainty_file(Path(options.rig), options.out, {}, options.force):
        print(line)
    return 0


def _path(options: argparse.Namespace, rig: Rig) -> tuple[str, ...]:
    """Where the point stands in the rig. Raises InputError for a robot that is not there and a name that cannot be."""
    ids = [robot.id for robot in rig.robots]
    if options.robot not in ids:
        raise InputError(f"--robot {options.robot}: is not in {options.rig}, expected one of {', '.join(ids)}")
    if problem := key_problem(options.name):
        raise InputError(f"--name {options.name!r}: {problem}")
    return ("robots", options.robot, "points", options.name)


def _fitted(
    rig: Rig, options: argparse.Namespace, sightings: list[Sighting], uncertainty: Uncertainty, lens: LensError
) -> PointCalibration:
    robot = rig.robot(options.robot)

    def causes(rotations: Floats, ts: Floats) -> Floats:
        return common_causes(rig, robot, Poses(rotations, ts), uncertainty, lens.covariance)

    known = Known(led_shapes(robot, uncertainty.leds_of(robot.id)), causes, uncertainty.bias_px)
    return calibrate_point(rig, robot.id, sightings, known, options.source)


def _comment(found: PointCalibration) -> str:
    """What the rig says above the point."""
    return (
        f"+- {_mm(found.sigmas)} mm (x y z, one sigma); rests in {found.used.sum()} of {len(found.used)} frames, "
        f"turned by {_turned(found)}"
    )


def _turned(found: PointCalibration) -> str:
    most, least = math.degrees(found.turning.most), math.degrees(found.turning.least)
    return f"{most:.0f} and {least:.0f} degrees (RMS) about two axes"


def _tell(found: PointCalibration, options: argparse.Namespace, frames: int, old: Floats | None, shares: str) -> None:
    """Frames, motion, residuals; the point with its sigmas, beside the ``old`` one; where the sigmas come from."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    out = len(found.used) - int(found.used.sum())
    lines = [
        f"{options.robot} is located in {len(found.used)} of {frames} frames; its point rests at one place in "
        f"{found.used.sum()}"
        + (f", the other {out} are left out: it had slipped, or was not there yet" if out else "")
        + (f"; in {found.other_tilt} by the less likely of two tilts" if found.other_tilt else ""),
        f"turned by {_turned(found)}",
        f"single frames have the point {1e3 * found.rms_m[0]:.3f} mm from that place across the line of sight and "
        f"{1e3 * found.rms_m[1]:.3f} mm along it (RMS)"
        + (f", of which {1e3 * found.play_m:.3f} mm an axis are play that no noise explains" if found.play_m else ""),
        f"from one tenth of the film to the next the place wanders by {1e3 * found.wander_m:.3f} mm (RMS, noise taken "
        f"off): {'more than by chance, so sigmas are larger' if found.wanders else 'no more than by chance'}",
    ]
    console.print("\n".join(lines), highlight=False, markup=False)
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("point", "x mm", "y mm", "z mm", "sigma x", "sigma y", "sigma z"):
        table.add_column(name, justify="left" if name == "point" else "right", no_wrap=True)
    table.add_row(escape(options.name), *_mm(found.point).split(), *_mm(found.sigmas).split())
    if old is not None:
        table.add_row("was", *_mm(old).split())
        table.add_row("moved by", *(f"{value:+.4f}" for value in 1e3 * (found.point - old)))
    console.print(table)
    console.print(shares, highlight=False, markup=False)


def _shares(found: PointCalibration, uncertainty: Uncertainty, robot: str, lens: LensError) -> str:
    """Where the standard deviations come from."""
    leds = uncertainty.leds_of(robot)
    noise = np.sqrt(np.diag(found.by_noise))
    told = lens.told_by if lens.told_by == "assumed" else f"by {lens.told_by}"
    return (
        f"of that the spots' noise: {_mm(noise)} mm; the rest is what all frames share: LEDs "
        f"{1e3 * leds.position_m:.2g} mm off an axis ({leds.by}), the lens ({told})"
    )


def _warnings(found: PointCalibration, robot: str) -> list[str]:
    out = []
    if found.leds_off > OFTEN_OFF:
        out.append(
            f"warning: the LEDs of {robot} seem to be off {found.leds_off:.1f} times as far as the rig's uncertainty "
            "has it; sigmas allow for it, but asterism calibrate leds first gives a better point"
        )
    return out


def _mm(values: Floats) -> str:
    return " ".join(f"{value:.4f}" for value in 1e3 * values + 0.0)
