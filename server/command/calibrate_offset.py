"""asterism calibrate offset: how far LEDs seem to move with the angle they are seen at."""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import WEIGHTED, parse_offset
from asterism.protocol.program import typed
from asterism.protocol.rig import load_rig
from asterism.server.calibration.leds.observations import observe
from asterism.server.calibration.result_file import check_result_file, write_result_file
from asterism.server.calibration.rewrite import number
from asterism.server.calibration.survey.offset import (
    BAND_DEG,
    FEWEST_POSES,
    UNKNOWN,
    OffsetCalibration,
    calibrate_offset,
    with_offset,
)
from asterism.server.calibration.survey.survey import read_survey
from asterism.server.calibration.survey.surveyed import check_survey, pair
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.calibrate import TRUTH, add_source_and_out
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.progress import progress, working
from asterism.server.service.say import say
from asterism.server.sources.open_source import refuse_endless

EXAMPLES = "asterism calibrate offset rig.yaml tilted/ --truth surveyed.jsonl -o led.yaml\n"

DECIMALS = 9  # of lengths in m
TABLE_DEG = 15
NEAR_AND_FAR = 6  # poses at least, for a row each


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_source_and_out(part, "led.yaml")
    part.add_argument("--truth", metavar="TRUTH", type=Path, required=True, help=TRUTH)


def run(options: argparse.Namespace) -> int:
    """Fit, print what held-out poses gain, write the led.yaml."""
    check_result_file(options.out, options.force)
    refuse_endless(options.source, "calibrate offset")
    rig = load_rig(options.rig)
    survey = read_survey(options.truth, [robot.id for robot in rig.robots])
    rig, source = open_fitting(options.source, rig, say, options.topic)
    warm_up(*localizing(rig))
    seen = [
        (frame.name, sightings)
        for frame, sightings in progress(
            observe(source.frames(), with_offset(rig, UNKNOWN)), source.length, "localizing"
        )
    ]
    paired = pair(survey, seen, source.name)
    check_survey(paired.pairs, rig, survey.name, FEWEST_POSES)
    with working("fitting the offset, each pose held out in its turn"):
        found = calibrate_offset(rig, paired.pairs, options.source)
    for remark in paired.remarks:
        say(remark)
    _tell(found)
    before, after = (1e3 * np.sqrt(np.nanmean(away[found.used] ** 2)) for away, _ in (found.before, found.after))
    print(
        f"poses that it was not fitted to {'gain' if found.helps else 'do not gain'}: {before:.3f} mm off an axis by "
        f"the rig as it is, {after:.3f} mm with the offset"
    )
    if not found.helps:
        # An answer, not a failure: what comes next can go on with the rig as it is.
        print(f"not written: {options.out}" + (" stays as it was" if options.out.exists() else "") + "; keep the rig")
        return 0
    robots = sorted({sighting.robot for sighting, _ in paired.pairs})
    text = led_text(found, options.source, options.truth, robots)
    parse_offset(text, str(options.out))
    if rig.z_correction is not None:
        say(
            f"warning: the z_correction of {options.rig} was fitted without this offset; run "
            f"{typed('calibrate', 'z')} again"
        )
    kept = write_result_file(options.out, text, options.force)
    print(f"written: {options.out}" + (f"; the old one is kept as {kept}" if kept else ""))
    where = rig.robots_name or "the rig.yaml"
    print(f"to use it: led: {{offset: {options.out.name}}} for {', '.join(robots)} in {where} (path from there)")
    return 0


def led_text(found: OffsetCalibration, source: str, truth: object, robots: list[str]) -> str:
    """The led.yaml, with where it comes from."""
    offset = found.offset
    rows = "".join(f"  - {_lengths(row)}\n" for row in offset.doubts)
    near, far = found.distances.min(), found.distances.max()
    return (
        "# Where the light of an LED seems to come from, for a rig's led.offset; by asterism calibrate offset.\n"
        f"# {len(found.angles)} surveyed poses of {', '.join(robots)}: {source}, {truth}\n"
        f"# seen at {near:.2f} to {far:.2f} m; for this camera and its lens\n"
        f"up_to_deg: {np.degrees(offset.up_to_rad):.4f}  # LEDs were seen up to {np.degrees(found.seen_up_to):.1f}\n"
        "# At angles evenly from 0 to there, between axis and line of sight: the shift along the axis, m\n"
        f"shift: {_lengths(offset.values)}\n"
        "# and what it changes by for every metre that the LED is farther than the distance, m\n"
        f"per_metre: {_lengths(offset.per_metre)}\n"
        f"distance: {offset.distance_m:.4f}\n"
        "# The shift may be wrong by each of these, all LEDs alike, one sigma; by m\n"
        f"doubt:\n{rows}"
        "# What a centre is off besides its noise, one sigma, and up to how much light strange to the estimator\n"
        f"scatter_px: {offset.scatter_px:.4f}\n"
        f"strange_px: {offset.strange_px:.3f}\n"
        f"centre: {WEIGHTED}  # these LEDs' centres: weighted means of their light, whatever the rig's centre is\n"
    )


