"""Errors that spots share, marginalised: the same as if they were in the spots' covariances."""

import numpy as np

from asterism.protocol.geometry import exp_rotation
from asterism.server.pose.matched import Lit
from asterism.server.pose.shared_errors import fill_light, shared_room
from asterism.server.pose.spot_shift import OPTICS
from tests.rigs import random_layout

FOCAL = 1400.0


def derivatives(rotation: np.ndarray, t: np.ndarray, points: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """Of the rays (12, 6), numerically."""

    def rays(step: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
        there = points @ (exp_rotation(step[3:]) @ rotation).T + t + step[:3]
        return np.asarray((there[:, :2] / there[:, 2:]).ravel())

    h = 1e-6
    return np.column_stack([(rays(h * unit) - rays(-h * unit)) / (2 * h) for unit in np.eye(6)])


def test_the_information_is_that_of_correlated_spots(rng: np.random.Generator) -> None:
    points = np.column_stack([random_layout(rng), np.zeros(6)])
    rotation, t = np.ascontiguousarray(exp_rotation(np.array([3.0, 0.4, 0.2]))), np.array([0.1, -0.05, 1.3])
    there = points @ rotation.T + t
    sigma = 0.01 / FOCAL
    rays = there[:, :2] / there[:, 2:] + rng.normal(0, sigma, (6, 2))
    lit = Lit(points, rays, np.zeros((6, 2)), np.tile([sigma**-2, 0.0, sigma**-2], (6, 1)))
    shared = shared_room()
    common = (0.02 / FOCAL) ** 2 * np.array([[1.0, 0.3], [0.3, 0.5]])
    shared.common[:] = common[0, 0], common[0, 1], common[1, 1]
    half = rng.standard_normal((6, 6)) * [1e-5, 1e-5, 1e-4, 1e-4, 1e-4, 1e-4]
    shared.terms[:, :] = half.T @ half
    a, b = np.empty((6, 6)), np.empty(6)
    cost = fill_light(rotation, t, lit, np.zeros(OPTICS), shared, a, b)
    by_pose = derivatives(rotation, t, points)
    spread = sigma**2 * np.eye(12) + np.kron(np.ones((6, 6)), common) + by_pose @ shared.terms @ by_pose.T
    off = (rays - there[:, :2] / there[:, 2:]).ravel()
    whole = np.linalg.inv(spread)
    scale = np.sqrt(np.diag(a))
    np.testing.assert_allclose(
        a / np.outer(scale, scale), by_pose.T @ whole @ by_pose / np.outer(scale, scale), atol=1e-5
    )
    np.testing.assert_allclose(b / scale, by_pose.T @ whole @ off / scale, atol=1e-4)
    np.testing.assert_allclose(cost, off @ whole @ off, rtol=1e-4)


def test_no_more_is_explained_than_it_costs(rng: np.random.Generator) -> None:
    points = np.column_stack([random_layout(rng), np.zeros(6)])
    rotation, t, sigma = np.ascontiguousarray(exp_rotation(np.array([3.0, 0.4, 0.2]))), np.array([0, 0, 1.3]), 1e-5
    there = points @ rotation.T + t
    lit = Lit(
        points,
        there[:, :2] / there[:, 2:] + rng.normal(0, 30 * sigma, (6, 2)),
        np.zeros((6, 2)),
        np.tile([sigma**-2, 0.0, sigma**-2], (6, 1)),
    )
    shared = shared_room()
    shared.common[:] = 1e-8, 0.0, 1e-8
    assert fill_light(rotation, t, lit, np.zeros(OPTICS), shared, np.empty((6, 6)), np.empty(6)) > 0.0
