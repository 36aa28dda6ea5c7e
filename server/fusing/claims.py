"""Which spots of all cameras are whose LEDs: what the cameras say, and what all of them together show beyond it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Floats, Pose
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.fit import LEDS
from asterism.server.pose.solve import Lost


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """Where a robot should be at an exposure: T_world_robot, and its covariance (6, 6) as of a `FusedPose`."""

    pose: Pose
    covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One robot's spots: ``spots`` by the camera's name (6,), rows of its `Sighting`, -1 for LEDs not seen; cameras
    that see none of its LEDs are not there.

    ``starts`` are poses T_world_robot from which to solve, the likeliest first: both tilts where nothing decides.
    """

    robot: str
    spots: Mapping[str, NDArray[np.int64]]
    starts: tuple[Pose, ...]


# What is known of a robot before, at a time, ns: asked for the times of all sightings. None: nothing is.
Foresight = Callable[[str, int], Foreseen | None]


def claims_of(fleet: Fleet, sightings: Sequence[Sighting], foreseen: Foresight) -> Mapping[str, "Claim | Lost"]:
    """Every robot's spots by the fleet's ids, in its order, or why there are none: LOST, or IDENTITY_AMBIGUOUS.

    ``sightings`` are the newest of the cameras, one each.
    """
    return {robot: _claim(robot, sightings) for robot in fleet.robots}


def _claim(robot: str, sightings: Sequence[Sighting]) -> "Claim | Lost":
    spots: dict[str, NDArray[np.int64]] = {}
    starts: list[Pose] = []
    for sighting in sightings:
        told = sighting.told.get(robot)
        if told is None or not told.HasField("pose"):
            continue
        rows = np.flatnonzero(sighting.robots == list(sighting.told).index(robot))
        spots[sighting.camera] = np.full(LEDS, -1)
        spots[sighting.camera][sighting.leds[rows]] = rows
        starts.append(report_pose(told.pose))
        if told.HasField("alternative"):
            starts.append(report_pose(told.alternative.pose))
    return Claim(robot, spots, tuple(starts)) if spots else Lost("no camera finds it")