def _lengths(values: Floats) -> str:
    return f"[{', '.join(number(value) for value in (values.round(DECIMALS) + 0.0).tolist())}]"


def _table_degrees(found: OffsetCalibration) -> list[float]:
    largest = float(np.degrees(found.seen_up_to))
    return [*(float(d) for d in range(0, int(largest), TABLE_DEG)), round(largest, 1)]


def _rows(found: OffsetCalibration) -> list[tuple[str, NDArray[np.bool_]]]:
    """Names and poses (n,) of the table's rows: by angle, nearer and farther half, all."""
    degrees = np.degrees(found.angles)
    bands = [(low, low + BAND_DEG) for low in np.arange(0.0, degrees.max(), BAND_DEG)]
    rows = [(f"{low:g} to {high:g} deg", (degrees >= low) & (degrees < high)) for low, high in bands]
    middle = float(np.median(found.distances))
    if found.told_distance and len(degrees) >= NEAR_AND_FAR:
        rows += [(f"up to {middle:.2f} m", found.distances <= middle), ("farther", found.distances > middle)]
    return [*rows, ("all", degrees >= 0.0)]


def _tell(found: OffsetCalibration) -> None:
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("seen at", "poses", "", "x mm", "y mm", "z mm", "angle deg"):
        table.add_column(name, justify="left" if name in ("seen at", "") else "right", no_wrap=True)
    for name, mask in _rows(found):
        here = mask & found.used
        if not here.any():
            continue
        for label, (away, turned) in (("before", found.before), ("after, held out", found.after)):
            rms = 1e3 * np.sqrt(np.nanmean(away[here] ** 2, axis=0))
            table.add_row(
                *((name, str(here.sum())) if label == "before" else ("", "")),
                label,
                *(f"{value:.3f}" for value in rms),
                f"{np.degrees(np.nanmedian(turned[here])):.3f}",
            )
    console.print("errors against the survey, camera's axes (RMS; angle: median):", highlight=False)
    console.print(table)
    if not found.used.all():
        console.print(f"{(~found.used).sum()} poses are far off what the others say; left out", highlight=False)
    console.print("\n".join(_sentences(found)), highlight=False)


def _sentences(found: OffsetCalibration) -> list[str]:
    offset, spread = found.offset, found.spread
    angles = np.radians(_table_degrees(found))
    constant = float(offset.values[0])
    changes, farther = offset.shift(angles) - constant, offset.shift(angles, offset.distance_m + 1.0)
    middle = _sigma_at(found, angles[-2])
    near, far = found.distances.min(), found.distances.max()
    told = [
        f"the survey itself seems to be off by {1e3 * spread.survey_m:.3f} mm and "
        f"{np.degrees(spread.survey_rad):.3f} degrees (one sigma)",
        f"in front: {1e3 * constant:.4f} mm along the axis; what is the same at all angles (+- {1e3 * middle:.4f} mm) "
        "rests on the survey and on where the rig says that the LEDs are: no film without surveyed poses can see it",
        "what changes with the angle: "
        + ", ".join(f"{1e3 * c:+.4f} mm at {np.degrees(a):.3g}" for c, a in zip(changes, angles, strict=True) if a > 0)
        + " degrees; beyond, nobody has looked",
    ]
    if found.told_distance:
        by = 1e3 * (farther - offset.shift(angles))
        told.append(
            f"and with the distance: {by.min():+.4f} to {by.max():+.4f} mm a metre, seen at {near:.2f} to {far:.2f} m"
        )
    else:
        told.append(
            f"all poses are {near:.2f} to {far:.2f} m away: what changes with the distance cannot be told; survey the "
            "robots nearer and farther as well"
        )
    mean = float(np.nanmean(found.weighted[found.used]))
    told.append(
        f"centres scatter by {offset.scatter_px:.3f} px beyond their noise; squared errors of held-out poses by their "
        f"covariances: {mean:.1f} on average, 6 if these are meant"
    )
    return told


def _sigma_at(found: OffsetCalibration, angle: float) -> float:
    """One sigma of the shift, m, at an angle, rad."""
    return float(np.interp(angle, found.offset.angles, found.sigmas))
