"""Why a robot that is missing was not found: the nearest explanation that its frame's spots allow, if there is one.

The free spots are searched again for the missing robots with one limit at a time not believed. It costs as much as
some cold searches, so it is done at most once in EVERY_NS of a film, and only with the brightest spots; in between,
what was found last is told (it is part of `Tracks`). Nothing of it finds a robot: it only says what a person can do.
"""

import copy
import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.identity.hypotheses import COST, ROBOT, SEEN, Fits
from asterism.server.identity.loose import misfit_words, tolerance_px
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan
from asterism.server.identity.search import SECOND_QUADS, searched
from asterism.server.pose.fit import LEDS
from asterism.server.pose.track import Tracks

EVERY_NS = 500_000_000
MOST_SPOTS = 60  # the brightest
WIDER = 5.0  # times nearer and farther than the range
MERGED_RADII = 3.0  # of their spots: LEDs that are seen nearer to each other look like one
# What is told, in `Tracks.reasons`; columns of these: which of them, a number that belongs to it, and when it was
# found, in EVERY_NS.
NOTHING, MISFIT, AWAY, MIRRORED, UNEVEN, MERGED = range(6)
WHICH, NUMBER, WHEN = range(3)


def explain(spots: Spots, plan: Plan, missing: NDArray[np.bool_], tracks: Tracks, exposed_ns: int) -> dict[int, str]:
    """What is to be said of the ``missing`` robots (mask over the rig's), where anything can be.

    ``spots`` that are free are nobody's. Writes the tracks.
    """
    reasons, now = tracks.reasons, float(exposed_ns // EVERY_NS + 1)
    reasons[~missing] = 0.0
    asked = missing & (reasons[:, WHEN] != now)
    if asked.any():
        reasons[asked] = NOTHING, 0.0, now
        if np.count_nonzero(spots.free) >= 4:
            for look in (_misfit, _away, _mirrored, _uneven, _merged):
                left = asked & (reasons[:, WHICH] == NOTHING)
                for robot, which, number in look(_brightest(spots), plan, left) if left.any() else ():
                    if reasons[robot, WHICH] == NOTHING:
                        reasons[robot, : NUMBER + 1] = which, number
    words = ((int(robot), _sentence(plan, *reasons[robot, :WHEN].tolist())) for robot in np.flatnonzero(missing))
    return {robot: sentence for robot, sentence in words if sentence}


def _sentence(plan: Plan, which: float, number: float) -> str:
    if which == MISFIT:
        return misfit_words(number)
    if which == AWAY:
        side, limit = ("nearer", plan.near) if number < plan.near else ("farther", plan.far)
        return (
            f"its constellation is seen at {number:.3g} m, {side} than range ({limit:.3g} m): change range, or move it"
        )
    if which == MIRRORED:
        return (
            "its constellation is seen mirrored: the image is flipped, or its LEDs were measured from behind (then "
            "change the sign of their x)"
        )
    if which == UNEVEN:
        return "six spots fit, but they are not alike: some of its LEDs are much dimmer or larger than the others"
    if which == MERGED:
        return "four of its LEDs fit, and two look like one: turn it to the camera, move it nearer, or focus"
    return ""


def _brightest(spots: Spots) -> Spots:
    """The free spots that are searched."""
    free = np.flatnonzero(spots.free)
    rows = free[np.argsort(-spots.heights[free], kind="stable")[:MOST_SPOTS]]
    return Spots(*(np.ascontiguousarray(column[rows]) for column in spots))


def _unlike(sought: NDArray[np.bool_]) -> int:
    """Quads of less alike spots that are tried for so many robots."""
    return SECOND_QUADS // int(np.count_nonzero(sought))


_Told = Iterator[tuple[int, int, float]]


def _six(
    spots: Spots, plan: Plan, sought: NDArray[np.bool_], which: int, number: Callable[[Floats, float], float]
) -> _Told:
    """Robots of which a search is certain."""
    claims, _ = searched(spots, plan, ~sought, np.where(sought, 0.0, np.inf), LEDS, unlike=_unlike(sought))
    for t, values in zip(claims.ts, claims.values, strict=True):
        yield int(values[ROBOT]), which, number(t, float(values[COST]))


def _misfit(spots: Spots, plan: Plan, sought: NDArray[np.bool_]) -> _Told:
    tolerance = tolerance_px(plan)
    brightness, unlike = np.where(sought, 0.0, np.inf), _unlike(sought)
    claims, pending = searched(spots, plan, ~sought, brightness, LEDS, tolerance=tolerance, unlike=unlike)
    for fits in (claims, pending):
        for values in fits.values[np.argsort(fits.values[:, COST], kind="stable")]:
            yield int(values[ROBOT]), MISFIT, math.sqrt(values[COST] / LEDS) * tolerance


def _away(spots: Spots, plan: Plan, sought: NDArray[np.bool_]) -> _Told:
    wide = copy.copy(plan)
    wide.near, wide.far = plan.near / WIDER, plan.far * WIDER
    wide.reach = plan.reach * WIDER
    for robot, which, away in _six(spots, wide, sought, AWAY, lambda t, _: float(t[2])):
        if not plan.near <= away <= plan.far:
            yield robot, which, away


def _mirrored(spots: Spots, plan: Plan, sought: NDArray[np.bool_]) -> _Told:
    mirror = np.array([-1.0, 1.0])
    flipped = spots._replace(flat=spots.flat * mirror, rays=spots.rays * mirror)
    return _six(flipped, plan, sought, MIRRORED, lambda _, __: 0.0)


def _uneven(spots: Spots, plan: Plan, sought: NDArray[np.bool_]) -> _Told:
    even = np.full(len(spots.heights), float(np.median(spots.heights)))
    alike = spots._replace(heights=even, radii=np.full(len(even), float(np.median(spots.radii))))
    return _six(alike, plan, sought, UNEVEN, lambda _, __: 0.0)


def _merged(spots: Spots, plan: Plan, sought: NDArray[np.bool_]) -> _Told:
    everybody = np.ones(len(sought), np.bool_)
    _, fits = searched(spots, plan, everybody, np.where(sought, 0.0, np.inf), 4, unlike=_unlike(sought))
    for k in np.argsort(fits.values[:, COST], kind="stable"):
        if fits.values[k, SEEN] == 4 and _look_like_one(spots, plan, fits, int(k)):
            yield int(fits.values[k, ROBOT]), MERGED, 0.0


def _look_like_one(spots: Spots, plan: Plan, fits: Fits, k: int) -> bool:
    """Whether the two LEDs that have no spot are seen so near to each other that they look like one."""
    labels = fits.spots[k]
    points = plan.layouts[int(fits.values[k, ROBOT])] @ fits.rotations[k].T + fits.ts[k]
    flat = points[:, :2] / points[:, 2:] * plan.focal
    first, second = flat[labels < 0]
    radius = float(np.median(spots.radii[labels[labels >= 0]]))
    return bool(np.hypot(*(first - second)) < MERGED_RADII * radius)
