"""Drives that tell no surface, each refused with what was found and what to do."""

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.server.calibration.surface.contacts import Contacts

FEWEST = 60  # touches
PATCH_M = 0.02
FEWEST_PATCHES = 15
NARROWEST_M = 0.005  # one sigma of places across their line
FARTHEST_OFF_M = 5e-4  # one sigma, beside the poses' noise
LEAST_SHARE = 0.5  # of touches


def check_touches(source: str, contacts: Contacts) -> None:
    """Raise InputError for too few touches."""
    if len(contacts) < FEWEST:
        counts = ", ".join(f"{id} {n}" for id, n in zip(contacts.ids, _per_robot(contacts), strict=True))
        raise InputError(
            f"{source}: robots were located at {len(contacts) or 'no'} different places ({counts}), expected {FEWEST} "
            "at least; drive all over the surface for a minute, frames at one place count once"
        )


def check_places(source: str, points: Floats) -> None:
    """Raise InputError where touches (n, 3) m lie in too few patches, or along one line."""
    narrow, long = _across(points)
    patches = len(np.unique(np.floor(points / PATCH_M), axis=0))
    if narrow < NARROWEST_M and long > 4.0 * narrow:
        raise InputError(
            f"{source}: robots drove along one line only ({2e3 * narrow:.1f} mm across it, {2e3 * long:.0f} mm along "
            "it, one sigma to both sides), which leaves the surface open across it; drive in a second direction"
        )
    if patches < FEWEST_PATCHES:
        raise InputError(
            f"{source}: robots were in {patches} patches of {1e3 * PATCH_M:.0f} x {1e3 * PATCH_M:.0f} mm, expected "
            f"{FEWEST_PATCHES} at least; drive all over the surface"
        )


def _across(points: Floats) -> tuple[float, float]:
    """One sigma, m, of points (n, 3) across the line that they lie along, which may bend, and along it."""
    away = points - points.mean(axis=0)
    values, axes = np.linalg.eigh(away.T @ away / len(points))
    long = float(np.sqrt(values[2]))
    along = away @ axes[:, 2] / max(long, 1e-9)
    bend = np.stack([np.ones_like(along), along, along**2], axis=-1)
    aside = away @ axes[:, :2]
    aside = aside - bend @ np.linalg.lstsq(bend, aside, rcond=None)[0]
    return float(np.linalg.norm(aside, 2) / np.sqrt(len(points))), long


def check_common(source: str, residuals: Floats, variances: Floats, used: int, touches: int) -> None:
    """Raise InputError where touches that were not fitted to are far from the best surface, m, or most are no touches.
    ``variances`` (n,) m^2 by poses.
    """
    off = 1.4826 * float(np.median(np.abs(residuals)))
    noise = float(np.sqrt(np.median(variances)))
    if off**2 - noise**2 > FARTHEST_OFF_M**2:
        raise InputError(
            f"{source}: robots do not touch one surface: places that it was not fitted to are {1e3 * off:.2g} mm off "
            f"the best one (one sigma; poses' noise is {1e3 * noise:.2g} mm), expected {1e3 * FARTHEST_OFF_M:g} mm at "
            "most; are they carried, or is their point another one (--point)?"
        )
    if used < LEAST_SHARE * touches:
        raise InputError(
            f"{source}: robots touch one surface in {used} of {touches} places, expected half of them; leave out what "
            "is not driven on it"
        )


def _per_robot(contacts: Contacts) -> list[int]:
    return [int((contacts.robots == k).sum()) for k in range(len(contacts.ids))]
