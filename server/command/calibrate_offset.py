"""asterism calibrate offset: how far LEDs seem to move with the angle they are seen at."""

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.led_offset import parse_offset
from asterism.protocol.program import typed
from asterism.protocol.rig import load_rig
from asterism.server.calibration.leds.observations import observe
from asterism.server.calibration.result_file import check_result_file, write_result_file
from asterism.server.calibration.rewrite import number
from asterism.server.calibration.survey.offset import BAND_DEG, FEWEST_POSES, OffsetCalibration, calibrate_offset
from asterism.server.calibration.survey.survey import read_survey
from asterism.server.calibration.survey.surveyed import check_survey, pair
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.calibrate import TRUTH, add_source_and_out
from asterism.server.command.number_arguments import positives
from asterism.server.command.progress import progress, working
from asterism.server.pose.led_optics import check_cover
from asterism.server.service.say import say
from asterism.server.sources.open_source import open_source, refuse_endless

EXAMPLES = (
    "asterism calibrate offset rig.yaml tilted/ --truth surveyed.jsonl -o led.yaml\n"
    "asterism calibrate offset rig.yaml tilted/ --truth surveyed.jsonl --dome 1.5,0.0025,0.00125 -o led.yaml\n"
)

DECIMALS = 10  # of coefficients in m
TABLE_DEG = 15


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_source_and_out(part, "led.yaml")
    part.add_argument("--truth", metavar="TRUTH", type=Path, required=True, help=TRUTH)
    cover = part.add_mutually_exclusive_group()
    cover.add_argument(
        "--dome",
        metavar="n,radius,depth",
        type=positives(3),
        help="refraction at a dome: index, radius, chip depth, m",
    )
    cover.add_argument(
        "--window", metavar="n,depth", type=positives(2), help="refraction at a flat window: index, chip depth, m"
    )


def run(options: argparse.Namespace) -> int:
    """Fit, print what held-out poses gain, write the led.yaml."""
    check_result_file(options.out, options.force)
    refuse_endless(options.source, "calibrate offset")
    check_cover(options.dome, options.window)
    rig = load_rig(options.rig)
    survey = read_survey(options.truth, [robot.id for robot in rig.robots])
    source = open_source(options.source, rig, say)
    warm_up(*localizing(rig))
    seen = [
        (frame.name, sightings)
        for frame, sightings in progress(observe(source.frames(), rig), source.length, "localizing")
    ]
    paired = pair(survey, seen, source.name)
    check_survey(paired.pairs, rig, survey.name, FEWEST_POSES)
    with working("fitting the offset, each pose held out in its turn"):
        found = calibrate_offset(rig, paired.pairs, options.source, options.dome, options.window)
    for remark in paired.remarks:
        say(remark)
    _tell(found)
    before, after = (1e3 * np.sqrt(np.nanmean(away[found.fit.used] ** 2)) for away, _ in (found.before, found.after))
    print(
        f"poses that it was not fitted to {'gain' if found.helps else 'do not gain'}: {before:.3f} mm off an axis by "
        f"the rig as it is, {after:.3f} mm with the offset"
    )
    if not found.helps:
        # An answer, not a failure: what comes next can go on with the rig as it is.
        print(f"not written: {options.out}" + (" stays as it was" if options.out.exists() else "") + "; keep the rig")
        return 0
    robots = sorted({sighting.robot for sighting, _ in paired.pairs})
    text = _text(found, options, robots)
    parse_offset(text, str(options.out))
    if rig.z_correction is not None:
        say(
            f"warning: the z_correction of {options.rig} was fitted without this offset; run "
            f"{typed('calibrate', 'z')} again"
        )
    kept = write_result_file(options.out, text, options.force)
    print(f"written: {options.out}" + (f"; the old one is kept as {kept}" if kept else ""))
    print(f"to use it: led: {{offset: {options.out.name}}} for {', '.join(robots)} in the rig.yaml (path from there)")
    return 0


def _text(found: OffsetCalibration, options: argparse.Namespace, robots: list[str]) -> str:
    if options.dome is not None:
        index, radius, depth = options.dome
        cover = f"dome, index {index:g}, radius {radius * 1e3:g} mm, chip {depth * 1e3:g} mm below its centre"
    elif options.window is not None:
        cover = f"flat window, index {options.window[0]:g}, chip {options.window[1] * 1e3:g} mm below it"
    else:
        cover = "none by theory"
    degrees = _table_degrees(found)
    shifts = found.offset.shift(np.sin(np.radians(degrees)) ** 2)
    coefficients = ", ".join(number(value) for value in (found.offset.axial_shift.round(DECIMALS) + 0.0).tolist())
    return (
        "# Where the light of an LED seems to come from, for a rig's led.offset; by asterism calibrate offset.\n"
        f"# {len(found.angles)} surveyed poses of {', '.join(robots)}: {options.source}, {options.truth}\n"
        f"# refraction: {cover}\n"
        f"# fitted on top: {len(found.fitted)} coefficients, as many as held-out poses bear out\n"
        f"# seen at degrees: {', '.join(f'{d:g}' for d in degrees)}\n"
        f"# axial shift mm:  {', '.join(f'{1e3 * s:.4f}' for s in shifts)}\n"
        "# Coefficients of the powers 0, 1, 2, ... of sin^2 of the angle between axis and line of sight.\n"
        f"axial_shift: [{coefficients}]  # m\n"
        f"up_to_deg: {np.degrees(found.offset.up_to_rad):.2f}  # beyond, the shift stays what it is there\n"
    )


def _table_degrees(found: OffsetCalibration) -> list[float]:
    largest = float(np.degrees(found.offset.up_to_rad))
    return [*(float(d) for d in range(0, int(largest), TABLE_DEG)), round(largest, 1)]


def _tell(found: OffsetCalibration) -> None:
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("seen at", "poses", "", "x mm", "y mm", "z mm", "angle deg"):
        table.add_column(name, justify="left" if name in ("seen at", "") else "right", no_wrap=True)
    degrees = np.degrees(found.angles)
    bands = [(low, low + BAND_DEG) for low in np.arange(0.0, degrees.max(), BAND_DEG)]
    rows = [(f"{low:g} to {high:g} deg", (degrees >= low) & (degrees < high)) for low, high in bands]
    for name, mask in [*rows, ("all", degrees >= 0.0)]:
        here = mask & found.fit.used
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
    if not found.fit.used.all():
        console.print(f"{(~found.fit.used).sum()} poses are far off what the others say; left out", highlight=False)
    sin2 = np.sin(np.radians(_table_degrees(found))) ** 2
    constant = float(found.offset.axial_shift[0])
    changes = found.offset.shift(sin2) - constant
    console.print(
        f"fitted on top of {'the theory' if len(found.theory) else 'nothing'}: {len(found.fitted)} coefficients; the "
        f"survey itself seems to be off by {1e3 * found.fit.sigmas[1]:.3f} mm and "
        f"{np.degrees(found.fit.sigmas[2]):.3f} degrees (one sigma)\n"
        f"constant part: {1e3 * constant:.4f} mm +- {1e3 * found.constant_sigma:.4f} along the plate's normal, which "
        "no film without surveyed poses can see: it rests on the survey and on where the rig says that the LEDs are\n"
        "what changes with the angle: "
        + ", ".join(f"{1e3 * c:+.4f} mm at {d:g}" for c, d in zip(changes, _table_degrees(found), strict=True) if d > 0)
        + " degrees; beyond, as there",
        highlight=False,
    )
