"""Covariances that are meant: with the spots' own noise alone, and with errors that nobody told the solver of."""

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, log_rotation
from asterism.server.pose.lens import lens_of
from asterism.server.pose.matched import Constellations, Matched, Measured
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.spot_shift import OPTICS
from tests.helpers import facing_pose
from tests.rigs import make_camera, random_layout

SIGMA_PX = 0.006
ROBOTS = 800


def nees(rng: np.random.Generator, hidden: int, led_error_m: float) -> tuple[Floats, Floats]:
    """NEES (n,) and rms px (n,) of many robots; some LEDs are hidden, all are somewhere else than the rig says."""
    camera, sigma = make_camera(), SIGMA_PX / 1400
    layouts, poses, rays = np.zeros((ROBOTS, 6, 3)), [], np.empty((6 * ROBOTS, 2))
    assignment = np.arange(6 * ROBOTS).reshape(ROBOTS, 6)
    for k in range(ROBOTS):
        layouts[k, :, :2] = random_layout(rng)
        pose = facing_pose(rng, (0.8, 1.5), (15, 50))
        real = layouts[k] + led_error_m * rng.standard_normal((6, 3)) * [1, 1, 0]
        mapped = pose.map(real)
        rays[6 * k : 6 * k + 6] = mapped[:, :2] / mapped[:, 2:] + sigma * rng.standard_normal((6, 2))
        poses.append(pose)
    assignment[:, :hidden] = -1
    ray_covariances = np.tile([sigma**2, 0.0, sigma**2], (6 * ROBOTS, 1))
    pixels = camera.project(np.column_stack([rays, np.ones(len(rays))]))
    starts = np.array([pose.rotation for pose in poses]), np.array([pose.position for pose in poses])
    matched, found = Matched(np.arange(ROBOTS), assignment, *starts), Solutions.room(ROBOTS)
    constellations = Constellations(layouts, np.zeros((ROBOTS, OPTICS)))
    solve_robots(lens_of(camera), constellations, matched, Measured(rays, ray_covariances, pixels), found)
    told = []
    for k, pose in enumerate(poses):
        turned = log_rotation(found.rotations[k, 0] @ pose.rotation.T)
        error = np.concatenate([found.ts[k, 0] - pose.position, turned])
        told.append(error @ np.linalg.solve(found.covariances[k, 0], error))
    return np.array(told), np.sqrt(np.square(found.residuals[:, 0]).mean(axis=(1, 2)))


@pytest.mark.parametrize("hidden", [0, 1, 2])
def test_with_the_spots_own_noise_alone_the_weighted_squared_error_averages_six(
    rng: np.random.Generator, hidden: int
) -> None:
    # One sigma of the mean of 800 is 0.12; residuals that are large by luck widen some covariances, and of four LEDs,
    # with two degrees of freedom, so does what they may be off by.
    assert (4.2 if hidden == 2 else 4.9) < nees(rng, hidden, 0.0)[0].mean() < 6.4


@pytest.mark.parametrize("hidden", [0, 1])
@pytest.mark.parametrize("led_error_m", [5e-5, 2e-4])
def test_leds_that_are_not_where_the_rig_says_widen_the_covariance(
    rng: np.random.Generator, led_error_m: float, hidden: int
) -> None:
    weighted, rms = nees(rng, hidden, led_error_m)
    # Ten and forty times the spots' noise: on that alone the squared error would average a hundred times as much. Four
    # degrees of freedom tell little of each robot's own, so it is six within a factor.
    assert 2.0 < np.median(weighted) < 6.0
    assert weighted.mean() < 10.0
    assert np.median(rms) > 2 * SIGMA_PX
