"""Which spots of all cameras are whose LEDs: what the cameras say, and what all of them together show beyond it.

What the cameras claim is the base, where they do not contradict each other (`told`). A robot whose pose is known by
that, or was foreseen, projects into every camera, and takes the unexplained spots there that are its LEDs (`expected`).
What is left may show robots that nobody knows of (`cold`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Pose
from asterism.server.centres.blobs import Ints
from asterism.server.fusing.cold import searched
from asterism.server.fusing.decide import Doubts
from asterism.server.fusing.expected import completed, followed, is_enough, unshared
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.joined import Foreseen, Foresight, Hypothesis, Joined, without
from asterism.server.fusing.sighting import Sighting
from asterism.server.fusing.tilts import other_tilts
from asterism.server.fusing.told import Said, judged, labels_said, said_of, undisputed
from asterism.server.fusing.words import contradicted, nowhere, too_few
from asterism.server.pose.solve import Lost

__all__ = ["Claim", "Foreseen", "Foresight", "claims_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One robot's spots: ``spots`` by the camera's name (6,), rows of its `Sighting`, -1 for LEDs not seen; cameras
    that see none of its LEDs are not there.

    ``starts`` are poses T_world_robot from which to solve, the likeliest first: both tilts where nothing decides.
    """

    robot: str
    spots: Mapping[str, NDArray[np.int64]]
    starts: tuple[Pose, ...]


def claims_of(fleet: Fleet, sightings: Sequence[Sighting], foreseen: Foresight) -> Mapping[str, Claim | Lost]:
    """Every robot's spots by the fleet's ids, in its order, or why there are none: LOST, or IDENTITY_AMBIGUOUS.

    ``sightings`` are the newest of the cameras, one each; ``foreseen`` is asked where robots should be at their times.
    """
    joined = Joined.of(fleet, sightings, foreseen)
    said = {robot.id: groups for robot in fleet.robots.values() if (groups := said_of(joined, robot))}
    agreed, disputes = undisputed(joined, said)
    free = np.concatenate([sighting.robots < 0 for sighting in sightings])
    found: dict[str, Hypothesis] = {}
    doubts: Doubts = {}
    for robots in disputes:
        right, doubtful = judged(joined, robots, said, free)
        found |= {one.robot: one for one in right}
        doubts |= doubtful
        # What the cameras that were wrong had claimed is nobody's again.
        for group in (group for robot in robots for group in said[robot]):
            labels = labels_said(joined, group)
            free[labels[labels >= 0]] = True
        free = without(free, [*right, *(one for explanations in doubtful.values() for one in explanations)])
    known = {robot: labels_said(joined, group) for robot, group in agreed.items()}
    taken, weak = _expected(joined, agreed, known, free, found.keys() | doubts.keys())
    found |= taken
    free = without(free, found.values())
    sought = [r for r in fleet.robots.values() if r.id not in found.keys() | known.keys() | doubts.keys()]
    cold, cold_doubts = searched(joined, sought, free)
    found |= {one.robot: one for one in cold}
    doubts |= cold_doubts
    return {robot: _answer(joined, robot, agreed, known, found, doubts, weak, free) for robot in fleet.robots}


def _expected(
    joined: Joined, agreed: dict[str, Said], known: dict[str, Ints], free: NDArray[np.bool_], others: set[str]
) -> tuple[dict[str, Hypothesis], dict[str, Hypothesis]]:
    """What robots whose pose is known take of the free spots, and what is too little to know them by."""
    if not free.any():
        return {}, {}
    told: dict[str, Hypothesis] = {}
    for robot in joined.fleet.robots.values():
        if robot.id in others:
            continue
        if robot.id in agreed:
            one = completed(joined, robot, known[robot.id], agreed[robot.id].starts()[:2], free)
        else:
            one = followed(joined, robot, free)
        if one is not None:
            told[robot.id] = one
    nothing = joined.no_labels()
    told = unshared(joined, {robot: known.get(robot, nothing) for robot in told}, told)
    enough = {r: r in agreed or is_enough(joined, joined.fleet.robots[r], one) for r, one in told.items()}
    return {r: one for r, one in told.items() if enough[r]}, {r: one for r, one in told.items() if not enough[r]}


def _answer(
    joined: Joined, robot: str, agreed: dict[str, Said], known: dict[str, Ints], found: dict[str, Hypothesis],
    doubts: Doubts, weak: dict[str, Hypothesis], free: NDArray[np.bool_],
) -> Claim | Lost:  # fmt: skip
    if robot in found:
        one = found[robot]
        starts = agreed[robot].starts() if robot in agreed else other_tilts(joined, joined.fleet.robots[robot], one)
        return Claim(robot, joined.spots_of(one.labels), (one.pose, *starts))
    if robot in agreed:
        return Claim(robot, joined.spots_of(known[robot]), agreed[robot].starts())
    if robot in doubts:
        return Lost(contradicted(joined, doubts[robot]), "IDENTITY_AMBIGUOUS")
    return Lost(too_few(joined, weak[robot]) if robot in weak else nowhere(joined, free))
