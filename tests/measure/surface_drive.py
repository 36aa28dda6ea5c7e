"""Surfaces from a drive of five robots, against the truth: `python -m tests.measure.surface_drive [DRIVES]`.

Spots are drawn with the noise of their light and solved as the chain does, 60 s at 1.3 m, f = 1400 px; `--off` is what
LEDs are off an axis, which is told. Printed: RMS of the error along the normal where robots were, what is told, and how
many places lie within two sigmas.
"""

import argparse
import sys

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.calibration.surface.calibration import calibrate_surface
from tests.calibration.surface.driven import Ground, ball, bowl, bumps, drive, level, located, touched

GROUNDS: dict[str, Ground] = {"plane": level, "paraboloid": bowl, "ball": ball, "bumps": bumps}


def main() -> int:
    """Drive, calibrate, compare."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.surface_drive")
    parser.add_argument("drives", nargs="?", type=int, default=10)
    parser.add_argument("--off", type=float, default=0.0, help="of LEDs, m an axis (default: 0)")
    parser.add_argument("--rate", type=float, default=60.0, help="Hz (default: 60)")
    options = parser.parse_args()
    for name, ground in GROUNDS.items():
        rows = np.array([measured(ground, seed, options.off, options.rate) for seed in range(options.drives)])
        rms, told = np.sqrt((rows[:, :2] ** 2).mean(axis=0))
        print(
            f"{name}: {len(rows)} drives; RMS {1e3 * rms:.4f} mm (worst {1e3 * rows[:, 0].max():.4f}), told "
            f"{1e3 * told:.4f}; within 2 sigma {rows[:, 2].mean():.1%} (worst {rows[:, 2].min():.1%})",
            flush=True,
        )
    return 0


def measured(ground: Ground, seed: int, off_m: float, rate_hz: float) -> Floats:
    """RMS of the error and of sigmas, m, and the share of places within two sigmas, of one drive."""
    driven = drive(ground, seed, rate_hz=rate_hz)
    contacts = touched(driven, located(driven, seed, off_m), Uncertainty(led_position_m=off_m))
    fit = calibrate_surface(contacts, [robot.axis for robot in driven.rig.robots], "the drive")
    there = np.argwhere(np.isfinite(fit.map.values))
    places = fit.map.origin + fit.map.step * there
    found = fit.surface.ground(places)
    heights, slopes = ground(places)
    off = ((found.heights - heights) / np.sqrt(1.0 + (slopes**2).sum(axis=1)))[found.inside]
    sigmas = found.sigmas[found.inside]
    return np.array([np.sqrt((off**2).mean()), np.sqrt((sigmas**2).mean()), (np.abs(off) < 2.0 * sigmas).mean()])


if __name__ == "__main__":
    sys.exit(main())
