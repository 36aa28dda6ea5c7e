"""asterism calibrate world: T_world_camera from robots at surveyed places, a board, or what stands still."""

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.place_error import PlaceError
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.rig_files import report_path
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.budget.uncertainty import Uncertainty, lens_error_of, read_uncertainty
from asterism.server.budget.uncertainty_file import check_uncertainty_file, write_uncertainty_file
from asterism.server.calibration.leds.observations import observe
from asterism.server.calibration.lens.board_points import find_points
from asterism.server.calibration.lens.bundle import View
from asterism.server.calibration.lens.lens_error import LensError
from asterism.server.calibration.lens.targets import parse_target, refuse_symmetric
from asterism.server.calibration.result_file import check_result_file
from asterism.server.calibration.rewrite import Value
from asterism.server.calibration.rig_texts import RigTexts, told_of
from asterism.server.calibration.survey.fixed import fit_fixed, standing_of
from asterism.server.calibration.survey.survey import read_survey
from asterism.server.calibration.survey.surveyed import pair
from asterism.server.calibration.survey.world import WorldFit, fit_world, without_world
from asterism.server.calibration.survey.world_board import fit_board
from asterism.server.calibration.survey.world_lens import RobotError, Shares, with_systematic_errors
from asterism.server.chain.warm_up import FINDING, localizing, warm_up
from asterism.server.command.calibrate import TARGET, TRUTH, add_source_and_out
from asterism.server.command.fitted_rig import fitting
from asterism.server.command.progress import progress, working
from asterism.server.pose.place import apart
from asterism.server.service.say import say
from asterism.server.sources.open_source import open_source, refuse_endless

EXAMPLES = (
    "asterism calibrate world rig.yaml board.png --target chessboard:9x6:0.025 -o rig2.yaml\n"
    "asterism calibrate world rig.yaml frames/ --truth surveyed.jsonl -o rig2.yaml\n"
    "asterism calibrate world rig.yaml frames/ --fixed -o rig2.yaml\n"
)

MOST_ROWS = 40
TILT_ODDS = 10.0  # times worse that the other tilt fits, below which it is said
TURNED_DEG = 5.0  # a survey whose orientations are off by more is probably another frame's


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_source_and_out(part, "rig.yaml")
    of = part.add_mutually_exclusive_group(required=True)
    of.add_argument("--target", metavar="TARGET", help=TARGET)
    of.add_argument("--truth", metavar="POINTS", type=Path, help=TRUTH)
    of.add_argument("--fixed", action="store_true", help="the rig's own constellations that do not move (`fixed`)")


def run(options: argparse.Namespace) -> int:
    """Fit, print the verification samples, write the rig with its `world`."""
    check_result_file(options.out, options.force)
    check_uncertainty_file(options.out, options.force)
    command = "calibrate world"
    refuse_endless(options.source, command)
    rig = fitting(options.source, load_rig(options.rig), say, options.topic)
    camera_path = Path(options.rig).parent / parse_yaml(rig.rig_text, options.rig).text("camera")
    uncertainty = read_uncertainty(Path(options.rig), rig.centre, camera_path)
    lens = lens_error_of(rig.camera, camera_path, uncertainty)
    place = _from_fixed if options.fixed else _from_target if options.target is not None else _from_survey
    T_world_camera, covariance, shares = place(options, rig, lens.covariance, uncertainty)
    position, orientation = T_world_camera.position.round(7) + 0.0, T_world_camera.orientation.round(9) + 0.0
    sigmas = np.sqrt(np.diag(covariance))
    print(
        f"camera in the world: {_row(1e3 * position, 3)} mm, +- {_row(1e3 * sigmas[:3], 3)} mm, "
        f"+- {_row(np.degrees(sigmas[3:]), 3)} degrees (x y z, one sigma)"
    )
    print(_lens_line(np.sqrt(np.diag(shares.lens)), lens, uncertainty, camera_path))
    if shares.robots.any():
        print(
            f"of that the robots' frames and sizes: {_sigmas(np.sqrt(np.diag(shares.robots)))}, by {uncertainty.file}"
        )
    changes: dict[tuple[str, ...], Value] = {
        ("world",): {"position": position.tolist(), "orientation": orientation.tolist()}
    }
    if rig.follows_world:  # which stays
        changes = {
            ("world", key): value.tolist() for key, value in (("position", position), ("orientation", orientation))
        }
    texts = RigTexts.of(rig, options.rig).rewritten(changes)
    texts.check(rig.camera_text, options.out)
    for line in told_of(texts.write(options.out, options.force), rig):
        print(line)
    known = PlaceError(covariance, "calibrate world")
    for line in write_uncertainty_file(Path(options.rig), options.out, {}, options.force, world=known):
        print(line)
    return 0


