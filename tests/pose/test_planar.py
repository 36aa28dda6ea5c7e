"""Poses of planes: against numpy, OpenCV, truth, and their own covariance."""

import cv2
import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.server.pose.planar import (
    NO_SOLUTION,
    cholesky_solve,
    homography_ls,
    homography_tls,
    normal_equations,
    other_minimum,
    pose_cost,
    refine_pose,
    solve_both,
    translation,
    two_rotations,
)
from tests.helpers import assert_poses_close, facing_pose, numeric_jacobian
from tests.rigs import random_layout


def plane(rng: np.random.Generator, off_plane_m: float = 0.0) -> Floats:
    """Six centred points (6, 3) of a plate."""
    points = np.column_stack([random_layout(rng), off_plane_m * rng.standard_normal(6)])
    return points - points.mean(axis=0)


def rays_of(T_camera_plane: Pose, points: Floats) -> Floats:
    mapped = T_camera_plane.map(points)
    rays: Floats = mapped[:, :2] / mapped[:, 2:]
    return rays


def unit_information(sigma: float, count: int = 6) -> Floats:
    return np.tile([sigma**-2, 0.0, sigma**-2], (count, 1))


def solve(points: Floats, rays: Floats, information: Floats) -> tuple[Floats, Floats, Floats]:
    rotations, ts, costs = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty(2)
    assert solve_both(points, rays, information, 20, rotations, ts, costs)
    return rotations, ts, costs


def test_cholesky_equals_numpy(rng: np.random.Generator) -> None:
    for n in (3, 6, 8):
        half, b = rng.normal(size=(n, n)), rng.normal(size=n)
        a = half @ half.T + 0.1 * np.eye(n)
        x = b.copy()
        assert cholesky_solve(a.copy(), x)
        np.testing.assert_allclose(x, np.linalg.solve(a, b), rtol=1e-8)
    assert not cholesky_solve(-np.eye(3), np.ones(3))


def test_homographies_map_exact_points_exactly(rng: np.random.Generator) -> None:
    for _ in range(30):
        points = plane(rng)
        rays = rays_of(facing_pose(rng), points)
        for method in (homography_tls, homography_ls):
            h = np.empty((3, 3))
            assert method(points, rays, h)
            mapped = np.column_stack([points[:, :2], np.ones(6)]) @ h.T
            np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:], rays, atol=1e-10)


