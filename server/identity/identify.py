"""Who is who: warm where robots were a moment ago, cold for the rest, doubts kept as doubts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.identity.cold import find
from asterism.server.identity.explain import explain
from asterism.server.identity.follow import follow
from asterism.server.identity.fours import DOUBT
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan
from asterism.server.identity.rays import Rays
from asterism.server.pose.matched import Matched
from asterism.server.pose.sphere import lay_flat
from asterism.server.pose.track import KNOWN, Tracks


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """The robots that were ``found``, their spots rows of the `Rays`, those that were followed first: ``warm`` of them.

    ``doubts`` says why a robot that is not among them is ambiguous, ``reasons`` why one is missing, where anything
    explains it.
    """

    found: Matched
    warm: int
    doubts: dict[int, str]
    reasons: dict[int, str]


def identify(seen: Rays, plan: Plan, tracks: Tracks, exposed_ns: int) -> Matches:
    """Match spots to robots: those that were there a moment ago first, the rest searched cold."""
    robots = len(plan.layouts)
    free = np.ones(len(seen.rows), np.bool_)
    spots = Spots(seen.flat, seen.rays, seen.variances, seen.heights, seen.radii, free)
    room = Matched.room(robots)
    warm = 0
    if np.count_nonzero(tracks.seen_ns):
        warm = follow(spots, plan.constellations, plan.extents, plan.focal, tracks, exposed_ns, room)
    found, doubts = room.first(warm), dict[int, str]()
    if warm < robots and np.count_nonzero(free) >= 4:
        flat, variances = np.empty_like(seen.flat), np.empty_like(seen.variances)
        lay_flat(seen.rays, seen.covariances, plan.focal, flat, variances)
        spots = spots._replace(flat=flat, variances=variances)
        found, doubts = _searched(spots, plan, found, tracks.misfits[:, KNOWN])
    return Matches(found, warm, *_explained(spots, plan, found, doubts, tracks, exposed_ns))


def _searched(spots: Spots, plan: Plan, followed: Matched, misfits: Floats) -> tuple[Matched, dict[int, str]]:
    """The robots that were ``followed`` and those that a cold search finds beside them, and the doubts it leaves."""
    known: NDArray[np.bool_] = np.zeros(len(plan.layouts), np.bool_)
    known[followed.robots] = True
    found, doubts = find(spots, plan, known, misfits)
    if not len(followed.robots):
        return found, doubts
    return Matched(*(np.concatenate(both) for both in zip(followed, found, strict=True))), doubts


def _explained(
    spots: Spots, plan: Plan, found: Matched, doubts: dict[int, str], tracks: Tracks, exposed_ns: int
) -> tuple[dict[int, str], dict[int, str]]:
    """The doubts, said better where anything explains them, and the reasons of the other robots that are missing."""
    missing = np.ones(len(plan.layouts), np.bool_)
    missing[found.robots] = False
    if doubts:
        missing[[robot for robot, why in doubts.items() if why != DOUBT]] = False
    if not np.count_nonzero(missing):
        tracks.reasons[:] = 0.0
        return doubts, {}
    spots.free[:] = True
    spots.free[found.assignment[found.assignment >= 0]] = False
    reasons = explain(spots, plan, missing, tracks, exposed_ns)
    return {robot: reasons.pop(robot, why) for robot, why in doubts.items()}, reasons