def _lens_line(sigmas: Floats, lens: LensError, uncertainty: Uncertainty, camera_path: Path) -> str:
    """How much of the standard deviations is the lens', and who says so."""
    share = f"of that the lens: {_sigmas(sigmas)}; "
    numbers = (
        f"f {uncertainty.focal_relative:.3%}, principal point {uncertainty.principal_point_px:g} px, distortion "
        f"{uncertainty.distortion_relative:.1%}"
    )
    if lens.told_by == "assumed":
        return (
            f"{share}ASSUMED: {numbers}, since {camera_path} has no report of its calibration beside it (asterism "
            "calibrate camera writes one) and no uncertainty.yaml says more"
        )
    if lens.told_by == str(uncertainty.file):
        return f"{share}{numbers}, by {lens.told_by}"
    partly = "" if lens.correlated else ", standard deviations only: calibrate anew for how they hang together"
    return f"{share}by {lens.told_by} ({report_path(camera_path)}{partly})"


def _from_survey(
    options: argparse.Namespace, rig: Rig, lens: Floats, uncertainty: Uncertainty
) -> tuple[Pose, Floats, Shares]:
    survey = read_survey(options.truth, [robot.id for robot in rig.robots], orientations=False)
    rig = without_world(rig)
    source = open_source(options.source, rig, say, topic=options.topic)
    warm_up(*localizing(rig))
    seen = [
        (frame.name, sightings)
        for frame, sightings in progress(observe(source.frames(), rig), source.length, "localizing")
    ]
    paired = pair(survey, seen, source.name)
    for remark in paired.remarks:
        say(remark)
    pairs = paired.pairs
    with working("fitting the camera's place"):
        fit, shares = with_systematic_errors(fit_world(pairs, str(options.truth)), rig, lens, robot_errors(uncertainty))
    _tell(fit)
    axes = [fit.T_world_camera.rotation @ s.pose.rotation @ rig.robot(s.robot).axis for s, _ in pairs]
    if np.median([axis[2] for axis in axes]) < 0.0:
        say(
            "warning: the robots' LEDs shine downwards in this world (z is to point up); are x and y of the survey "
            "swapped, or a sign?"
        )
    if fit.survey_sigma_rad > np.radians(TURNED_DEG):
        say(
            f"warning: the surveyed orientations differ from those seen by {np.degrees(fit.survey_sigma_rad):.0f} "
            "degrees (one sigma); are they T_world_robot, x y z w?"
        )
    return fit.T_world_camera, fit.covariance, shares


def robot_errors(uncertainty: Uncertainty) -> dict[str, RobotError]:
    """What is not known of the robots' constellations."""
    return {
        name: RobotError(error.size_relative, error.frame_m, error.tilt_rad, error.turn_rad)
        for name, error in uncertainty.robots.items()
    }


def _tell(fit: WorldFit) -> None:
    """The verification samples with their residuals."""
    console = _console()
    table = Table(box=None, header_style="bold", padding=(0, 1))
    console.print("residuals, mm and degrees, and in mm those of each sample held out (x' y' z'):", highlight=False)
    for name in ("sample", "x", "y", "z", "deg", "x'", "y'", "z'", "" if fit.used.all() else "left out"):
        table.add_column(name, justify="left" if name == "sample" else "right", no_wrap=True)
    order = np.arange(len(fit.samples))
    if len(order) > MOST_ROWS:
        size = np.where(np.isnan(fit.held_out_m), fit.residuals_m, fit.held_out_m)
        order = np.sort(np.argsort(-np.linalg.norm(size, axis=1))[:MOST_ROWS])
        console.print(f"the {MOST_ROWS} of {len(fit.samples)} samples with the largest residuals:", highlight=False)
    for k in order:
        turned = float(np.degrees(np.linalg.norm(fit.residuals_rad[k])))
        table.add_row(
            fit.samples[k].name,
            *(f"{1e3 * value:.3f}" for value in fit.residuals_m[k]),
            "-" if np.isnan(turned) else f"{turned:.3f}",
            *("-" if np.isnan(value) else f"{1e3 * value:.3f}" for value in fit.held_out_m[k]),
            "" if fit.used[k] else "x",
        )
    console.print(table)
    used, held_out = fit.residuals_m[fit.used], fit.held_out_m[fit.used]
    held_out = held_out[np.isfinite(held_out[:, 0])]
    console.print(
        f"{fit.used.sum()} samples, {(~fit.used).sum()} left out; residuals (RMS, x y z): {_rms(used)} mm; each held "
        f"out and predicted from the others: {_rms(held_out) if len(held_out) else 'the others do not suffice'}"
        + (" mm" if len(held_out) else "")
        + f"; the survey itself seems to be off by {1e3 * fit.survey_sigma_m:.3f} mm",
        highlight=False,
    )


