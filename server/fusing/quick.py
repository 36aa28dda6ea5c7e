"""Claims where nothing is open: every robot is foreseen, and its cameras say whose all their spots are.

Most exposures are of this kind, and need no search. If a robot's rays then surprise, all is looked at again (`fuse`).
"""

from collections.abc import Mapping, Sequence

from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Pose
from asterism.server.fusing.claims import Claim
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.memory import Foresight
from asterism.server.fusing.sighting import Sighting


def quick_claims(
    fleet: Fleet, sightings: Sequence[Sighting], foreseen: Foresight, exposed_ns: int
) -> Mapping[str, Claim] | None:
    """Every robot's spots as the cameras claim them; none where a spot, or a robot, needs a closer look."""
    if not all(sighting.is_settled and _all_told(sighting) for sighting in sightings):
        return None
    claims = {}
    for robot in fleet.robots:
        known = foreseen(robot, exposed_ns)
        by = [sighting for sighting in sightings if robot in sighting.spots]
        if known is None or not by:
            return None
        others = [pose for sighting in by for pose in _other_tilt(sighting, robot)]
        claims[robot] = Claim(robot, {one.camera: one.spots[robot] for one in by}, (known.pose, *others))
    return claims


def _all_told(sighting: Sighting) -> bool:
    """Whether the camera tells where all robots are whose LEDs it found."""
    return all(sighting.told[robot].HasField("pose") for robot in sighting.spots)


def _other_tilt(sighting: Sighting, robot: str) -> list[Pose]:
    told = sighting.told[robot]
    if not told.HasField("alternative"):
        return []
    return [report_pose(told.pose), report_pose(told.alternative.pose)]
