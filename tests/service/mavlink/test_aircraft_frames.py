"""A pose in aircraft's frames is the same pose: checked with MAVLink's own rotations and angles, and by derivatives."""

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed (pip install '.[dev]')")

from pymavlink.quaternion import Quaternion
from pymavlink.rotmat import Matrix3, Vector3

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.server.service.mavlink.aircraft_frames import (
    covariance_down,
    orientation_down,
    position_down,
    velocity_covariance_down,
    velocity_down,
)
from tests.helpers import numeric_jacobian, random_pose

DOWN = np.diag([1.0, -1.0, -1.0])  # points of a frame with y left and z up, in one with y right and z down


def test_level_and_turned_to_the_left_is_level_and_yawed_to_the_left() -> None:
    pose = Pose.from_matrix(exp_rotation(np.array([0.0, 0.0, np.radians(30.0)])), np.array([1.0, 2.0, 3.0]))
    assert position_down(pose).tolist() == [1.0, -2.0, -3.0]
    np.testing.assert_allclose(_angles(pose), [0.0, 0.0, np.radians(-30.0)], atol=1e-12)  # yaw is positive to the right
    nose_up = Pose.from_matrix(exp_rotation(np.array([0.0, np.radians(-20.0), 0.0])), np.zeros(3))
    np.testing.assert_allclose(_angles(nose_up), [0.0, np.radians(20.0), 0.0], atol=1e-12)


def test_points_of_the_body_are_where_they_were(rng: np.random.Generator) -> None:
    for _ in range(20):
        pose, point = random_pose(rng), rng.normal(size=3)
        turn = Quaternion(orientation_down(pose)).dcm
        x, y, z = DOWN @ point
        turned = turn * Vector3(x, y, z)
        np.testing.assert_allclose(
            np.array([turned.x, turned.y, turned.z]) + position_down(pose), DOWN @ pose.map(point), atol=1e-9
        )


def test_the_covariance_is_that_of_the_angles_told(rng: np.random.Generator) -> None:
    """What a small motion of the pose does to x, y, z, roll, pitch, yaw, by differences."""
    for _ in range(20):
        pose = random_pose(rng)
        half = rng.normal(size=(6, 6))
        covariance = half @ half.T

        def told(motion: Floats, pose: Pose = pose) -> Floats:
            moved = Pose.from_matrix(exp_rotation(motion[3:]) @ pose.rotation, pose.position + motion[:3])
            return np.concatenate([position_down(moved), _angles(moved)])

        change = numeric_jacobian(told, np.zeros(6))
        expected = change @ covariance @ change.T
        np.testing.assert_allclose(
            covariance_down(pose, covariance), expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max()
        )


def test_straight_up_it_stays_finite() -> None:
    pose = Pose.from_matrix(exp_rotation(np.array([0.0, -np.pi / 2, 0.0])), np.zeros(3))
    told = covariance_down(pose, np.eye(6))
    assert np.isfinite(told).all()
    assert (np.linalg.eigvalsh(told) > 0).all()


def test_velocities_turn_with_the_body(rng: np.random.Generator) -> None:
    linear, angular = rng.normal(size=3), rng.normal(size=3)
    told = velocity_down(linear, angular)
    np.testing.assert_allclose(told, np.concatenate([DOWN @ linear, DOWN @ angular]))
    both = np.kron(np.eye(2), DOWN)
    covariance = np.diag(rng.uniform(1.0, 2.0, 6)) + 0.1
    np.testing.assert_allclose(velocity_covariance_down(covariance), both @ covariance @ both.T)


def _angles(pose: Pose) -> Floats:
    """Roll, pitch, yaw, by their library."""
    rows = [Vector3(*row) for row in np.array([list(row) for row in _rows(Quaternion(orientation_down(pose)).dcm)])]
    return np.array(Matrix3(*rows).to_euler())


def _rows(matrix: Matrix3) -> list[list[float]]:
    return [[row.x, row.y, row.z] for row in (matrix.a, matrix.b, matrix.c)]
