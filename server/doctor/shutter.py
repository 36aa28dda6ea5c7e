"""Does the shutter roll: rows exposed one after another shear a robot that moves.

A pose takes up most of that shear, as a tilt. What it does not, the shear's part in the perspective of a near plate, is
a pattern of the residuals: every LED's own speed times how far its row is from the robot's middle one. A plate that is
seen nearly from the front takes up more, so what is found may be too small, and nothing found is no proof.
"""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.doctor.gather import Gathered, Ints, Sightings
from asterism.server.doctor.patterns import Strength, strengths
from asterism.server.doctor.residuals import whitened

LEAST_US, TELLING_US = 1.0, 3.0  # a line time, and one sigma of it that would have shown most: sensors take 5 to 70
LONGEST_GAP_NS = 200_000_000  # between the sightings that tell a speed


def line_time(gathered: Gathered) -> Strength | None:
    """From one row to the next, us, beside what the rig says; None where too few residuals tell."""
    seen, rig = gathered.sightings, gathered.rig
    if not len(seen.frames):
        return None
    speeds = speeds_of(seen, gathered.pictures.exposed_ns)
    rows = seen.centres[..., 1] - np.nanmean(seen.centres[..., 1], axis=1, keepdims=True)
    pattern = np.nan_to_num(1e-6 * speeds * rows[..., None])[..., None]
    found = strengths(rig, seen, whitened(rig, seen), pattern)
    return found[0] if found else None


def speeds_of(seen: Sightings, exposed_ns: Ints) -> Floats:
    """How fast (m, 6, 2) px/s spots move, from the sightings before and after; 0 where there are none."""
    speeds = np.zeros_like(seen.centres)
    for robot in np.unique(seen.robots).tolist():
        rows = np.flatnonzero(seen.robots == robot)
        times = exposed_ns[seen.frames[rows]]
        before, after = np.arange(len(rows)) - 1, np.arange(len(rows)) + 1
        before[0], after[-1] = 0, len(rows) - 1
        gap = times[after] - times[before]
        near = (gap > 0) & (gap < LONGEST_GAP_NS)
        moved = seen.centres[rows[after]] - seen.centres[rows[before]]
        speeds[rows[near]] = moved[near] / (1e-9 * gap[near])[:, None, None]
    return np.nan_to_num(speeds)


def check_shutter(gathered: Gathered) -> Finding:
    """Whether rows are exposed one after another, unknown to the rig."""
    name, told_us = "rolling shutter", gathered.rig.capture.line_time_us
    if told_us:
        return Finding(name, Verdict.GOOD, f"{told_us:g} us a row, corrected as the rig says")
    found = line_time(gathered)
    if found is None or found.sigma > TELLING_US:
        return Finding(name, Verdict.UNTOLD, "robots move too slowly to tell")
    if found.sure and abs(found.value) > LEAST_US:
        advice = (
            f"Use a global shutter, or set capture.line_time_us: about {abs(found.value):.0f} (a data sheet knows)."
        )
        seen = f"residuals of moving robots look like {found.value:+.1f} ± {found.sigma:.1f} us a row"
        return Finding(name, Verdict.WRONG, seen, advice)
    # Staged ones of 15 us were found in one rig of four.
    return Finding(name, Verdict.UNTOLD, "no sign of one; but most of its shear looks like a tilt")
