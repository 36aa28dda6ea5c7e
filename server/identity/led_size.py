"""How large a robot's spots are, against what its rig says of its LEDs."""

import math

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.centres.blobs import Ints
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan
from asterism.server.pose.fit import median_of


def size_of(spots: Spots, plan: Plan, robot: int, labels: Ints, rotation: Floats, t: Floats) -> float:
    """Logarithm of the spots' radii over those of the robot's LEDs at its pose; nan if the rig does not say theirs.

    ``labels`` (6,) are its spots (-1: not visible), ``rotation`` (3, 3) and ``t`` (3,) m T_camera_plane.
    """
    away = float(np.linalg.norm(t))
    facing = -float(rotation[:, 2] @ t) / away
    expected = plan.led_radii[robot] * plan.focal / away * math.sqrt(max(facing, 1e-3))
    return float(np.log(median_of(spots.radii, labels) / expected))
