"""Which spots of all cameras are whose LEDs: what the cameras say, and what all of them together show beyond it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """Where a robot should be at an exposure: T_world_robot, and its covariance (6, 6) as of a `FusedPose`."""

    pose: Pose
    covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One robot's spots: ``spots`` by the camera's name (6,), rows of its `Sighting`, -1 for LEDs not seen.

    ``starts`` are poses T_world_robot from which to solve, the likeliest first: both tilts where nothing decides.
    """

    robot: str
    spots: Mapping[str, NDArray[np.int64]]
    starts: tuple[Pose, ...]
