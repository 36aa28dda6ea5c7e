"""asterism calibrate z: physical refit of a rig, then the super-plane for Z, from surveyed poses."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.camera import parse_camera
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, angle_between
from asterism.protocol.rig import Rig, Robot, load_rig
from asterism.protocol.rig_files import report_path
from asterism.protocol.sensor_part import whole_of
from asterism.protocol.yaml_file import parse_yaml
from asterism.protocol.z_correction import ZCorrection
from asterism.server.budget.uncertainty import LedError
from asterism.server.budget.uncertainty_file import check_uncertainty_file, write_uncertainty_file
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.leds.observations import observe
from asterism.server.calibration.lens.camera_file import refit_report_text
from asterism.server.calibration.result_file import check_result_file, write_result_file
from asterism.server.calibration.rewrite import Value, number, rewrite, without
from asterism.server.calibration.rig_texts import RigTexts, check_rig_files, told_of
from asterism.server.calibration.survey.refit import Refit, refit
from asterism.server.calibration.survey.super_plane import LEAST_GAIN, SuperPlane, choose_plane
from asterism.server.calibration.survey.survey import read_survey
from asterism.server.calibration.survey.surveyed import Pairs, check_spread, check_survey, pair
from asterism.server.calibration.survey.surveyed_fit import errors_of
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.calibrate import TRUTH, add_source_and_out
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.progress import progress, working
from asterism.server.service.say import say
from asterism.server.sources.open_source import refuse_endless

EXAMPLES = (
    "asterism calibrate z rig.yaml frames/ --truth surveyed.jsonl -o rig2.yaml\n"
    "asterism calibrate z rig.yaml frames/ --truth surveyed.jsonl --no-plane -o rig2.yaml\n"
)

FEWEST_POSES = 20
DIGITS = 9  # of the z_correction's shares
UNDETERMINED = 0.9  # of a prior's sigma: a parameter that the poses leave as open as it was


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_source_and_out(part, "rig.yaml")
    part.add_argument("--truth", metavar="TRUTH", type=Path, required=True, help=TRUTH)
    part.add_argument("--no-refit", action="store_true", help="leave camera and LED positions as they are")
    part.add_argument("--no-plane", action="store_true", help="no super-plane")


def run(options: argparse.Namespace) -> int:
    """Refit, choose the super-plane, print what held-out poses gain, write the rig and its camera."""
    if options.no_refit and options.no_plane:
        raise InputError("--no-refit and --no-plane: leave nothing to do, expected one of them at most")
    check_result_file(options.out, options.force)
    camera_out = options.out.with_name(f"{options.out.stem}-camera.yaml")
    if not options.no_refit:
        check_result_file(camera_out, options.force)
        check_result_file(report_path(camera_out), options.force)
    check_uncertainty_file(options.out, options.force)
    refuse_endless(options.source, "calibrate z")
    given, source = open_fitting(options.source, load_rig(options.rig), say, options.topic)
    check_rig_files(given, options.out, options.force)
    rig = replace(given, z_correction=None)
    survey = read_survey(options.truth, [robot.id for robot in rig.robots])
    warm_up(*localizing(rig))
    seen = [
        (frame.name, sightings)
        for frame, sightings in progress(observe(source.frames(), rig), source.length, "localizing")
    ]
    paired = pair(survey, seen, source.name)
    check_survey(paired.pairs, rig, survey.name, FEWEST_POSES)
    check_spread(paired.pairs, survey.name)
    with working("fitting lens, LEDs and poses, each pose held out in its turn"):
        found = refit(rig, paired.pairs)
    for remark in paired.remarks:
        say(remark)
    kept = found.better and not options.no_refit
    new = found.rig if kept else rig
    used = [p for p, good in zip(paired.pairs, found.fit.used, strict=True) if good]
    with working("choosing the super-plane"):
        plane = None if options.no_plane else super_plane(new, used)
    correction = plane.correction if plane is not None else None
    _tell(found, rig, options.no_refit, plane, used)

    seen_robots = [robot for robot in rig.robots if _seen(robot.id, used)] if kept else []
    texts = RigTexts.of(given, options.rig).rewritten(_changes(new, seen_robots))
    texts = replace(texts, text=with_correction(texts.text, correction, len(used)))
    camera_text = refitted_text(rig, new) if kept else rig.camera_text
    texts.check(camera_text, options.out)
    olds, beside = [], []
    if kept:
        beside = [camera_out, report_path(camera_out)]
        written = parse_camera(camera_text, str(camera_out))
        # Of a part of the sensor to all of it: as much larger as its pixels are.
        larger = np.concatenate([np.full(4, rig.capture.binning or 1), np.ones(len(found.lens_covariance) - 4)])
        covariance = found.lens_covariance * np.outer(larger, larger)
        report = refit_report_text(written, covariance, f"{options.source}, {options.truth}", len(used))
        olds += [
            write_result_file(path, each, options.force)
            for path, each in zip(beside, (camera_text, report), strict=True)
        ]
    written_rig = texts.write(options.out, options.force, camera_out if kept else None)
    olds += [old for _, old in written_rig]
    print(f"written: {', '.join(str(path) for path in (options.out, *beside))}")
    for line in told_of(written_rig, rig)[1:]:
        print(line)
    known = {robot: LedError(sigma, 0.0, "calibrate z") for robot, sigma in found.led_sigmas.items()} if kept else {}
    for line in write_uncertainty_file(Path(options.rig), options.out, known, options.force, new_lens=kept):
        print(line)
    if any(olds):
        print(f"kept beside: {', '.join(str(old) for old in olds if old)}")
    return 0


def super_plane(rig: Rig, pairs: Pairs) -> SuperPlane:
    """The super-plane for what is left of Z's error of surveyed poses."""
    solved = solve_sightings(rig, [sighting for sighting, _ in pairs])
    away, _ = errors_of(pairs, rig, solved)
    answers = [answer for answer in solved if answer is not None]
    places = np.array([pose.position for pose, _ in answers])
    variances = np.array([covariance[2, 2] for _, covariance in answers])
    return choose_plane(places, -away[np.isfinite(away[:, 2]), 2], variances)


