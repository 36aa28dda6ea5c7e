"""What the cameras themselves say whose spots are whose: what they agree on, and where they contradict each other.

Cameras that see a robot at about the same place, in one of their tilts, mean the same robot, however far they are off:
that is for the joint solution to say. One that sees it elsewhere, or takes for another robot what others take for it,
contradicts them; then the spots of all decide.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Robot
from asterism.server.centres.blobs import Ints
from asterism.server.fusing.decide import Doubts, decided
from asterism.server.fusing.joined import Hypothesis, Joined

NEAR = 0.3  # of a robot's extent: places that are about the same
TURNED = 0.35  # rad: and turns
FASTEST = 2.0, 6.0  # m/s and rad/s: what a robot may do between two exposures


@dataclass(frozen=True, slots=True, eq=False)
class Said:
    """Cameras that agree on a robot: by their numbers the poses T_world_robot that each says, the likeliest first."""

    robot: str
    poses: dict[int, tuple[Pose, ...]]

    def starts(self) -> tuple[Pose, ...]:
        """All the poses, those first that the other cameras say too."""
        every = [pose for poses in self.poses.values() for pose in poses]
        if len(every) == len(self.poses):
            return tuple(every)
        return tuple(sorted(every, key=self._contradicted))

    def _contradicted(self, pose: Pose) -> float:
        return sum(min(_apart(pose, other)[1] for other in poses) for poses in self.poses.values())


def _apart(one: Pose, other: Pose) -> tuple[float, float]:
    """Distance, m, and angle, rad, of two poses."""
    turned = 2.0 * math.acos(min(1.0, abs(float(one.orientation @ other.orientation))))
    return math.dist(one.position, other.position), turned


def said_of(joined: Joined, robot: Robot) -> list[Said]:
    """Who says where a robot is: one entry for all that agree, more where cameras contradict each other."""
    groups: list[Said] = []
    for c, sighting in enumerate(joined.sightings):
        told = sighting.told.get(robot.id)
        if told is None or not told.HasField("pose"):
            continue
        poses: tuple[Pose, ...] = (report_pose(told.pose),)
        if told.HasField("alternative"):
            poses += (report_pose(told.alternative.pose),)
        for group in groups:
            if _agree(joined, robot, c, poses, group):
                group.poses[c] = poses
                break
        else:
            groups.append(Said(robot.id, {c: poses}))
    return groups


def _agree(joined: Joined, robot: Robot, c: int, poses: tuple[Pose, ...], group: Said) -> bool:
    """Whether a camera means the same as any of a group."""
    for other, others in group.poses.items():
        dt = abs(joined.sightings[c].exposed_ns - joined.sightings[other].exposed_ns) * 1e-9
        for pose in poses:
            for there in others:
                away, turned = _apart(pose, there)
                if away < NEAR * robot.extent + FASTEST[0] * dt and turned < TURNED + FASTEST[1] * dt:
                    return True
    return False


def labels_said(joined: Joined, said: Said) -> Ints:
    """The spots (C, 6) that these cameras give the robot, rows of the scene."""
    labels = joined.no_labels()
    for c in said.poses:
        sighting = joined.sightings[c]
        rows = np.flatnonzero(sighting.robots == list(sighting.told).index(said.robot))
        labels[c, sighting.leds[rows]] = rows + joined.scene.first[c]
    return labels


def undisputed(joined: Joined, said: dict[str, list[Said]]) -> tuple[dict[str, Said], list[set[str]]]:
    """What nobody contradicts, and the sets of robots of which cameras say what cannot all be true."""
    disputes = [{robot} for robot, groups in said.items() if len(groups) > 1]
    single = [groups[0] for groups in said.values() if len(groups) == 1]
    for k, one in enumerate(single):
        for other in single[k + 1 :]:
            if not one.poses.keys() & other.poses.keys() and _overlap(joined, one, other):
                disputes.append({one.robot, other.robot})
    for robots in list(disputes):
        for robot, groups in said.items():
            if robot not in robots and any(
                _overlap(joined, mine, theirs)
                for mine in groups for disputed in robots for theirs in said[disputed]
            ):  # fmt: skip
                robots.add(robot)
    merged: list[set[str]] = []
    for dispute in disputes:
        linked = [other for other in merged if other & dispute]
        merged = [other for other in merged if not other & dispute] + [dispute.union(*linked)]
    disputed = set().union(*merged)
    return {one.robot: one for one in single if one.robot not in disputed}, merged


def _overlap(joined: Joined, one: Said, other: Said) -> bool:
    """Whether two robots are said to be at the same place."""
    first, second = joined.fleet.robots[one.robot], joined.fleet.robots[other.robot]
    near = NEAR * min(first.extent, second.extent)
    middles = [
        [poses[0].map(robot.T_robot_plane.position) for poses in said.poses.values()]
        for said, robot in ((one, first), (other, second))
    ]
    return any(math.dist(a, b) < near for a in middles[0] for b in middles[1])


def judged(
    joined: Joined, robots: set[str], said: dict[str, list[Said]], free: NDArray[np.bool_]
) -> tuple[list[Hypothesis], Doubts]:
    """Which of contradicting cameras are right, by what the spots of all cameras say to each of them."""
    groups = [group for robot in sorted(robots) for group in said[robot]]
    contested = [labels_said(joined, group) for group in groups]
    usable = free.copy()
    for labels in contested:
        usable[labels[labels >= 0]] = True
    explanations = []
    for group, labels in zip(groups, contested, strict=True):
        open_spots = usable.copy()
        open_spots[labels[labels >= 0]] = False
        told = joined.explain(joined.fleet.robots[group.robot], group.starts()[0], labels, open_spots)
        if told is not None:
            explanations.append(told)
    return decided(explanations)
