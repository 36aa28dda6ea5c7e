"""Laws of poses and rotations, for the plain and for the compiled functions."""

import numpy as np
import pytest

from asterism.protocol.geometry import (
    Pose,
    angle_between,
    exp_rotation,
    frozen_array,
    log_rotation,
    matrix_from_quat,
    quat_from_matrix,
)
from asterism.server.pose import rotations as compiled
from tests.helpers import assert_poses_close, random_pose, random_rotation

ANGLES = (1e-9, 1e-4, 0.3, 2.0, np.pi - 1e-3, np.pi - 1e-8)


def test_poses_are_a_group(rng: np.random.Generator) -> None:
    for _ in range(100):
        a, b, c = (random_pose(rng) for _ in range(3))
        assert_poses_close((a @ b) @ c, a @ (b @ c), 1e-12)
        assert_poses_close(a @ a.inverse(), Pose.identity(), 1e-12)
        assert_poses_close(a @ Pose.identity(), a, 1e-15)


def test_chaining_is_mapping_twice(rng: np.random.Generator) -> None:
    for _ in range(50):
        a, b, points = random_pose(rng), random_pose(rng), rng.normal(size=(5, 3))
        np.testing.assert_allclose((a @ b).map(points), a.map(b.map(points)), atol=1e-12)


def test_a_pose_a_person_can_check() -> None:
    # A quarter turn about z, then 1 m along x: the point 1 m along the robot's x lies 1 m along the world's y, and x.
    T_world_robot = Pose(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]))
    np.testing.assert_allclose(T_world_robot.map(np.array([1.0, 0.0, 0.0])), [1.0, 1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_and_log_are_inverse(rng: np.random.Generator, angle: float) -> None:
    for _ in range(20):
        rotation = random_rotation(rng, angle)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        # Near half a turn the vector may flip its sign; the rotation is the same.
        np.testing.assert_allclose(exp_rotation(log_rotation(rotation)), rotation, atol=1e-7)
        assert np.linalg.norm(log_rotation(rotation)) == pytest.approx(angle, rel=1e-6, abs=1e-12)


def test_quaternion_and_matrix_are_inverse_with_w_not_negative(rng: np.random.Generator) -> None:
    for _ in range(200):
        rotation = random_rotation(rng, rng.uniform(0, np.pi))
        quat = quat_from_matrix(rotation)
        assert quat[3] >= 0.0
        np.testing.assert_allclose(matrix_from_quat(quat), rotation, atol=1e-12)


def test_a_pose_normalises_its_quaternion_and_has_no_negative_zero() -> None:
    pose = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, -2.0]))
    assert pose.orientation.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert not np.signbit(pose.orientation).any()


def test_values_cannot_be_changed() -> None:
    position = np.array([1.0, 2.0, 3.0])
    pose = Pose(position, np.array([0.0, 0.0, 0.0, 1.0]))
    position[0] = 9.0
    assert pose.position[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        pose.position[0] = 5.0
    with pytest.raises(AssertionError, match="shape"):
        frozen_array([1.0, 2.0], 3)


def test_compiled_rotations_equal_the_plain_ones(rng: np.random.Generator) -> None:
    for angle in (*ANGLES, *rng.uniform(0, np.pi, 20)):
        a, turn = random_rotation(rng), random_rotation(rng, float(angle))
        b = turn @ a
        out, vector, quat = np.empty((3, 3)), np.empty(3), np.empty(4)
        compiled.exp_into(*log_rotation(turn), out)
        np.testing.assert_allclose(out, exp_rotation(log_rotation(turn)), atol=1e-12)
        compiled.product_into(a, b, out)
        np.testing.assert_allclose(out, a @ b, atol=1e-14)
        compiled.quat_into(a, quat)
        np.testing.assert_allclose(quat, quat_from_matrix(a), atol=1e-14)
        compiled.log_between(a, b, vector)
        np.testing.assert_allclose(exp_rotation(vector) @ a, b, atol=1e-7)
        assert compiled.angle_between(a, b) == pytest.approx(angle_between(a, b), abs=2e-8)
