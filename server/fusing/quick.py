"""Claims where nothing is open: every robot is foreseen, and its cameras say whose all their spots are.

Most exposures are of this kind, and need no search. If a robot's rays then surprise, all is looked at again (`fuse`).
"""

from collections.abc import Mapping, Sequence

from asterism.server.fusing.claims import Claim
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.memory import Foresight
from asterism.server.fusing.sighting import Sighting


def quick_claims(
    fleet: Fleet, sightings: Sequence[Sighting], foreseen: Foresight, exposed_ns: int
) -> Mapping[str, Claim] | None:
    """Every robot's spots as the cameras claim them; none where a spot, or a robot, needs a closer look."""
    if not all(sighting.is_clear for sighting in sightings):
        return None
    claims = {}
    for robot in fleet.robots:
        known = foreseen(robot, exposed_ns)
        spots = {one.camera: one.spots[robot] for one in sightings if robot in one.spots}
        if known is None or not spots:
            return None
        tilts = [pose for one in sightings for pose in one.tilts.get(robot, ())]
        claims[robot] = Claim(robot, spots, (known.pose, *tilts))
    return claims
