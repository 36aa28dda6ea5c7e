"""Is the camera's calibration old, and do residuals agree with it.

A wrong lens bends what poses cannot take up. How much of that residuals show is asked one parameter at a time: focal
length, and the first coefficient of distortion. Robots' LEDs are free to be a little off meanwhile. Plates are small,
so a focal length shows weakly, in plates that are seen near and far and tilted to all sides best; how large an error
these frames would have shown is told.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from asterism.protocol.constellation import LEDS
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.protocol.rig_files import report_path
from asterism.server.calibration.lens.values import pixels_by_lens
from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.doctor.gather import Gathered, Sightings
from asterism.server.doctor.patterns import SIGMAS, Strength, strengths
from asterism.server.doctor.place import LensOrPlace
from asterism.server.doctor.residuals import whitened

OLD_DAYS = 365.0  # lenses creep with every summer and winter
DAY_S = 86_400.0
TELLING = 5e-3  # an error of the focal length that is to show before nothing is called good
BLIND = 0.1  # one that is no test at all
WORTH = 0.5e-3  # of the focal length: half a millimetre of Z at 1 m
WORTH_PX = 0.5  # at the image's corner, of distortion


class LensErrors(NamedTuple):
    """``focal`` relative; ``bend`` px, what the distortion is off by at the image's corner."""

    focal: Strength
    bend: Strength


def lens_errors(rig: Rig, seen: Sightings) -> LensErrors | None:
    """How far the lens is off by the residuals of all robots; None where too few tell."""
    told = whitened(rig, seen)
    m = len(seen.frames)
    by_lens = pixels_by_lens(rig.camera, told.points.reshape(-1, 3)).reshape(m, LEDS, 2, -1)
    focal = by_lens[..., 0] * rig.camera.matrix[0, 0] + by_lens[..., 1] * rig.camera.matrix[1, 1]
    bend = by_lens[..., 4] / _at_corner(rig)
    found = strengths(rig, seen, told, np.stack([focal, bend], axis=-1))
    return LensErrors(*found) if found else None


def _at_corner(rig: Rig) -> float:
    """How far, px, the first coefficient of distortion moves the farthest corner."""
    camera = rig.camera
    far = np.maximum(camera.matrix[:2, 2], [camera.width, camera.height] - camera.matrix[:2, 2])
    corner = np.append(far / camera.matrix[[0, 1], [0, 1]], 1.0)
    return max(float(np.linalg.norm(pixels_by_lens(camera, corner[None])[0, :, 4])), 1e-9)


def check_calibration(gathered: Gathered, camera_file: Path, now_s: float, place: LensOrPlace | None) -> Finding:
    """The file's age, the residuals' pattern, and what constellations that stand still say of the focal length."""
    name, rig = "calibration", gathered.rig
    days = max(now_s - camera_file.stat().st_mtime, 0.0) / DAY_S
    age = f"{camera_file.name} is {_age(days)} old"
    told = "" if report_path(camera_file).exists() else ", without a report"
    again = f"Calibrate again: {typed('calibrate', 'camera', 'SOURCE', '--target', 'TARGET', '-o', camera_file)}."
    if place is not None and place.lens:
        return Finding(name, Verdict.WRONG, f"{age}; {place.lens}", again)
    errors = lens_errors(rig, gathered.sightings) if len(gathered.sightings.frames) else None
    if errors is not None and (off := _off(errors)):
        return Finding(name, Verdict.WRONG, f"{age}; {off}", again)
    limit = _limit(errors, place)
    seen = "; too few robots, or too ill known, to judge it by"
    if limit < BLIND:
        seen = f"; nothing speaks against it (a focal length off by {100 * limit:.2g} % would)"
    if days > OLD_DAYS:
        return Finding(name, Verdict.LOOK, f"{age}{told}{seen}", again)
    if limit > TELLING:
        advice = "Show a robot by hand from all sides for 10 s, or have one in view that stands still (`fixed`)."
        return Finding(name, Verdict.UNTOLD, f"{age}{told}{seen}", advice)
    return Finding(name, Verdict.GOOD, f"{age}{told}{seen}")


def _off(errors: LensErrors) -> str:
    """What residuals say is off, empty where it is nothing."""
    focal, bend = errors
    if focal.sure and abs(focal.value) > WORTH:
        return f"focal length {100 * focal.value:+.2f} ± {100 * focal.sigma:.2f} % off by the residuals"
    if bend.sure and abs(bend.value) > WORTH_PX:
        return f"distortion {bend.value:+.1f} ± {bend.sigma:.1f} px off at the corner"
    return ""


def _limit(errors: LensErrors | None, place: LensOrPlace | None) -> float:
    """The least error of the focal length, relative, that would have shown."""
    limits = [] if errors is None else [SIGMAS * errors.focal.sigma]
    if place is not None and not place.sure:
        limits.append(place.focal_limit)
    return min(limits, default=math.inf)


def _age(days: float) -> str:
    if days < 2:
        return f"{24 * days:.0f} h"
    return f"{days:.0f} days" if days < 700 else f"{days / 365.25:.1f} years"
