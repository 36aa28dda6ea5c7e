"""Poses of a world with z up, told as aircraft have them: x forward, y right, z down (FRD), for world and body alike.

Both frames are turned by half a turn about their own x. A rotation stays one about the same line, its y and z
components change sign; so do those of positions, velocities and of the covariances' rows and columns.
"""

import math

import numpy as np

from asterism.protocol.geometry import Floats, Pose

_TURN = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
_LEAST_COSINE = 1e-3  # of the pitch: at 90 degrees up or down roll and yaw are not told apart


def position_down(pose: Pose) -> Floats:
    """(3,) m."""
    down: Floats = pose.position * _TURN[:3]
    return down


def orientation_down(pose: Pose) -> Floats:
    """(4,) w x y z."""
    x, y, z, w = pose.orientation.tolist()
    return np.array([w, x, -y, -z])


def covariance_down(pose: Pose, covariance: Floats) -> Floats:
    """(6, 6) of x, y, z, roll, pitch, yaw, from that of x, y, z and rotations about the parent's axes.

    Turns about the parent's axes change the angles of a body that is turned against it otherwise than about the body's
    own: d(roll, pitch, yaw) = E d(rotation), E by the pose's yaw and pitch (Diebel, "Representing Attitude", 2006).
    """
    w, x, y, z = orientation_down(pose).tolist()
    yaw = math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    sine = max(-1.0, min(1.0, 2.0 * (w * y - x * z)))  # of the pitch
    cosine = max(math.sqrt(1.0 - sine * sine), _LEAST_COSINE)
    c, s = math.cos(yaw), math.sin(yaw)
    change = np.eye(6)
    change[3:, 3:] = [[c / cosine, s / cosine, 0.0], [-s, c, 0.0], [c * sine / cosine, s * sine / cosine, 1.0]]
    change *= _TURN
    changed: Floats = change @ covariance @ change.T
    return changed


def velocity_down(linear: Floats, angular: Floats) -> Floats:
    """(6,) m/s and rad/s, of the body in its own frame."""
    down: Floats = np.concatenate([linear, angular]) * _TURN
    return down


def velocity_covariance_down(covariance: Floats) -> Floats:
    """(6, 6) of the same."""
    down: Floats = covariance * np.outer(_TURN, _TURN)
    return down
