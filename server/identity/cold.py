"""Cold identification: search, scores, assignment, and the robots whose mirror image or double stands elsewhere."""

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.centres.blobs import Ints
from asterism.server.identity import assign
from asterism.server.identity.evidence import LEAST_LIKE, MOST_LIKE, Version, best_version
from asterism.server.identity.fours import fours
from asterism.server.identity.hypotheses import COST, ROBOT, Found, fill_worse, matched_of, medians_of, rivals_of
from asterism.server.identity.hypotheses import HEIGHT as FIT_HEIGHT
from asterism.server.identity.loose import loose, tolerance_px
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan
from asterism.server.identity.search import MIRROR_RATIO, Results, searched
from asterism.server.pose.fit import LEDS, SYSTEMATIC_PX, median_of
from asterism.server.pose.matched import Matched

PRIOR_SYSTEMATIC_PX = 0.08  # what to expect of calibration and LED positions before a robot was seen

BESIDE = 4.0  # sigmas of a ruler's errors


def find(spots: Spots, plan: Plan, known: NDArray[np.bool_], misfits: Floats) -> tuple[Matched, dict[int, str]]:
    """Who is among the free spots, but for the robots that are ``known``; and why a robot is in doubt.

    ``misfits`` (robots,) m: one sigma of what each robot's LEDs are off as far as that was learned, 0 for nothing.
    """
    free = spots.free.copy()
    # A robot that was followed to its place has no rival: only a much brighter one would count.
    brightness = np.where(known, np.inf, 0.0)
    claims, pending = searched(spots, plan, known.copy(), brightness, 5)
    sigma = assign.systematic_sigma(claims.values[:, COST], SYSTEMATIC_PX, PRIOR_SYSTEMATIC_PX)
    # With what the other robots' fits have told, a fit may look worse than it did.
    worse = np.empty(len(claims.spots), np.bool_)
    some_worse = fill_worse(spots.variances, claims, sigma, plan.focal, worse)
    wanted = len(known) - int(np.count_nonzero(known))
    if (
        len(claims.spots) == wanted
        and not len(pending.spots)
        and not some_worse
        and _rivals(spots, claims.spots)[0] < 4
    ):
        return Matched(claims.values[:, ROBOT].astype(np.int64), claims.spots, claims.rotations, claims.ts), {}
    found, doubts = _decided(spots, free, plan, known, misfits, Results(claims, pending), sigma, worse)
    return matched_of(found), doubts


def _decided(
    spots: Spots, free: NDArray[np.bool_], plan: Plan, known: NDArray[np.bool_], misfits: Floats, told: Results,
    sigma: float, worse: NDArray[np.bool_],
) -> tuple[list[Found], dict[int, str]]:  # fmt: skip
    """Which hypotheses of a search hold, and what a looser one finds of the robots that are left.

    ``free`` are the spots that were so before it; ``worse`` (m,) the claims that fit no more with ``sigma``, px.
    """
    claims, pending = told
    wanted = len(known) - int(np.count_nonzero(known))
    claim_of = {int(robot): k for k, robot in enumerate(claims.values[:, ROBOT].tolist())}
    taken = set(claims.spots.ravel().tolist())
    hypotheses: list[assign.Hypothesis] = []
    disputed: set[int] = set()
    for labels, values in zip(pending.spots, pending.values, strict=True):
        robot = int(values[ROBOT])
        # Spots of a robot that was found beyond doubt are no evidence for another, nor for another place of its own,
        # unless that is much brighter: then the claim may be a mirror image that has caught one of the robot's LEDs.
        others = taken
        if robot in claim_of:
            k = claim_of[robot]
            if values[FIT_HEIGHT] * MIRROR_RATIO > claims.values[k, FIT_HEIGHT]:
                others = taken - set(claims.spots[k].tolist())
        if known[robot] or others & set(labels.tolist()):
            continue
        hypotheses += _scored(robot, labels, sigma, spots, plan, wanted)
        if robot in claim_of:
            disputed.add(robot)
    disputed |= {robot for robot, k in claim_of.items() if worse[k]}
    for robot in sorted(disputed):
        hypotheses += _scored(robot, claims.spots[claim_of[robot]], sigma, spots, plan, wanted)
    chosen, doubts = assign.assign(hypotheses)
    found = [(h.robot, np.array(h.spots), h.rotation, h.t) for h in chosen]
    for robot, k in claim_of.items():
        if robot not in disputed:
            found.append((robot, claims.spots[k], claims.rotations[k], claims.ts[k]))
    outshone = _outshone(spots, plan, sigma, found)
    for robot in outshone:
        doubts[robot] = assign.TWO_PLACES
        found = [entry for entry in found if entry[0] != robot]
    # Of a rig that is off some five LEDs may fit by chance, and a spot lies where the sixth should be but for that.
    doubtful = [entry for entry in found if _has_one_beside(spots, plan, entry, found)]
    if len(found) == wanted and not doubtful and not doubts:
        return found, doubts
    sure = [entry for entry in found if all(entry is not other for other in doubtful)]
    wanted_still = ~known
    wanted_still[[robot for robot, *_ in sure]] = False
    wanted_still[[robot for robot, why in doubts.items() if why == assign.TWO_PLACES]] = False
    rivals = [h for h in hypotheses if wanted_still[h.robot]]
    # Claims that were disputed and not upheld leave their spots.
    more, loose_doubts = loose(spots._replace(free=free), plan, misfits, sure, wanted_still, rivals)
    decided = {robot for robot, *_ in more}
    found = sure + more + [entry for entry in doubtful if entry[0] not in decided | loose_doubts.keys()]
    doubts = {robot: why for robot, why in (loose_doubts | doubts).items() if robot not in decided}
    wanted_still[[robot for robot, *_ in found]] = False
    wanted_still[list(doubts)] = False
    return found + fours(spots, plan, sigma, found, wanted_still, doubts), doubts


