"""Spots of discs: where the conic of the outline says they are, and poses from them."""

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose
from asterism.server.pose.lens import lens_of
from asterism.server.pose.matched import Constellations, Lit, Matched, Measured
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.spot_shift import DISC_RADIUS, OPTICS, correct_rays, spot_shifts
from tests.helpers import assert_poses_close, conic_centres, facing_pose
from tests.rigs import make_camera, random_layout

RADIUS = 0.0025


def optics(radius: float) -> Floats:
    row = np.zeros(OPTICS)
    row[DISC_RADIUS] = radius
    return row


def plate(rng: np.random.Generator) -> Floats:
    return np.column_stack([random_layout(rng), np.zeros(6)])


def solve(
    layout: Floats, rays: Floats, start: Pose, radius: float, assignment: Floats | None = None
) -> tuple[Floats, Floats, Floats, Floats]:
    """Both minima of one robot: rotations (2, 3, 3), ts (2, 3), costs (2,), residuals (2, 6, 2) px."""
    camera = make_camera()
    pixels = camera.project(np.column_stack([rays, np.ones(len(rays))]))
    covariances = np.tile([(0.01 / 1400) ** 2, 0.0, (0.01 / 1400) ** 2], (6, 1))
    labels = np.arange(6) if assignment is None else assignment
    matched = Matched(np.zeros(1, np.int64), labels[None], start.rotation[None], start.position[None].copy())
    constellations, found = Constellations(layout[None], optics(radius)[None]), Solutions.room(1)
    solve_robots(lens_of(camera), constellations, matched, Measured(rays, covariances, pixels), found)
    return found.rotations[0], found.ts[0], found.costs[0], found.residuals[0]


@pytest.mark.parametrize("radius", [0.001, 0.0025, 0.01])
def test_the_closed_form_is_the_conics_centre(rng: np.random.Generator, radius: float) -> None:
    for _ in range(50):
        layout, pose = plate(rng), facing_pose(rng, depth_m=(0.3, 2.0), tilt_deg=(0, 75))
        shifts = np.empty((6, 2))
        spot_shifts(pose.rotation, pose.position, layout, optics(radius), shifts)
        mapped = pose.map(layout)
        np.testing.assert_allclose(
            mapped[:, :2] / mapped[:, 2:] + shifts, conic_centres(pose, layout, radius), atol=1e-12
        )


@pytest.mark.parametrize("hidden", [0, 1])
def test_poses_of_discs_are_exact_where_the_radius_is_known(rng: np.random.Generator, hidden: int) -> None:
    ignored = []
    for _ in range(40):
        layout, pose = plate(rng), facing_pose(rng, depth_m=(0.5, 1.0), tilt_deg=(20, 65))
        rays = conic_centres(pose, layout, RADIUS)
        assignment = np.arange(6)
        assignment[:hidden] = -1
        rotations, ts, costs, residuals = solve(layout, rays, pose, RADIUS, assignment.copy())
        best = int(np.argmin(costs))
        assert_poses_close(Pose.from_matrix(rotations[best], ts[best]), pose, 2e-9, 1e-7)
        assert np.abs(residuals[best]).max() < 1e-5
        rotations, ts, costs, _ = solve(layout, rays, pose, 0.0, assignment.copy())
        ignored.append(np.linalg.norm(ts[int(np.argmin(costs))] - pose.position))
    assert np.median(ignored) > 2e-6


def test_a_robot_whose_leds_have_no_size_is_left_as_it_is(rng: np.random.Generator) -> None:
    layout, pose = plate(rng), facing_pose(rng)
    lit = Lit(layout, rng.standard_normal((6, 2)), np.zeros((6, 2)), np.ones((6, 3)))
    before = lit.seen.copy()
    assert correct_rays(pose.rotation, pose.position, lit, optics(0.0)) == 0.0
    np.testing.assert_array_equal(lit.seen, before)


def test_the_other_minimum_gets_its_own_shift(rng: np.random.Generator) -> None:
    # Spots drawn at the second minimum's own pose make that one exact, although the first is what was started from.
    for _ in range(20):
        layout, pose = plate(rng), facing_pose(rng, depth_m=(0.8, 1.2), tilt_deg=(25, 45))
        rotations, ts, costs, _ = solve(layout, conic_centres(pose, layout, RADIUS), pose, RADIUS)
        assert costs[1] > costs[0]
        mirror = Pose.from_matrix(rotations[1], ts[1])
        again = solve(layout, conic_centres(mirror, layout, RADIUS), pose, RADIUS)
        best = int(np.argmin(again[2]))
        assert_poses_close(Pose.from_matrix(again[0][best], again[1][best]), mirror, 2e-9, 1e-7)