def with_correction(text: str, correction: ZCorrection | None, poses: int) -> str:
    """The rig's text with its z_correction replaced, or without any."""
    text = without(text, "z_correction")
    if correction is None:
        return text

    def row(values: Floats) -> str:
        return "[" + ", ".join(number(value) for value in (values.round(DIGITS) + 0.0).tolist()) + "]"

    rows = "".join(f"    - {row(values)}\n" for values in correction.spread)
    return (
        text.rstrip("\n")
        + f"\nz_correction:   # by asterism calibrate z, from {poses} surveyed poses; shares of Z, camera's frame\n"
        f"  kind: {correction.kind}\n  centre: {row(correction.centre)}   # of X / Z, Y / Z, 1 / Z\n"
        f"  scale: {row(correction.scale)}\n  coefficients: {row(correction.coefficients)}\n"
        f"  spread:   # Cholesky factor of the coefficients' covariance\n{rows}"
        f"  region: {number(round(correction.region, DIGITS))}   # where it is less certain, it fades\n"
        f"  most: {number(round(correction.most, DIGITS))}\n  misfit: {number(round(correction.misfit, DIGITS))}\n"
    )


def _seen(robot: str, pairs: Pairs) -> bool:
    return any(sighting.robot == robot for sighting, _ in pairs)


def _changes(new: Rig, robots: list[Robot]) -> dict[tuple[str, ...], Value]:
    changes: dict[tuple[str, ...], Value] = {
        ("robots", robot.id, "leds"): (new.robot(robot.id).leds.round(7) + 0.0).tolist() for robot in robots
    }
    if robots and new.T_world_camera is not None:
        world = new.T_world_camera
        changes[("world",)] = {
            "position": (world.position.round(7) + 0.0).tolist(),
            "orientation": (world.orientation.round(9) + 0.0).tolist(),
        }
    return changes


def refitted_text(rig: Rig, new: Rig) -> str:
    """The camera file with the refitted lens: of the whole sensor, as the one that it replaces."""
    camera, before = new.camera, parse_camera(rig.camera_text, "camera.yaml")
    if (before.width, before.height) != (camera.width, camera.height):
        binning = rig.capture.binning or 1
        matrix = whole_of(camera.matrix, rig.capture.offset or (0, 0), (binning, binning))
        camera = replace(before, matrix=matrix, distortion=camera.distortion)
    values = parse_yaml(rig.camera_text, "camera.yaml").values
    coefficients = len(values["distortion_coefficients"]["data"])
    changes: dict[tuple[str, ...], Value] = {
        ("camera_matrix", "data"): (camera.matrix.ravel().round(5) + 0.0).tolist(),
        ("distortion_coefficients", "data"): (camera.distortion[:coefficients].round(9) + 0.0).tolist(),
    }
    if "projection_matrix" in values:
        projection = np.array(values["projection_matrix"]["data"], np.float64).reshape(3, 4)
        # Of an image that nobody rectifies it repeats the camera's matrix; otherwise it is another camera's.
        if np.allclose(projection[:, :3], before.matrix, atol=1e-3):
            projection[:, :3] = camera.matrix.round(5)
            changes[("projection_matrix", "data")] = (projection.ravel() + 0.0).tolist()
    return rewrite(rig.camera_text, changes, "camera.yaml")


