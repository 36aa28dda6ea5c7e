"""Claims where nothing is open: every robot is foreseen, and its cameras say whose all their spots are.

Most exposures are of this kind, and need no search. If a robot's rays then surprise, all is looked at again (`fuse`).
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Pose
from asterism.server.fusing.claims import Claim
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.memory import Foresight
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.fit import LEDS


def quick_claims(
    fleet: Fleet, sightings: Sequence[Sighting], foreseen: Foresight, exposed_ns: int
) -> Mapping[str, Claim] | None:
    """Every robot's spots as the cameras claim them; none where a spot, or a robot, needs a closer look."""
    said = [(sighting, _labels(sighting)) for sighting in sightings]
    if any(labels is None for _, labels in said):
        return None
    claims = {}
    for robot in fleet.robots:
        known = foreseen(robot, exposed_ns)
        spots = {one.camera: labels[robot] for one, labels in said if labels is not None and robot in labels}
        if known is None or not spots:
            return None
        others = [pose for one, _ in said if one.camera in spots for pose in _other_tilt(one, robot)]
        claims[robot] = Claim(robot, spots, (known.pose, *others))
    return claims


def _labels(sighting: Sighting) -> dict[str, NDArray[np.int64]] | None:
    """A camera's spots by the robots that it found; none where other spots may be LEDs as well."""
    ids = list(sighting.told)
    owned = sighting.robots >= 0
    labels = np.full((len(ids), LEDS), -1)
    labels[sighting.robots[owned], sighting.leds[owned]] = np.flatnonzero(owned)
    if not owned.all() and (labels < 0).any():
        return None
    found = np.flatnonzero((labels >= 0).any(axis=1)).tolist()
    if not all(sighting.told[ids[k]].HasField("pose") for k in found):
        return None
    return {ids[k]: labels[k] for k in found}


def _other_tilt(sighting: Sighting, robot: str) -> list[Pose]:
    told = sighting.told[robot]
    if not told.HasField("alternative"):
        return []
    return [report_pose(told.pose), report_pose(told.alternative.pose)]