def test_tls_homography_is_the_last_singular_vector(rng: np.random.Generator) -> None:
    # The slow and obvious version: normalise, stack, numpy's SVD, undo.
    points = plane(rng)
    rays = rays_of(facing_pose(rng), points) + 1e-4 * rng.standard_normal((6, 2))
    mean, size_r = rays.mean(axis=0), np.sqrt(((rays - rays.mean(axis=0)) ** 2).sum() / 12)
    size_p = np.sqrt((points[:, :2] ** 2).sum() / 12)
    rows = []
    for (x, y), (u, v) in zip(points[:, :2] / size_p, (rays - mean) / size_r, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    last = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    back = np.array([[size_r, 0, mean[0]], [0, size_r, mean[1]], [0, 0, 1]])
    expected = back @ last @ np.diag([1 / size_p, 1 / size_p, 1])
    h = np.empty((3, 3))
    assert homography_tls(points, rays, h)
    np.testing.assert_allclose(h, expected / expected[2, 2], rtol=1e-9)


def test_one_of_the_two_rotations_is_the_true_one(rng: np.random.Generator) -> None:
    for _ in range(50):
        points, truth = plane(rng), facing_pose(rng, tilt_deg=(2, 60))
        rays = rays_of(truth, points)
        h, first, second, t = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
        assert homography_tls(points, rays, h)
        assert two_rotations(h, first, second)
        for rotation in (first, second):
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
            assert np.linalg.det(rotation) == pytest.approx(1.0)
        away = [np.abs(rotation - truth.rotation).max() for rotation in (first, second)]
        assert min(away) < 1e-7
        translation((first, second)[int(np.argmin(away))], points, rays, t)
        np.testing.assert_allclose(t, truth.position, atol=1e-7)


@pytest.mark.parametrize("off_plane_m", [0.0, 0.001])
def test_exact_rays_give_the_exact_pose(rng: np.random.Generator, off_plane_m: float) -> None:
    for _ in range(30):
        points, truth = plane(rng, off_plane_m), facing_pose(rng, tilt_deg=(5, 60))
        rotations, ts, costs = solve(points, rays_of(truth, points), unit_information(1e-5))
        assert costs[0] < 1e-6
        assert_poses_close(Pose.from_matrix(rotations[0], ts[0]), truth, 1e-8, 1e-7)


def test_jacobian_equals_differences(rng: np.random.Generator) -> None:
    # The gradient of half the cost is minus the right-hand side, for small residuals.
    points, truth = plane(rng, 0.001), facing_pose(rng)
    rays = rays_of(truth, points) + 1e-4 * rng.standard_normal((6, 2))
    information = unit_information(3e-4)
    information[:, 1] = 0.3 * information[:, 0]

    def cost(step: Floats) -> Floats:
        rotation = exp_rotation(step[3:]) @ truth.rotation
        return np.array([0.5 * pose_cost(rotation, truth.position + step[:3], points, rays, information)])

    a, b = np.empty((6, 6)), np.empty(6)
    normal_equations(truth.rotation, truth.position, points, rays, information, a, b)
    np.testing.assert_allclose(-numeric_jacobian(cost, np.zeros(6), 1e-7)[0], b, rtol=1e-4, atol=1e-3 * np.abs(b).max())


def test_the_minimum_equals_opencvs(rng: np.random.Generator) -> None:
    for _ in range(20):
        points, truth = plane(rng), facing_pose(rng, depth_m=(0.8, 1.3), tilt_deg=(20, 50))
        rays = rays_of(truth, points) + 2e-5 * rng.standard_normal((6, 2))
        rotations, ts, _ = solve(points, rays, unit_information(2e-5))
        good, rvec, tvec = cv2.solvePnP(points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
        assert good
        rvec, tvec = cv2.solvePnPRefineLM(points, rays, np.eye(3), None, rvec.reshape(3, 1), tvec.reshape(3, 1))
        here, there = (
            pose_cost(r, t, points, rays, unit_information(1.0))
            for r, t in ((rotations[0], ts[0]), (cv2.Rodrigues(rvec)[0], tvec.ravel()))
        )
        assert here <= there * (1 + 1e-6)


def test_the_other_minimum_is_found_from_the_first(rng: np.random.Generator) -> None:
    for _ in range(30):
        points, truth = plane(rng), facing_pose(rng, depth_m=(1.5, 2.0), tilt_deg=(15, 40))
        rays = rays_of(truth, points) + 1e-5 * rng.standard_normal((6, 2))
        information = unit_information(1e-5)
        rotations, ts, costs = solve(points, rays, information)
        other, other_t = np.empty((3, 3)), np.empty(3)
        assert other_minimum(rotations[0], ts[0], points, rays, other, other_t)
        cost = refine_pose(other, other_t, points, rays, information, 20)
        if costs[1] < NO_SOLUTION:
            assert cost == pytest.approx(costs[1], rel=1e-3)
            np.testing.assert_allclose(other, rotations[1], atol=2e-3)


def test_one_wild_ray_pulls_little(rng: np.random.Generator) -> None:
    sigma, robust, plain = 2e-5, [], []
    for _ in range(60):
        points, truth = plane(rng), facing_pose(rng, tilt_deg=(20, 50))
        rays = rays_of(truth, points) + sigma * rng.standard_normal((6, 2))
        bent = rays.copy()
        bent[2] += [40 * sigma, 0.0]
        # With a thousandfold sigma every residual is far inside the quadratic part of the loss.
        for factor, errors in ((1.0, robust), (1000.0, plain)):
            rotation, t = truth.rotation.copy(), truth.position.copy()
            refine_pose(rotation, t, points, bent, unit_information(factor * sigma), 20)
            errors.append(float(np.linalg.norm(t - truth.position)))
    assert np.sqrt(np.mean(np.square(robust))) < 0.6 * np.sqrt(np.mean(np.square(plain)))


@pytest.mark.parametrize("sigma_px", [0.01, 0.1])
def test_squared_error_weighted_by_the_covariance_averages_six(rng: np.random.Generator, sigma_px: float) -> None:
    sigma, squares = sigma_px / 1400, []
    for _ in range(400):
        points, truth = plane(rng), facing_pose(rng, depth_m=(0.8, 1.2), tilt_deg=(20, 50))
        rays = rays_of(truth, points) + sigma * rng.standard_normal((6, 2))
        rotation, t = truth.rotation.copy(), truth.position.copy()
        refine_pose(rotation, t, points, rays, unit_information(sigma), 20)
        a, b = np.empty((6, 6)), np.empty(6)
        normal_equations(rotation, t, points, rays, unit_information(sigma), a, b)
        information = np.tril(a) + np.tril(a, -1).T
        error = np.concatenate([t - truth.position, log_rotation(rotation @ truth.rotation.T)])
        squares.append(error @ information @ error)
    assert np.mean(squares) == pytest.approx(6.0, abs=0.55)  # 99.9 % band of 400 draws
