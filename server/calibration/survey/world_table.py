"""Robots seen at surveyed places as arrays, and what a camera's place predicts of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from asterism.protocol.geometry import Floats, Pose, exp_rotation, matrix_from_quat

POSITION, ROTATION = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A robot at a surveyed place: ``seen`` is T_camera_robot with ``covariance`` (6, 6), m and rad about the camera's
    axes, from ``frames`` frames, the first of which is ``frame``. ``position`` (3,) m and ``orientation`` (x y z w or
    None) are T_world_robot.
    """

    robot: str
    frame: str
    frames: int
    seen: Pose
    covariance: Floats
    position: Floats
    orientation: Floats | None

    @property
    def name(self) -> str:
        """What people call it."""
        return f"{self.robot} in " + (self.frame if self.frames == 1 else f"{self.frames} frames from {self.frame}")


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Samples as arrays: seen (n, 3), (n, 3, 3), (n, 6, 6); surveyed (n, 3), (n, 3, 3); whether the latter was (n,)."""

    seen: Floats
    seen_rotations: Floats
    covariances: Floats
    positions: Floats
    rotations: Floats
    oriented: NDArray[np.bool_]

    @staticmethod
    def of(samples: Sequence[Sample]) -> "Table":
        return Table(
            np.array([s.seen.position for s in samples]),
            np.array([s.seen.rotation for s in samples]),
            np.array([s.covariance for s in samples]),
            np.array([s.position for s in samples]),
            np.array([np.eye(3) if s.orientation is None else matrix_from_quat(s.orientation) for s in samples]),
            np.array([s.orientation is not None for s in samples]),
        )

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "Table":
        return Table(
            self.seen[rows],
            self.seen_rotations[rows],
            self.covariances[rows],
            self.positions[rows],
            self.rotations[rows],
            self.oriented[rows],
        )


def residuals_of(table: Table, T_world_camera: Pose) -> Floats:
    """Surveyed minus predicted (n, 6): position, m, and rotation vector about the world's axes, 0 without one."""
    turn = T_world_camera.rotation
    away = table.positions - (table.seen @ turn.T + T_world_camera.position)
    apart = table.rotations @ np.swapaxes(turn @ table.seen_rotations, 1, 2)
    turned = Rotation.from_matrix(apart).as_rotvec() * table.oriented[:, None]
    return np.hstack([away, turned])


def spreads_of(table: Table, T_world_camera: Pose, sigmas: tuple[float, float]) -> Floats:
    """Covariances (n, 6, 6) of the residuals: those of the seen poses, about the world's axes, and the survey's."""
    turn = np.kron(np.eye(2), T_world_camera.rotation)
    survey = np.diag([sigmas[0] ** 2] * 3 + [sigmas[1] ** 2] * 3)
    spreads: Floats = turn @ table.covariances @ turn.T + survey
    return spreads


def moved(T: Pose, move: Floats) -> Pose:
    return Pose.from_matrix(exp_rotation(move[3:]) @ T.rotation, T.position + move[:3])


def normal_equations(table: Table, T: Pose, sigmas: tuple[float, float]) -> tuple[Floats, Floats]:
    """Every sample's share (n, 6, 6) and (n, 6) of the normal equations for the camera's shift and rotation about the
    world's axes.
    """
    by_pose, weighted = weighted_by_pose(table, T, sigmas)
    return weighted @ by_pose, (weighted @ residuals_of(table, T)[..., None])[..., 0]


def weighted_by_pose(table: Table, T: Pose, sigmas: tuple[float, float]) -> tuple[Floats, Floats]:
    """Derivatives (n, 6, 6) of where samples are predicted by the camera's shift and rotation about the world's axes,
    and the same, transposed, times the inverse covariances.
    """
    x, y, z = (table.seen @ T.rotation.T).T
    by_pose = np.tile(np.eye(6), (len(x), 1, 1))
    zero = np.zeros(len(x))
    by_pose[:, :3, 3:] = np.moveaxis(np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]), 2, 0)
    spreads = spreads_of(table, T, sigmas)
    information = np.linalg.inv(spreads)
    # Where no orientation was surveyed, the position alone counts.
    alone = np.zeros_like(spreads)
    alone[:, :3, :3] = np.linalg.inv(spreads[:, :3, :3])
    information = np.where(table.oriented[:, None, None], information, alone)
    return by_pose, np.swapaxes(by_pose, 1, 2) @ information
