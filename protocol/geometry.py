"""Rigid transforms and rotations in plain numpy.

Rotations are (3, 3) matrices; quaternions are (4,) arrays x y z w with w >= 0; rotation vectors are (3,) axis times
angle in rad. The formulas are the usual ones (e.g. Sola, Deray, Atchuthan: "A micro Lie theory for state
estimation in robotics", 2018, appendix B).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def frozen_array(values: Any, *shape: int) -> Floats:
    """A read-only float64 copy of ``values`` with exactly ``shape``; -1 stands for any length."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        free = array.ndim == len(shape) and all(n in (-1, have) for n, have in zip(shape, array.shape, strict=True))
        assert free, f"shape {array.shape}, expected {shape}"
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid transform T_a_b: position of b's origin in a (m) and orientation of b in a."""

    position: Floats  # (3,) m
    orientation: Floats  # (4,) x y z w, unit, w >= 0

    def __post_init__(self) -> None:
        x, y, z, w = np.asarray(self.orientation, np.float64).tolist()
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        assert norm > 0.0, "a quaternion of zero length is no rotation"
        scale = 1.0 / norm if w >= 0.0 else -1.0 / norm
        # `+ 0.0` turns -0.0 into 0.0, so that equal poses have equal bytes.
        quat = (x * scale + 0.0, y * scale + 0.0, z * scale + 0.0, w * scale + 0.0)
        object.__setattr__(self, "position", frozen_array(self.position, 3))
        object.__setattr__(self, "orientation", frozen_array(quat, 4))

    @staticmethod
    def identity() -> "Pose":
        """The transform that changes nothing."""
        return Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))

    @staticmethod
    def from_matrix(rotation: Floats, position: Floats) -> "Pose":
        """From a (3, 3) rotation matrix and a (3,) position."""
        return Pose(position, quat_from_matrix(rotation))

    @property
    def rotation(self) -> Floats:
        """The orientation as a (3, 3) rotation matrix."""
        return matrix_from_quat(self.orientation)

    def inverse(self) -> "Pose":
        """T_b_a."""
        back = self.rotation.T
        return Pose.from_matrix(back, -back @ self.position)

    def __matmul__(self, other: "Pose") -> "Pose":
        """Chain: T_a_b @ T_b_c = T_a_c."""
        turn = self.rotation
        return Pose.from_matrix(turn @ other.rotation, turn @ other.position + self.position)

    def map(self, points: Floats) -> Floats:
        """Map points (..., 3) of frame b into frame a."""
        mapped: Floats = np.asarray(points) @ self.rotation.T + self.position
        return mapped


def matrix_from_quat(quat: Sequence[float] | Floats) -> Floats:
    """Rotation matrix (3, 3) of a unit quaternion x y z w."""
    x, y, z, w = np.asarray(quat, np.float64).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quat_from_matrix(rotation: Floats) -> Floats:
    """Unit quaternion x y z w, w >= 0, of a rotation matrix (3, 3); largest component first, for precision."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    trace = a + e + i
    if trace >= max(a, e, i):
        quat = (h - f, c - g, d - b, 1.0 + trace)
    elif a >= max(e, i):
        quat = (1.0 + a - e - i, b + d, c + g, h - f)
    elif e >= i:
        quat = (b + d, 1.0 + e - a - i, f + h, c - g)
    else:
        quat = (c + g, f + h, 1.0 + i - a - e, d - b)
    x, y, z, w = quat
    scale = math.sqrt(x * x + y * y + z * z + w * w)
    if w < 0:
        scale = -scale
    return np.array([x / scale, y / scale, z / scale, w / scale])


def exp_rotation(rotvec: Floats) -> Floats:
    """Rotation matrix (3, 3) of a rotation vector (3,) in rad (Rodrigues)."""
    x, y, z = (float(v) for v in rotvec)
    angle2 = x * x + y * y + z * z
    angle = math.sqrt(angle2)
    if angle < 1e-5:  # series, where sin(angle) / angle loses digits
        sine, versine = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        sine, versine = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Floats = np.eye(3) + sine * hat + versine * (hat @ hat)
    return turned


def log_rotation(rotation: Floats) -> Floats:
    """Rotation vector (3,) in rad, length at most pi, of a rotation matrix (3, 3)."""
    x, y, z, w = (float(v) for v in quat_from_matrix(rotation))
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return np.array([factor * x, factor * y, factor * z])


def angle_between(rotation_a: Floats, rotation_b: Floats) -> float:
    """Angle in rad of the rotation that leads from one (3, 3) rotation to the other."""
    return float(np.linalg.norm(log_rotation(rotation_a.T @ rotation_b)))