def _tell(found: Refit, rig: Rig, no_refit: bool, plane: SuperPlane | None, pairs: Pairs) -> None:
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("", "x mm", "y mm", "z mm", "angle deg"):
        table.add_column(name, justify="right" if name else "left", no_wrap=True)
    used = found.fit.used
    rows = [("as given", found.before)] + ([] if no_refit else [("refit, held out", found.after)])
    for name, (away, turned) in rows:
        rms = 1e3 * np.sqrt(np.nanmean(away[used] ** 2, axis=0))
        table.add_row(name, *(f"{value:.3f}" for value in rms), f"{np.degrees(np.nanmedian(turned[used])):.3f}")
    console.print(
        f"errors of {used.sum()} surveyed poses, camera's axes (RMS; angle: median)"
        + (f"; {(~used).sum()} are far off what the others say and left out" if not used.all() else ""),
        highlight=False,
    )
    console.print(table)
    if not no_refit:
        for line in (
            _refit_lines(found, rig, pairs) if found.better else ["refit: held-out poses do not gain; left out"]
        ):
            console.print(line, highlight=False)
    if plane is not None:
        scores = ", ".join(
            f"{kind} {1e3 * plane.rms_m[kind]:.3f} mm ({score:.3%} of Z)" for kind, score in plane.scores.items()
        )
        console.print(f"error of Z at distances left out of the fit (RMS): {scores}", highlight=False)
        z = [sighting.pose.position[2] for sighting, _ in pairs]
        correction = plane.correction
        console.print(
            f"z_correction: not needed, neither plane nor quadric gains {LEAST_GAIN:.0%}"
            if correction is None
            else f"z_correction: {correction.kind}, surveyed at Z from {min(z):.2f} to {max(z):.2f} m; elsewhere it "
            "fades to nothing, and poses are flagged `extrapolated`",
            highlight=False,
        )


def _refit_lines(found: Refit, rig: Rig, pairs: Pairs) -> list[str]:
    old, new, sigmas = rig.camera, found.rig.camera, found.lens_sigmas
    names = coefficient_names(old.model, len(old.distortion))
    change = [
        f"f {old.focal_px:.2f} -> {new.focal_px:.2f} +- {sigmas[0]:.3f} px",
        *(
            f"{axis} {old.matrix[k, 2]:.2f} -> {new.matrix[k, 2]:.2f} +- {sigmas[1 + k]:.3f} px"
            for k, axis in enumerate(("cx", "cy"))
        ),
        *(
            f"{name} {before:.5f} -> {after:.5f} +- {sigma:.1g}"
            for name, before, after, sigma in zip(names, old.distortion, new.distortion, sigmas[3:], strict=True)
        ),
    ]
    lines = ["refit: " + ", ".join(change)]
    for robot in rig.robots:
        if _seen(robot.id, pairs):
            away = 1e3 * np.linalg.norm(found.rig.robot(robot.id).leds - robot.leds, axis=1)
            lines.append(f"LEDs of {robot.id} moved by {', '.join(f'{a:.3f}' for a in away)} mm")
    if rig.T_world_camera is not None and found.rig.T_world_camera is not None:
        before, after = rig.T_world_camera, found.rig.T_world_camera
        lines.append(
            f"camera in the world moved by {1e3 * np.linalg.norm(after.position - before.position):.3f} mm and "
            f"{np.degrees(angle_between(after.rotation, before.rotation)):.3f} degrees"
        )
    still_open = [
        name
        for name, sigma, prior in zip(("f", "cx", "cy", *names), sigmas, found.lens_priors, strict=True)
        if sigma > UNDETERMINED * prior
    ]
    if still_open:
        lines.append(f"not determined by these poses, left as they were: {', '.join(still_open)}")
    lines.append(
        f"the survey itself seems to be off by {1e3 * found.fit.sigmas[1]:.3f} mm and "
        f"{np.degrees(found.fit.sigmas[2]):.3f} degrees (one sigma)"
    )
    return lines


def coefficient_names(model: str, count: int) -> tuple[str, ...]:
    """What the distortion's coefficients are called."""
    names = ("k1", "k2", "k3", "k4") if model == "equidistant" else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    return names[:count]
