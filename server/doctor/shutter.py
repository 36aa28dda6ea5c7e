"""Does the shutter roll: rows exposed one after another shear a robot that moves.

A pose takes up most of that shear, as a tilt. What it does not, the shear's part in the perspective of a near plate, is
a pattern of the residuals: every LED's own speed times how far its row is from the robot's middle one. Sensors take 5
to 70 us from one row to the next.
"""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.doctor.gather import Gathered, Ints, Sightings
from asterism.server.doctor.patterns import SIGMAS, Strength, strengths
from asterism.server.doctor.residuals import whitened

LEAST_US, TELLING_US = 1.0, 12.0  # a line time, and one that is to show before it is said that there is none
LONGEST_GAP_NS = 200_000_000  # between the sightings that tell a speed


def line_time(gathered: Gathered) -> Strength | None:
    """From one row to the next, us, beside what the rig says; None where too few residuals tell."""
    seen, rig = gathered.sightings, gathered.rig
    if not len(seen.frames):
        return None
    speeds = speeds_of(seen, gathered.pictures.exposed_ns)
    told = np.flatnonzero((np.isfinite(speeds[..., 0]) | ~seen.lit).all(axis=1))
    seen, speeds = seen.take(told), speeds[told]
    rows = seen.centres[..., 1] - np.nanmean(seen.centres[..., 1], axis=1, keepdims=True)
    pattern = np.nan_to_num(1e-6 * speeds * rows[..., None])[..., None]
    found = strengths(rig, seen, whitened(rig, seen), pattern)
    return found[0] if found else None


def speeds_of(seen: Sightings, exposed_ns: Ints) -> Floats:
    """How fast (m, 6, 2) px/s spots move, from the sightings before and after; nan where there are none."""
    speeds = np.full_like(seen.centres, np.nan)
    for robot in np.unique(seen.robots).tolist():
        rows = np.flatnonzero(seen.robots == robot)
        times = exposed_ns[seen.frames[rows]]
        before, after = np.arange(len(rows)) - 1, np.arange(len(rows)) + 1
        before[0], after[-1] = 0, len(rows) - 1
        gap = times[after] - times[before]
        near = (gap > 0) & (gap < LONGEST_GAP_NS)
        moved = seen.centres[rows[after]] - seen.centres[rows[before]]
        speeds[rows[near]] = moved[near] / (1e-9 * gap[near])[:, None, None]
    return speeds


def check_shutter(gathered: Gathered) -> Finding:
    """Whether rows are exposed one after another, unknown to the rig."""
    name, told_us = "rolling shutter", gathered.rig.capture.line_time_us
    if told_us:
        return Finding(name, Verdict.GOOD, f"{told_us:g} us a row, corrected as the rig says")
    found = line_time(gathered)
    if found is None:
        return Finding(name, Verdict.UNTOLD, "too few robots to tell")
    limit = SIGMAS * found.sigma
    if found.sure and abs(found.value) > LEAST_US:
        seen = f"residuals of moving robots show {found.value:+.1f} ± {found.sigma:.1f} us a row"
        advice = f"Use a global shutter, or set capture.line_time_us: {abs(found.value):.0f} (its data sheet knows)."
        return Finding(name, Verdict.WRONG, seen, advice)
    if limit > TELLING_US:
        return Finding(name, Verdict.UNTOLD, "robots move too slowly to tell")
    return Finding(name, Verdict.GOOD, f"none ({max(limit, LEAST_US):.2g} us a row would show)")