def _has_one_beside(spots: Spots, plan: Plan, entry: Found, found: list[Found]) -> bool:
    """Whether a robot lacks an LED near whose place a spot like its others is nobody's."""
    robot, labels, rotation, t = entry
    if -1 not in labels.tolist():
        return False
    lacking = np.flatnonzero(labels < 0)
    free = spots.free.copy()
    for _, others, _, _ in found:
        free[others[others >= 0]] = False
    height = float(median_of(spots.heights, labels))
    like = free & (spots.heights > LEAST_LIKE * height) & (spots.heights < MOST_LIKE * height)
    places = plan.layouts[robot][lacking] @ rotation.T + t
    flat = places[:, :2] / places[:, 2:] * [plan.focal, -plan.focal]
    away = np.hypot(*(spots.flat[like][:, None] - flat).transpose(2, 0, 1))
    return bool((away < BESIDE * tolerance_px(plan)).any())


def _outshone(spots: Spots, plan: Plan, sigma_px: float, found: list[Found]) -> set[int]:
    """The robots of ``found`` that four or more much brighter spots show elsewhere.

    Over a polished floor the mirror image of a robot that lacks LEDs shows more of them than the robot.
    """
    if not found:
        return set()
    rivals, medians, usable = _rivals(spots, np.array([entry[1] for entry in found]))
    if rivals < 4:
        return set()
    heights = dict(zip((entry[0] for entry in found), medians.tolist(), strict=True))
    brightness = np.full(len(plan.layouts), np.inf)  # robots that were not found are of no interest here
    for robot, height in heights.items():
        brightness[robot] = height / MIRROR_RATIO**2
    bright = spots._replace(free=usable)
    _, places = searched(bright, plan, np.ones(len(plan.layouts), np.bool_), brightness, 4)
    outshone = set()
    for labels, values in zip(places.spots, places.values, strict=True):
        robot = int(values[ROBOT])
        for rival in _scored(robot, labels, sigma_px, bright, plan, 1):
            if rival.score > assign.RIVAL and rival.height * MIRROR_RATIO > heights[robot]:
                outshone.add(robot)
    return outshone


def _rivals(spots: Spots, labels: Ints) -> tuple[int, Floats, NDArray[np.bool_]]:
    """How many spots are much brighter than the dimmest of robots that were found, ``labels`` (m, 6) their spots; the
    median heights (m,) of these, and the spots (n,) that may show them elsewhere.
    """
    medians, usable = np.empty(len(labels)), np.empty(len(spots.heights), np.bool_)
    medians_of(spots.heights, labels, medians)
    return rivals_of(spots.heights, labels, MIRROR_RATIO, medians, usable), medians, usable


def _scored(
    robot: int, labels: Ints, sigma_px: float, spots: Spots, plan: Plan, wanted: int
) -> list[assign.Hypothesis]:
    """The best version of a fit with its score; nothing if there is no pose."""
    best = Version(np.empty(LEDS, np.int64), np.empty((3, 3)), np.empty(3))
    value, height = best_version(
        plan.layouts[robot], plan.extents[robot], labels, spots, plan.focal, sigma_px, wanted, best
    )
    if value == -np.inf:
        return []
    return [assign.Hypothesis(robot, tuple(best.labels.tolist()), height, value, best.rotation, best.t)]
