"""Cold identification: search, scores, assignment, and the robots whose mirror image or double stands elsewhere."""

import numpy as np
from numpy.typing import NDArray

from asterism.server.centres.blobs import Ints
from asterism.server.identity import assign
from asterism.server.identity.evidence import Version, best_version
from asterism.server.identity.fours import fours
from asterism.server.identity.hypotheses import COST, ROBOT, Found
from asterism.server.identity.hypotheses import HEIGHT as FIT_HEIGHT
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan
from asterism.server.identity.search import MIRROR_RATIO, searched
from asterism.server.pose.fit import CHI2, LEDS, SYSTEMATIC_PX, median_of

PRIOR_SYSTEMATIC_PX = 0.08  # what to expect of calibration and LED positions before a robot was seen


def find(spots: Spots, plan: Plan, known: NDArray[np.bool_]) -> tuple[list[Found], dict[int, str]]:
    """Who is among the free spots, but for the robots that are ``known``; and why a robot is in doubt."""
    claimed = known.copy()
    brightness = np.zeros(len(known))
    # A robot that was followed to its place has no rival: only a much brighter one would count.
    brightness[known] = np.inf
    claims, pending = searched(spots, plan, claimed, brightness, 5)
    sigma = assign.systematic_sigma(claims.values[:, COST], SYSTEMATIC_PX, PRIOR_SYSTEMATIC_PX)
    wanted = int((~known).sum())
    claim_of = {int(values[ROBOT]): k for k, values in enumerate(claims.values)}
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
    for robot, k in claim_of.items():
        # With what the other robots' fits have told, a fit may look worse than it did.
        variance = sigma**2 + float(median_of(spots.variances, claims.spots[k])) * plan.focal**2
        if claims.values[k, COST] * SYSTEMATIC_PX**2 > CHI2[LEDS] * variance:
            disputed.add(robot)
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
    found = [entry for entry in found if entry[0] not in outshone]
    wanted_still = ~known
    wanted_still[[robot for robot, *_ in found]] = False
    wanted_still[list(doubts)] = False
    return found + fours(spots, plan, sigma, found, wanted_still, doubts), doubts


def _outshone(spots: Spots, plan: Plan, sigma_px: float, found: list[Found]) -> set[int]:
    """The robots of ``found`` that four or more much brighter spots show elsewhere.

    Over a polished floor the mirror image of a robot that lacks LEDs shows more of them than the robot.
    """
    if not found:
        return set()
    heights = {robot: float(median_of(spots.heights, labels)) for robot, labels, _, _ in found}
    usable = spots.heights > min(heights.values())
    for robot, labels, _, _ in found:
        own = labels[labels >= 0]
        # A mirror image may have caught one of the robot's own LEDs.
        usable[own] = spots.heights[own] * MIRROR_RATIO > heights[robot]
    if (spots.heights[usable] * MIRROR_RATIO > min(heights.values())).sum() < 4:
        return set()
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