def _from_target(options: argparse.Namespace, rig: Rig, lens: Floats, _: Uncertainty) -> tuple[Pose, Floats, Shares]:
    target = parse_target(options.target)
    refuse_symmetric(target)
    source = open_source(options.source, rig, say, topic=options.topic)
    if target.kind == "leds":
        warm_up(*FINDING)
    views, count = [], 0
    for frame in progress(source.frames(), source.length, "looking for the target"):
        count += 1
        seen = find_points(frame.image, target)
        if seen is not None:
            views.append(View(frame.name, seen))
    if not views:
        raise InputError(
            f"{options.source}: the target {options.target} is in none of its {count} frames, expected it whole in one "
            "at least; are columns and rows those of inner corners?"
        )
    with working("fitting the camera's place"):
        fit = fit_board(views, rig.camera, lens)
    console = _console()
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("frame", "residual px", "held out px"):
        table.add_column(name, justify="left" if name == "frame" else "right", no_wrap=True)
    for view, rms, held_out in list(zip(views, fit.rms_px, fit.held_out_px, strict=True))[:MOST_ROWS]:
        table.add_row(view.frame, f"{rms:.3f}", "-" if np.isnan(held_out) else f"{held_out:.3f}")
    console.print(table)
    x, y = views[0].seen.pixels[0]
    console.print(
        f"the target is in {len(views)} of {count} frames; the world's origin is its first point, at ({x:.0f}, "
        f"{y:.0f}) in frame {views[0].frame}, x runs along its first row, z points up from it, to the camera",
        highlight=False,
    )
    return fit.T_world_camera, fit.covariance, Shares(fit.of_lens, np.zeros((6, 6)))


def _from_fixed(
    options: argparse.Namespace, rig: Rig, lens: Floats, uncertainty: Uncertainty
) -> tuple[Pose, Floats, Shares]:
    if not any(robot.T_world_fixed is not None for robot in rig.robots):
        raise InputError(
            f"{options.rig}: no robot is `fixed`, expected at least one constellation that does not move, with where "
            "it is in the world"
        )
    source = open_source(options.source, rig, say)
    alone = without_world(rig)
    warm_up(*localizing(alone))
    seen = [told for _, told in progress(observe(source.frames(), alone), source.length, "localizing")]
    with working("fitting the camera's place"):
        fit = fit_fixed(rig, standing_of(rig, seen, source.name), lens, robot_errors(uncertainty), source.name)
    console = _console()
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("constellation", "frames", "LEDs", "residual px", "off the others mm", "sigmas"):
        table.add_column(name, justify="left" if name == "constellation" else "right", no_wrap=True)
    for row in fit.rows:
        off = ("-", "-") if np.isnan(row.off_m) else (f"{1e3 * row.off_m:.3f}", f"{row.off_sigmas:.1f}")
        table.add_row(row.robot, str(row.frames), str(row.leds), f"{row.rms_px:.3f}", *off)
    console.print(table)
    console.print(f"each alone leaves {fit.spot_px:.3f} px of a spot unexplained", highlight=False)
    if fit.other_tilt < TILT_ODDS:
        say(
            f"warning: one constellation, seen so, has two tilts; the other fits {fit.other_tilt:.1f} times as badly. "
            "The one nearer to where the rig has its camera was taken where that is little; fix another constellation, "
            "or tilt this one"
        )
    assert rig.T_world_camera is not None
    away = apart(rig.T_world_camera, fit.T_world_camera)
    console.print(
        f"the camera is {1e3 * np.linalg.norm(away[:3]):.3f} mm and {np.degrees(np.linalg.norm(away[3:])):.4f} degrees "
        f"from where {options.rig} has it",
        highlight=False,
    )
    return fit.T_world_camera, fit.covariance, fit.shares


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=160)


def _sigmas(values: Floats) -> str:
    return f"{_row(1e3 * values[:3], 3)} mm, {_row(np.degrees(values[3:]), 3)} degrees"


def _row(values: Floats, digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)


def _rms(values: Floats) -> str:
    return _row(1e3 * np.sqrt((values**2).mean(axis=0)), 3)
