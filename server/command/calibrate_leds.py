"""asterism calibrate leds: a robot's six LED positions from a film of it moved about."""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.errors import InputError
from asterism.protocol.rig import load_rig, parse_rig
from asterism.server.calibration.leds.calibration import LedCalibration, calibrate_leds, moved_by, tilt_spread_deg
from asterism.server.calibration.result_file import check_result_file, write_result_file
from asterism.server.calibration.rewrite import relocate, rewrite
from asterism.server.chain.frame import Frame
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.progress import progress
from asterism.server.service.say import say
from asterism.server.sources.open_source import open_source, refuse_endless

DECIMALS = 7  # of positions in m: a tenth of a micrometre


def run(options: argparse.Namespace) -> int:
    """Fit, write the rig with the new positions, print them with their standard deviations."""
    check_result_file(options.out, options.force)
    refuse_endless(options.source, "calibrate leds")
    rig = load_rig(options.rig)
    ids = [robot.id for robot in rig.robots]
    if options.robot not in ids:
        raise InputError(f"--robot {options.robot}: is not in {options.rig}, expected one of {', '.join(ids)}")
    rounds = iter(("finding the LEDs", "measuring"))
    quiet = False  # the second round meets the same unreadable images again

    def frames() -> Iterator[Frame]:
        nonlocal quiet
        source = open_source(options.source, rig, (lambda _: None) if quiet else say)
        quiet = True
        yield from progress(source.frames(), source.length, next(rounds))

    warm_up(*localizing(rig))
    found = calibrate_leds(rig, options.robot, frames, options.source, options.distance)
    robot = rig.robot(options.robot)
    leds = found.adjusted.leds.round(DECIMALS) + 0.0
    text = rewrite(rig.rig_text, {("robots", options.robot, "leds"): leds.tolist()}, options.rig)
    parse_rig(text, rig.camera_text, str(options.out), rig.offset_texts)
    text = relocate(text, Path(options.rig), options.out)
    kept = write_result_file(options.out, text, options.force)
    _tell(found, moved_by(found.adjusted.leds, robot.leds), tilt_spread_deg(robot, found.adjusted.views))
    normal = robot.T_robot_plane.rotation[:, 2]
    block = np.kron(np.eye(len(leds)), normal)
    off = np.sqrt(np.diag(block @ found.adjusted.covariance @ block.T))
    first, second, metres = options.distance
    print(
        f"off the plane: determined to {off.max() * 1e3:.4f} mm; scale: from the distance of LEDs {first} and "
        f"{second}, whose error it shares (0.1 mm there is {0.1e-3 / metres:.2%} of every pose's distance)"
    )
    print(f"written: {options.out}" + (f"; the old one is kept as {kept}" if kept else ""))
    return 0


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
