"""Who is who: warm where robots were a moment ago, cold for the rest, doubts kept as doubts."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server import assign
from asterism.server.blobs import Blobs, Ints
from asterism.server.follow import follow, gates_px, gather_missing
from asterism.server.plan import MOST_TILT, Plan
from asterism.server.planar import NO_SOLUTION
from asterism.server.search import CHI2, COST, LEDS, ROBOT, SYSTEMATIC_PX, median_of, refit_versions, search
from asterism.server.search import HEIGHT as FIT_HEIGHT
from asterism.server.track import HEIGHT, Tracks, predict

WIDEST_GATE = 0.25  # of a constellation's image; beyond that a prediction is no help
GATHER_PX = 1.5  # a found robot's missing LED is looked for this near to its place
PRIOR_SYSTEMATIC_PX = 0.08  # what to expect of calibration and LED positions before a robot was seen
MOST_CLAIMS, MOST_PENDING = 256, 1024


@dataclass(slots=True, eq=False)
class Matches:
    """Robots with their spots: row i of every array is the same robot.

    ``robots`` (m,) indices into the rig; ``assignment`` (m, 6) rows of the frame's blobs, -1 for LEDs not seen;
    ``rotations`` (m, 3, 3), ``ts`` (m, 3) T_camera_plane; ``is_warm`` (m,). ``doubts`` says why a robot that is not
    among them is ambiguous.
    """

    robots: Ints
    assignment: Ints
    rotations: Floats
    ts: Floats
    is_warm: NDArray[np.bool_]
    doubts: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """The kept spots as the matching sees them; row i is blob ``rows[i]``."""

    rows: Ints
    flat: Floats  # (n, 2) ideal px about the principal point, y up
    rays: Floats  # (n, 2) x / z, y / z
    covariances: Floats  # (n, 3) of the rays
    variances: Floats  # (n,) of the rays, mean of both axes
    heights: Floats  # (n,)
    radii: Floats  # (n,) px


def rays_of(blobs: Blobs, rows: Ints, rays: Floats, covariances: Floats, focal: float) -> Rays:
    """Collect what the matching needs of the kept spots."""
    flat = rays * np.array([focal, -focal])
    variances = 0.5 * (covariances[:, 0] + covariances[:, 2])
    return Rays(rows, flat, rays, covariances, variances, blobs.heights[rows], blobs.radii_px[rows])


Found = tuple[int, Ints, Floats, Floats]  # robot, spots, rotation, translation


def identify(seen: Rays, plan: Plan, tracks: Tracks, exposed_ns: int) -> Matches:
    """Match spots to robots: those that were there a moment ago first, the rest searched cold."""
    n_robots = len(plan.layouts)
    free = np.ones(len(seen.rows), np.bool_)
    robots, assignment, rotations, ts = _follow(seen, free, plan, tracks, exposed_ns)
    warm = np.ones(len(robots), np.bool_)
    doubts: dict[int, str] = {}
    if len(robots) < n_robots and int(free.sum()) >= 5:
        claimed = np.zeros(n_robots, np.bool_)
        brightness = np.zeros(n_robots)
        claimed[robots] = True
        # A robot that was followed to its place has no rival: only a much brighter one would count.
        brightness[robots] = np.inf
        found, doubts = _search(seen, free, plan, claimed, brightness)
        if found:
            robots = np.concatenate([robots, [entry[0] for entry in found]])
            assignment = np.concatenate([assignment, [entry[1] for entry in found]])
            rotations = np.concatenate([rotations, [entry[2] for entry in found]])
            ts = np.concatenate([ts, [entry[3] for entry in found]])
            warm = np.concatenate([warm, np.zeros(len(found), np.bool_)])
    return Matches(robots, assignment, rotations, ts, warm, doubts)


def _follow(
    seen: Rays, free: NDArray[np.bool_], plan: Plan, tracks: Tracks, exposed_ns: int
) -> tuple[Ints, Ints, Floats, Floats]:
    """Warm matching of the robots whose prediction is good enough: robots, spots, rotations, translations."""
    n = len(plan.layouts)
    index, rotations, ts, sigmas = np.empty(n, np.int64), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 2))
    count = predict(
        tracks.seen_ns, tracks.rotations, tracks.ts, tracks.velocities, tracks.turns, tracks.numbers, exposed_ns,
        index, rotations, ts, sigmas,
    )  # fmt: skip
    index, rotations, ts, sigmas = index[:count], rotations[:count], ts[:count], sigmas[:count]
    depths, extents = np.maximum(ts[:, 2], 1e-6), plan.extents[index]
    gates = gates_px(sigmas[:, 0], sigmas[:, 1], extents, plan.focal, depths)
    usable = (ts[:, 2] > 0.0) & (gates <= WIDEST_GATE * extents * plan.focal / depths)
    if not usable.all():
        index, rotations, ts, gates = index[usable], rotations[usable], ts[usable], gates[usable]
    heights = tracks.numbers[index, HEIGHT]
    assignment, costs = np.full((len(index), LEDS), -1), np.empty(len(index))
    layouts = plan.layouts[index]
    follow(
        seen.flat, seen.rays, seen.variances, seen.heights, free, layouts, rotations, ts, gates, heights,
        plan.focal, assignment, costs,
    )  # fmt: skip
    gather_missing(
        seen.flat, seen.heights, free, layouts, rotations, ts, costs, heights, plan.focal, GATHER_PX, assignment,
    )  # fmt: skip
    good = costs < NO_SOLUTION
    return index[good], assignment[good], rotations[good], ts[good]


def _search(
    seen: Rays, free: NDArray[np.bool_], plan: Plan, claimed: NDArray[np.bool_], brightness: Floats
) -> tuple[list[Found], dict[int, str]]:
    """Cold search and global assignment."""
    known = claimed.copy()
    claims = np.empty((MOST_CLAIMS, LEDS), np.int64)
    pending = np.empty((MOST_PENDING, LEDS), np.int64)
    claim_values, pending_values = np.empty((MOST_CLAIMS, 4)), np.empty((MOST_PENDING, 4))
    claim_rotations, pending_rotations = np.empty((MOST_CLAIMS, 3, 3)), np.empty((MOST_PENDING, 3, 3))
    claim_ts, pending_ts = np.empty((MOST_CLAIMS, 3)), np.empty((MOST_PENDING, 3))
    n_claims, n_pending, _ = search(
        seen.flat, seen.rays, seen.variances, seen.heights, seen.radii, free, plan.layouts, plan.separations, claimed,
        brightness,
        plan.convex, plan.concave, plan.focal, plan.near, plan.far, MOST_TILT, plan.reach_px, 5,
        claims, claim_values, claim_rotations, claim_ts, pending, pending_values, pending_rotations, pending_ts,
    )  # fmt: skip
    sigma = assign.systematic_sigma(claim_values[:n_claims, COST], SYSTEMATIC_PX, PRIOR_SYSTEMATIC_PX)
    wanted = int((~known).sum())
    claim_of = {int(claim_values[k, ROBOT]): k for k in range(n_claims)}
    taken = set(claims[:n_claims].ravel().tolist())
    hypotheses: list[assign.Hypothesis] = []
    disputed: set[int] = set()
    for k in range(n_pending):
        robot = int(pending_values[k, ROBOT])
        # Spots of a robot that was found beyond doubt are no evidence for another, nor for another place of its own,
        # unless that is much brighter: then the claim may be a mirror image that has caught one of the robot's LEDs.
        others = taken
        if robot in claim_of:
            k_claim = claim_of[robot]
            if pending_values[k, FIT_HEIGHT] * assign.MIRROR_RATIO > claim_values[k_claim, FIT_HEIGHT]:
                others = taken - set(claims[k_claim].tolist())
        if known[robot] or others & set(pending[k].tolist()):
            continue
        hypotheses += _versions(robot, pending[k], sigma, seen, free, plan, wanted)
        if robot in claim_of:
            disputed.add(robot)
    for robot, k in claim_of.items():
        # With what the other robots' fits have told, a fit may look worse than it did.
        variance = sigma**2 + float(median_of(seen.variances, claims[k])) * plan.focal**2
        if claim_values[k, COST] * SYSTEMATIC_PX**2 > CHI2[LEDS] * variance:
            disputed.add(robot)
    for robot in sorted(disputed):
        hypotheses += _versions(robot, claims[claim_of[robot]], sigma, seen, free, plan, wanted)
    chosen, doubts = assign.assign(hypotheses)
    found = [(h.robot, np.array(h.spots), h.rotation, h.t) for h in chosen]
    for robot, k in claim_of.items():
        if robot not in disputed:
            found.append((robot, claims[k], claim_rotations[k], claim_ts[k]))
    outshone = _outshone(seen, plan, sigma, found)
    for robot in outshone:
        doubts[robot] = assign.TWO_PLACES
    return [entry for entry in found if entry[0] not in outshone], doubts


def _outshone(seen: Rays, plan: Plan, sigma_px: float, found: list[Found]) -> set[int]:
    """The robots of ``found`` that four or more much brighter spots show elsewhere.

    Over a polished floor the mirror image of a robot that lacks LEDs shows more of them than the robot.
    """
    n = len(plan.layouts)
    heights = {robot: float(median_of(seen.heights, spots)) for robot, spots, _, _ in found}
    usable = np.ones(len(seen.rows), np.bool_)
    for robot, spots, _, _ in found:
        own = spots[spots >= 0]
        # A mirror image may have caught one of the robot's own LEDs.
        usable[own] = seen.heights[own] * assign.MIRROR_RATIO > heights[robot]
    if not found or (seen.heights[usable] * assign.MIRROR_RATIO > min(heights.values())).sum() < 4:
        return set()
    brightness = np.full(n, np.inf)  # nothing is brighter: robots that were not found are of no interest here
    for robot, height in heights.items():
        brightness[robot] = height / assign.MIRROR_RATIO**2
    places = np.empty((MOST_PENDING, LEDS), np.int64)
    values, rotations, ts = np.empty((MOST_PENDING, 4)), np.empty((MOST_PENDING, 3, 3)), np.empty((MOST_PENDING, 3))
    nothing, no_values = np.empty((0, LEDS), np.int64), np.empty((0, 4))
    _, count, _ = search(
        seen.flat, seen.rays, seen.variances, seen.heights, seen.radii, usable, plan.layouts, plan.separations,
        np.ones(n, np.bool_), brightness,
        plan.convex, plan.concave, plan.focal, plan.near, plan.far, MOST_TILT, plan.reach_px, 4,
        nothing, no_values, rotations[:0], ts[:0], places, values, rotations, ts,
    )  # fmt: skip
    outshone = set()
    for k in range(count):
        robot = int(values[k, ROBOT])
        for rival in _versions(robot, places[k], sigma_px, seen, usable, plan, 1):
            if rival.score > assign.RIVAL and rival.height * assign.MIRROR_RATIO > heights[robot]:
                outshone.add(robot)
    return outshone


def _versions(
    robot: int, spots: Ints, sigma_px: float, seen: Rays, free: NDArray[np.bool_], plan: Plan, wanted: int
) -> list[assign.Hypothesis]:
    """Score a fit, and what it is without each of its LEDs: one of them may be somebody else's light.

    How many spots of like brightness lie around decides how easily chance makes such a fit.
    """
    versions, costs = np.empty((1 + LEDS, LEDS), np.int64), np.empty(1 + LEDS)
    rotations, ts = np.empty((1 + LEDS, 3, 3)), np.empty((1 + LEDS, 3))
    count = refit_versions(
        plan.layouts[robot], spots, seen.rays, seen.variances, (sigma_px / plan.focal) ** 2,
        versions, costs, rotations, ts,
    )  # fmt: skip
    scored = []
    for k in range(count):
        if costs[k] >= NO_SOLUTION:
            continue
        visible = versions[k][versions[k] >= 0]
        heights = seen.heights[visible]
        height = float(np.median(heights))
        radius = 0.75 * float(plan.extents[robot]) * plan.focal / float(ts[k, 2])
        middle = seen.flat[visible].mean(axis=0)
        like = (seen.heights > 0.4 * height) & (seen.heights < 2.5 * height) & free
        like &= np.hypot(seen.flat[:, 0] - middle[0], seen.flat[:, 1] - middle[1]) < radius
        value = assign.score(
            float(costs[k]),
            sigma_px**2 + seen.variances[visible] * plan.focal**2,
            heights,
            seen.radii[visible],
            int(like.sum()),
            math.pi * radius * radius,
            wanted,
        )
        scored.append(assign.Hypothesis(robot, tuple(versions[k].tolist()), height, value, rotations[k], ts[k]))
    return [max(scored, key=lambda h: h.score)] if scored else []
