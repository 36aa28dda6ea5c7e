"""The surface as a source of the error budget: what it adds to the solve of a robot that stands on it.

A robot is taken to stand upright where it is: the surface's normal there is its axis, so that where the surface lies
does not matter, only how well it is known and how well the robot stands. Its bends are left out: while a pose moves by
what it may be off, a normal hardly turns.
"""

import math

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig, Robot
from asterism.protocol.surface import Heights

SURFACE_SOURCES = ("surface", "stand on it")


def surface_sigmas(rig: Rig) -> Floats:
    """(3,) one sigma of the surface as the rig says: m along its normal, rad in its two tilts. A grid's nodes count
    with their root mean square.
    """
    surface = rig.surface
    assert surface is not None
    own = 0.0
    if isinstance(surface.shape, Heights):
        there = np.isfinite(surface.shape.values)
        own = float(np.sqrt(np.mean(surface.shape.sigmas[there] ** 2))) if there.any() else 0.0
    return np.array([math.hypot(surface.sigma_m, own), surface.tilt_sigma_rad, surface.tilt_sigma_rad])


def stand_sigmas(robot: Robot) -> Floats:
    """(3,) the same of how a robot stands, inf where its tilt is not told."""
    assert robot.stands is not None
    return np.array([robot.stands.sigma_m, robot.stands.tilt_sigma_rad, robot.stands.tilt_sigma_rad])


def stands_by_pose(robot: Robot, rotations: Floats) -> Floats:
    """Derivatives (n, 3, 6) of the distance from the surface and of both tilts, by translation and rotation about the
    camera's axes, of poses with ``rotations`` (n, 3, 3).
    """
    assert robot.stands is not None
    axis = robot.stands.axis
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across /= np.linalg.norm(across)
    normal, first, second = (rotations @ each for each in (axis, across, np.cross(axis, across)))
    arm = rotations @ robot.points[robot.stands.point]
    none = np.zeros_like(normal)
    rows = [(normal, np.cross(arm, normal)), (none, np.cross(normal, first)), (none, np.cross(normal, second))]
    return np.stack([np.concatenate(row, axis=-1) for row in rows], axis=1)
