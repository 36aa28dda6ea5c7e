"""The frame in which a surface is a height: the world's, or where it is steep there its best plane's."""

import math

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.server.calibration.surface.contacts import Contacts

STEEP_DEG = 35.0  # between the plane's normal and the world's z, from which on the frame is turned
ROUNDS = 30


def frame_of(contacts: Contacts) -> Pose:
    """T_world_surface: its z points out of the material, which is where robots' axes point."""
    middle, normal = _plane(contacts.points)
    normal = normal if normal @ contacts.axes.mean(axis=0) > 0.0 else -normal
    if normal[2] > math.cos(math.radians(STEEP_DEG)):
        return Pose.identity()
    across = np.eye(3)[np.argmin(np.abs(normal))]
    x = across - (across @ normal) * normal
    x /= np.linalg.norm(x)
    return Pose.from_matrix(np.column_stack([x, np.cross(normal, x), normal]), middle.round(4))


def _plane(points: Floats) -> tuple[Floats, Floats]:
    """The middle (3,) and normal (3,) of the plane to which distances are the least in sum, not squared: a robot that
    is lifted does not tilt it.
    """
    weights = np.ones(len(points))
    for _ in range(ROUNDS):
        middle = weights @ points / weights.sum()
        away = points - middle
        normal: Floats = np.linalg.eigh((away * weights[:, None]).T @ away)[1][:, 0]
        weights = 1.0 / np.maximum(np.abs(away @ normal), 1e-4)
    return middle, normal
