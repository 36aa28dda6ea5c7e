"""Robots of which only four LEDs are seen, found without a prediction: claimed where the margin allows.

Four spots and a pose leave one spot's worth of evidence, so everything else must speak for the robot as well: no
other spot like them stands near (a stranger or clutter would bring some), they are as large as its LEDs are at that
distance, the frame has little unexplained light, and no other robot or labelling explains them.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.identity.evidence import AROUND, surroundings
from asterism.server.identity.hypotheses import ROBOT, Found
from asterism.server.identity.led_size import size_of
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan
from asterism.server.identity.search import searched
from asterism.server.pose.fit import CHI2, fit_labelled, fit_room, median_of

LEAST = 11.0  # log odds against chance from which on a robot is claimed
WORTH = 5.0  # from which on it counts as an explanation at all
MARGIN = 7.0  # over the second-best explanation of any of its spots
LEAST_SIGMA_PX = 0.02  # nothing is known better than this of calibration and LED positions
WAYS = 360.0 * 0.15  # to name four spots; and how many of them a camera could see so
FOUR_SEEN = 0.05  # of the robots that are sought show four LEDs
LEAST_CHANCE = 0.01  # groups of four strange lights are expected at least, whatever else is in the frame
SIZE_SPREAD, KNOWN_SIZE_SPREAD = 0.15, 0.025  # of an LED's size, logarithm: by the rig; by robots in the same frame
SIZES_AGREE = 0.1  # up to such a difference of that logarithm
WIDEST = 0.4  # extent over distance: in stronger perspective chance spots are four LEDs in more ways than WAYS says
SEVERAL = 3  # fits that agree tell what is typical
DOUBT = "four of its LEDs may be seen, but others or chance explain them nearly as well"


@dataclass(frozen=True, slots=True, eq=False)
class _Four:
    robot: int
    labels: NDArray[np.int64]  # (6,)
    used: frozenset[int]
    residual_px2: float  # of the fit, two degrees of freedom
    variance_px2: float  # of the spots
    size: float  # logarithm of the spots' radii over what they should be, nan if the rig does not say
    area_px2: float
    rotation: Floats
    t: Floats


def fours(
    spots: Spots, plan: Plan, sigma_px: float, found: list[Found], sought: NDArray[np.bool_], doubts: dict[int, str]
) -> list[Found]:
    """The ``sought`` robots (mask over the rig's) that show four LEDs; why one is in doubt is written to ``doubts``.

    ``found`` are the robots found so far, ``sigma_px`` what calibration and LED positions are off, as they told.
    """
    if not sought.any():
        return []
    usable = spots.free.copy()
    for _, labels, _, _ in found:
        usable[labels[labels >= 0]] = False
    if usable.sum() < 4 or _hopeless(int(usable.sum()) - 4 * int(sought.sum()), plan):
        return []
    spots = spots._replace(free=usable)
    # As if all were known, and the sought ones but dim: what is found then is a hypothesis.
    _, fits = searched(spots, plan, np.ones(len(sought), np.bool_), np.where(sought, 0.0, np.inf), 4, alone=True)
    sizes = [size_of(spots, plan, robot, labels, rotation, t) for robot, labels, rotation, t in found]
    size = _typical_size(sizes)
    candidates = [
        four
        for labels, values in zip(fits.spots, fits.values, strict=True)
        for four in _refitted(int(values[ROBOT]), labels, sigma_px, spots, plan)
    ]
    wanted = int(sought.sum())
    promising = [
        four
        for four, odds in _best_of_each(candidates, [_odds(four, sigma_px, size, plan, wanted) for four in candidates])
        if odds > WORTH
    ]
    if len(promising) >= SEVERAL:
        sigma_px = _sharpened(promising, sigma_px)
        size = _typical_size(sizes + [four.size for four in promising])
    candidates = [four for old in candidates for four in _refitted(old.robot, old.labels, sigma_px, spots, plan)]
    odds = [_odds(four, sigma_px, size, plan, wanted) for four in candidates]
    explained: set[int] = set().union(
        *(four.used for four, value in zip(candidates, odds, strict=True) if value > WORTH)
    )
    strange = int(usable.sum()) - len(explained)
    claimed: list[Found] = []
    for four, value in _best_of_each(candidates, odds):
        if value <= WORTH:
            continue
        rivals = [
            other_value
            for other, other_value in zip(candidates, odds, strict=True)
            if other is not four and (other.used & four.used or other.robot == four.robot)
        ]
        if value + _prior(strange, four.area_px2, plan) >= LEAST and value - max(rivals, default=-math.inf) >= MARGIN:
            claimed.append((four.robot, four.labels, four.rotation, four.t))
        else:
            doubts[four.robot] = DOUBT
    return claimed


def _hopeless(strange: int, plan: Plan) -> bool:
    """Whether among so many strange lights not even the best conceivable fit could be claimed."""
    for away in (plan.near, plan.far):
        area = math.pi * (AROUND * float(plan.extents.min()) * plan.focal / away) ** 2
        best = math.log(area / (2.0 * math.pi * LEAST_SIGMA_PX**2 * WAYS)) + _of_its_size(plan, KNOWN_SIZE_SPREAD)
        if best + _prior(strange, area, plan) >= LEAST:
            return False
    return True


def _prior(strange: int, area_px2: float, plan: Plan) -> float:
    """Logarithm of the odds, before a look at the fit, that a group of four is a robot and no chance."""
    camera = plan.rig.camera
    inside = max(strange, 0) * area_px2 / (camera.width * camera.height)
    # Groups of exactly four strange lights that such an area holds somewhere in the image.
    groups = max(strange, 0) * inside**3 / 6.0 * math.exp(-inside)
    return math.log(FOUR_SEEN / max(groups, LEAST_CHANCE))


def _of_its_size(plan: Plan, spread: float) -> float:
    """What it says for a robot that the spots are exactly as large as its LEDs: by chance any distance is implied."""
    return math.log(math.log(plan.far / plan.near * 1.5) / (math.sqrt(2.0 * math.pi) * spread))


def _refitted(robot: int, labels: NDArray[np.int64], sigma_px: float, spots: Spots, plan: Plan) -> list[_Four]:
    """The fit with that systematic error; nothing if there is none, or it is bad, or others like them stand around."""
    room, systematic2 = fit_room(), (sigma_px / plan.focal) ** 2
    count, chi2, which = fit_labelled(plan.layouts[robot], labels, spots.rays, spots.variances, systematic2, 5, room)
    if which < 0 or chi2 > CHI2[count]:
        return []
    rotation, t = room.rotations[which], room.ts[which]
    if plan.extents[robot] > WIDEST * float(np.linalg.norm(t)):
        return []
    height = median_of(spots.heights, labels)
    around, area = surroundings(
        spots.flat,
        spots.heights,
        spots.free,
        labels,
        height,
        plan.extents[robot] * plan.focal / float(np.linalg.norm(t)),
    )
    if around > 4:
        return []
    variance = float(median_of(spots.variances, labels)) * plan.focal**2
    used, residual_px2 = frozenset(labels[labels >= 0].tolist()), chi2 * (sigma_px**2 + variance)
    size = size_of(spots, plan, robot, labels, rotation, t)
    return [_Four(robot, labels, used, residual_px2, variance, size, area, rotation, t)]


def _odds(four: _Four, sigma_px: float, size: tuple[float, float], plan: Plan, robots: int) -> float:
    """Logarithm of the odds that a chance group of four would not fit so well, in nats.

    Three spots are spent on the pose; the fourth lands within its variance of its place by chance with probability
    2 pi sigma^2 over the area. The implied distance is anywhere in the range by chance.
    """
    variance = sigma_px**2 + four.variance_px2
    value = math.log(four.area_px2 / (2.0 * math.pi * variance)) - 0.5 * four.residual_px2 / variance
    value -= math.log(WAYS * max(robots, 1))
    if math.isfinite(four.size):
        typical, spread = size
        off = (four.size - typical) / spread
        value += _of_its_size(plan, spread) - 0.5 * off * off
    return value


def _typical_size(sizes: list[float]) -> tuple[float, float]:
    """What `_size` should be and how far off, by those of other robots, of which nan tell nothing."""
    told = np.array([size for size in sizes if math.isfinite(size)])
    if len(told) > 1:
        typical = float(np.median(told))
        if float(np.median(np.abs(told - typical))) < SIZES_AGREE:
            return typical, KNOWN_SIZE_SPREAD
    return 0.0, SIZE_SPREAD


def _best_of_each(candidates: list[_Four], odds: list[float]) -> list[tuple[_Four, float]]:
    """The best explanation of every group of spots: none of them shares a spot with a better one."""
    best: list[tuple[_Four, float]] = []
    taken: set[int] = set()
    for four, value in sorted(zip(candidates, odds, strict=True), key=lambda pair: -pair[1]):
        if not four.used & taken:
            best.append((four, value))
        taken |= four.used
    return best


def _sharpened(fits: list[_Four], sigma_px: float) -> float:
    """One sigma, px an axis, of what calibration and LED positions are off, when these fits have told as well.

    Several independent fits that all leave next to nothing are no chance; what was known before counts as one.
    """
    typical = float(np.median([fit.residual_px2 for fit in fits])) * 2.0 / (2.0 * math.log(2.0))
    return min(
        sigma_px, max(math.sqrt((len(fits) * typical + 2.0 * sigma_px**2) / (2.0 * (len(fits) + 1))), LEAST_SIGMA_PX)
    )
