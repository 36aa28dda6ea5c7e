"""Who is who: warm where robots were a moment ago, cold for the rest, doubts kept as doubts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.server.identity.cold import find
from asterism.server.identity.follow import follow
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan
from asterism.server.identity.rays import Rays
from asterism.server.pose.matched import Matched
from asterism.server.pose.sphere import lay_flat
from asterism.server.pose.track import Tracks


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """The robots that were ``found``, their spots rows of the `Rays`, those that were followed first: ``warm`` of them.

    ``doubts`` says why a robot that is not among them is ambiguous.
    """

    found: Matched
    warm: int
    doubts: dict[int, str]


def identify(seen: Rays, plan: Plan, tracks: Tracks, exposed_ns: int) -> Matches:
    """Match spots to robots: those that were there a moment ago first, the rest searched cold."""
    robots = len(plan.layouts)
    free = np.ones(len(seen.rows), np.bool_)
    spots = Spots(seen.flat, seen.rays, seen.variances, seen.heights, seen.radii, free)
    room = Matched.room(robots)
    warm = follow(spots, plan.constellations, plan.extents, plan.focal, tracks, exposed_ns, room)
    found, doubts = room.first(warm), dict[int, str]()
    if warm < robots and np.count_nonzero(free) >= 4:
        flat, variances = np.empty_like(seen.flat), np.empty_like(seen.variances)
        lay_flat(seen.rays, seen.covariances, plan.focal, flat, variances)
        found, doubts = _searched(spots._replace(flat=flat, variances=variances), plan, found)
    return Matches(found, warm, doubts)


def _searched(spots: Spots, plan: Plan, followed: Matched) -> tuple[Matched, dict[int, str]]:
    """The robots that were ``followed`` and those that a cold search finds beside them, and the doubts it leaves."""
    known: NDArray[np.bool_] = np.zeros(len(plan.layouts), np.bool_)
    known[followed.robots] = True
    found, doubts = find(spots, plan, known)
    if not found:
        return followed, doubts
    columns = zip(followed, zip(*found, strict=True), strict=True)
    return Matched(*(np.concatenate([before, np.array(more)]) for before, more in columns)), doubts
