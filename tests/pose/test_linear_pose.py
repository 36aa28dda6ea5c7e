"""The linear stages: exact without noise, as good as they are said to be with it, none where there is no answer."""

from collections.abc import Callable

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.server.pose.linear_pose import pose_by_depths, pose_by_homography
from asterism.server.pose.planar import normal_equations
from tests.helpers import assert_poses_close, facing_pose
from tests.rigs import random_layout

Method = Callable[[Floats, Floats], Pose | None]
METHODS = pytest.mark.parametrize("method", [pose_by_depths, pose_by_homography])


def rays_of(pose: Pose, layout: Floats) -> Floats:
    mapped = pose.map(np.column_stack([layout, np.zeros(len(layout))]))
    rays: Floats = mapped[:, :2] / mapped[:, 2:]
    return rays


@METHODS
@pytest.mark.parametrize("count", [4, 5, 6])
def test_exact_rays_give_the_exact_pose(rng: np.random.Generator, method: Method, count: int) -> None:
    for _ in range(60):
        # Anywhere about the robot's origin, at any tilt: the thesis' sign and tilt ambiguities are resolved.
        layout = (random_layout(rng) + rng.uniform(-0.1, 0.1, 2))[:count]
        if np.linalg.svd(layout - layout.mean(axis=0))[1][1] < 0.02:
            continue
        pose = facing_pose(rng, tilt_deg=(0, 70))
        found = method(layout, rays_of(pose, layout))
        assert found is not None
        assert_poses_close(found, pose, 1e-7, 1e-5)


@METHODS
def test_a_layout_twice_as_large_is_twice_as_far(rng: np.random.Generator, method: Method) -> None:
    for _ in range(20):
        layout, pose = random_layout(rng), facing_pose(rng)
        rays = rays_of(pose, layout) + 1e-5 * rng.standard_normal((6, 2))
        once, twice = method(layout, rays), method(2.0 * layout, rays)
        assert once is not None
        assert twice is not None
        assert_poses_close(twice, Pose(2.0 * once.position, once.orientation), 1e-9, 1e-9)


@METHODS
@pytest.mark.parametrize(("distance", "tilt", "least", "most"), [(0.8, 15.0, 1.8, 5.0), (2.0, 60.0, 15.0, 50.0)])
def test_the_error_over_the_bound_is_what_it_is_said_to_be(
    rng: np.random.Generator, method: Method, distance: float, tilt: float, least: float, most: float
) -> None:
    sigma, errors, bounds = 0.02 / 1400, [], []
    for _ in range(300):
        layout = random_layout(rng)
        layout -= layout.mean(axis=0)
        pose = facing_pose(rng, (distance, distance), (tilt, tilt))
        found = method(layout, rays_of(pose, layout) + sigma * rng.standard_normal((6, 2)))
        assert found is not None
        errors.append(found.position[2] - pose.position[2])
        a, b = np.empty((6, 6)), np.empty(6)
        points = np.column_stack([layout, np.zeros(6)])
        information = np.tile([sigma**-2, 0.0, sigma**-2], (6, 1))
        normal_equations(pose.rotation, pose.position, points, rays_of(pose, layout), information, a, b)
        bounds.append(np.linalg.inv(np.tril(a) + np.tril(a, -1).T)[2, 2])
    # By medians: where perspective hardly shows, the linear stages' errors have long tails.
    assert least < np.median(np.abs(errors)) / (0.6745 * np.sqrt(np.median(bounds))) < most


@METHODS
def test_there_is_no_pose_of_a_line(rng: np.random.Generator, method: Method) -> None:
    line = np.linspace(-0.05, 0.05, 6)[:, None] * np.array([0.6, 0.8])
    assert method(line, rays_of(facing_pose(rng), line)) is None
    layout = random_layout(rng)
    # A plate seen edge-on, and one whose LEDs are all in one place.
    assert method(layout, np.linspace(-0.1, 0.1, 6)[:, None] * np.array([0.3, 0.1])) is None
    assert method(np.zeros((6, 2)), rays_of(facing_pose(rng), layout)) is None


@METHODS
def test_other_shapes_are_refused(method: Method) -> None:
    with pytest.raises(InputError, match=r"a layout of shape \(3, 2\) with rays of shape \(3, 2\), expected .* four"):
        method(np.zeros((3, 2)), np.zeros((3, 2)))
    with pytest.raises(InputError, match="expected"):
        method(np.zeros((6, 3)), np.zeros((5, 2)))


def test_both_agree_on_six_exact_rays_and_differ_on_noisy_ones(rng: np.random.Generator) -> None:
    layout, pose = random_layout(rng), facing_pose(rng)
    noisy = rays_of(pose, layout) + 1e-4 * rng.standard_normal((6, 2))
    depths, homography = pose_by_depths(layout, noisy), pose_by_homography(layout, noisy)
    assert depths is not None
    assert homography is not None
    assert np.linalg.norm(depths.position - homography.position) > 1e-9
