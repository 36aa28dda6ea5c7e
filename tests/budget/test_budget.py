"""The error budget: every source as the solver itself answers it, laws, agreement with the errors that are made, and
the page that tells it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.budget.budget import (
    COMPONENTS,
    SOURCES,
    TILTS,
    Light,
    Poses,
    covariances_of,
    image_by_pose,
    image_factors,
    pose_by_image,
    poses_at,
)
from asterism.server.budget.uncertainty import LedError, Uncertainty
from asterism.server.budget.workspace import budget_of
from asterism.server.centres.centre_noise import ROUNDING, centre_covariances, centre_variances
from asterism.server.simulation.simulate import Look
from tests.budget.error_sources import Errors, solved, spots
from tests.centres.bounds import centre_bound
from tests.rigs import make_rig

LIGHT = Light(Look(), 1.0)
PLACES = np.array([[x, y] for x in (250.0, 640.0, 1030.0) for y in (200.0, 824.0)])
NOTHING = Uncertainty(
    centre_px=0.0,
    bias_px=0.0,
    led_position_m=0.0,
    offset_m=0.0,
    focal_relative=0.0,
    principal_point_px=0.0,
    distortion_relative=0.0,
)


def spot_covariances(rig: Rig, poses: Poses) -> Floats:
    """What an estimator would say of the spots (n, 6, 2, 2), px^2."""
    robot = rig.robots[0]
    points = np.array([Pose.from_matrix(r, t).map(robot.leds) for r, t in zip(poses.rotations, poses.ts, strict=True)])
    normals = np.broadcast_to((poses.rotations @ robot.axis)[:, None], points.shape)
    noise, rounding = centre_covariances(points, normals, robot.led_radius or 0.0, rig.camera.focal_px, Look())
    return noise + rounding


def one_led(k: int) -> Floats:
    leds = np.zeros(18)
    leds[k] = 1.0
    return leds.reshape(6, 3)


def _leds(k: int) -> Floats:
    """Each coordinate alone, and all together larger."""
    leds = make_rig(1).robots[0].leds
    return 1e-6 * one_led(k) if k < 18 else 1e-5 * (leds - leds.mean(axis=0))


# A small amount of each source: by name, its error for cause k, the uncertainty of that size, and how many causes.
SIZE = {"r00": LedError(1e-6, 1e-5, "a test")}
SMALL: list[tuple[str, Callable[[int], Errors], Uncertainty, int]] = [
    ("LED positions", lambda k: Errors(leds=_leds(k)), replace(NOTHING, robots=SIZE), 19),
    ("LED positions", lambda k: Errors(leds=1e-6 * one_led(k)), replace(NOTHING, led_position_m=1e-6), 18),
    ("LED angular offset", lambda _: Errors(offset_m=1e-6), replace(NOTHING, offset_m=1e-6), 1),
    ("focal length", lambda _: Errors(focal=1e-5), replace(NOTHING, focal_relative=1e-5), 1),
    ("principal point", lambda k: Errors(centre=1e-2 * np.eye(2)[k]), replace(NOTHING, principal_point_px=1e-2), 2),
    ("distortion", lambda _: Errors(distortion=1e-4), replace(NOTHING, distortion_relative=1e-4), 1),
]


@pytest.mark.parametrize(("name", "errors", "uncertainty", "causes"), SMALL, ids=[f"{r[0]} {r[3]}" for r in SMALL])
def test_every_source_alone_moves_the_pose_as_the_solver_says(
    name: str, errors: Callable[[int], Errors], uncertainty: Uncertainty, causes: int
) -> None:
    rig = make_rig(1)
    robot = rig.robots[0]
    poses, _ = poses_at(rig, robot, 1.1, PLACES[::3], (20.0, 50.0))
    told = spot_covariances(rig, poses)
    by_point, by_pose = image_by_pose(rig, robot, poses)
    factor = image_factors(rig, robot, poses, uncertainty, LIGHT, by_point)[name]
    assert factor.shape[-1] == causes
    predicted = pose_by_image(by_pose, told, np.ones((len(poses), 6)), np.zeros(len(poses))) @ factor
    each = [Pose.from_matrix(r, t) for r, t in zip(poses.rotations, poses.ts, strict=True)]
    still = np.array([spots(rig, robot, pose, Errors()) for pose in each])
    unmoved, _ = solved(rig, robot, poses, still, told)
    assert np.abs(unmoved).max() < 1e-9
    for cause in range(causes):
        moved, _ = solved(rig, robot, poses, np.array([spots(rig, robot, p, errors(cause)) for p in each]), told)
        scale = np.abs(predicted).max(axis=(0, 2))
        assert np.all(np.abs(moved - predicted[..., cause]) < 5e-3 * scale), name


def test_centre_noise_alone_moves_the_pose_as_the_solver_says(rng: np.random.Generator) -> None:
    rig = make_rig(1)
    robot = rig.robots[0]
    poses, _ = poses_at(rig, robot, 1.1, PLACES[:1], (30.0,))
    told = spot_covariances(rig, poses)
    _, by_pose = image_by_pose(rig, robot, poses)
    to_pose = pose_by_image(by_pose, told, np.ones((len(poses), 6)), np.zeros(len(poses)))
    each = [Pose.from_matrix(r, t) for r, t in zip(poses.rotations, poses.ts, strict=True)]
    shift = 1e-4 * rng.standard_normal((len(poses), 6, 2))
    moved, _ = solved(rig, robot, poses, np.array([spots(rig, robot, p, Errors()) for p in each]) + shift, told)
    expected = np.einsum("nij,nj->ni", to_pose, shift.reshape(len(poses), 12))
    assert np.all(np.abs(moved - expected) < 1e-2 * np.abs(expected).max(axis=0))


def test_with_all_sources_on_the_budget_is_within_fifteen_percent_of_the_solvers_errors(
    rng: np.random.Generator,
) -> None:
    rig, uncertainty = make_rig(1, seed=3), Uncertainty()
    robot = rig.robots[0]
    for distance in (0.8, 1.9):
        poses, _ = poses_at(rig, robot, distance, np.tile(PLACES, (3, 1)), TILTS)
        n = len(poses)
        predicted = covariances_of(rig, robot, poses, uncertainty, LIGHT).sum(axis=1)
        by_point, _ = image_by_pose(rig, robot, poses)
        factors = image_factors(rig, robot, poses, uncertainty, LIGHT, by_point)
        each = [Pose.from_matrix(r, t) for r, t in zip(poses.rotations, poses.ts, strict=True)]
        seen = np.array([spots(rig, robot, pose, Errors.drawn(uncertainty, rng)) for pose in each])
        for name in ("centre noise", "quantisation", "centre bias"):
            seen += np.einsum("nij,nj->ni", factors[name], rng.standard_normal((n, 12))).reshape(n, 6, 2)
        errors, _ = solved(rig, robot, poses, seen, spot_covariances(rig, poses))
        variances = np.diagonal(predicted, axis1=1, axis2=2)
        # 432 errors: one sigma of their root mean square is 3.4 %.
        ratio = np.sqrt(np.mean(errors**2 / variances, axis=0))
        assert np.all(np.abs(ratio - 1.0) < 0.15), dict(zip(COMPONENTS, ratio, strict=True))
        weighted = np.einsum("ni,ni->n", errors, np.linalg.solve(predicted, errors[..., None])[..., 0])
        assert 5.0 < weighted.mean() < 7.0


def variances_at(rig: Rig, distance: float, uncertainty: Uncertainty) -> Floats:
    """Mean variances (sources, 6) over poses."""
    poses, _ = poses_at(rig, rig.robots[0], distance, PLACES, TILTS)
    return np.diagonal(covariances_of(rig, rig.robots[0], poses, uncertainty, LIGHT), axis1=2, axis2=3).mean(axis=0)


@pytest.mark.parametrize(
    ("key", "source"),
    [
        ("centre_px", "centre noise"),
        ("bias_px", "centre bias"),
        ("led_position_m", "LED positions"),
        ("offset_m", "LED angular offset"),
        ("focal_relative", "focal length"),
        ("principal_point_px", "principal point"),
        ("distortion_relative", "distortion"),
    ],
)
def test_a_source_twice_as_large_alone_has_four_times_the_variance_and_the_others_none(key: str, source: str) -> None:
    rig = make_rig(1)
    least = NOTHING if key == "centre_px" else replace(NOTHING, centre_px=0.01)
    size = 0.01 if key.endswith("px") else 1e-5
    once = variances_at(rig, 1.0, replace(least, **{key: size}))
    twice = variances_at(rig, 1.0, replace(least, **{key: 2.0 * size}))
    row = SOURCES.index(source)
    assert np.allclose(twice[row], 4.0 * once[row], rtol=0.02)
    assert np.all(once[row] > 0.0)
    others = [k for k, name in enumerate(SOURCES) if name not in (source, "centre noise")]
    assert np.all(once[others] == 0.0)


def test_how_errors_grow_with_distance() -> None:
    rig = make_rig(1, camera=None)
    u = replace(Uncertainty(), centre_px=0.02)
    near, far = np.sqrt(variances_at(rig, 0.9, u)), np.sqrt(variances_at(rig, 1.8, u))
    growth = dict(zip(SOURCES, far / np.where(near > 0, near, 1.0), strict=True))
    z = COMPONENTS.index("z")
    assert growth["centre noise"][z] == pytest.approx(4.0, rel=0.05)  # the size of the image shrinks as it goes
    assert growth["LED positions"][z] == pytest.approx(2.0, rel=0.05)  # a scale
    assert growth["focal length"][z] == pytest.approx(2.0, rel=0.01)
    assert growth["principal point"][0] == pytest.approx(2.0, rel=0.01)
    assert growth["LED angular offset"][0] == pytest.approx(1.0, rel=0.05)  # a shift in m, whatever the distance


def test_twice_the_spread_of_the_leds_halves_what_their_positions_do() -> None:
    rig = make_rig(1)
    robot = rig.robots[0]
    large = replace(rig, robots=(replace(robot, leds=2.0 * robot.leds),))
    u = replace(NOTHING, led_position_m=5e-5, centre_px=0.01)
    small_z, large_z = (np.sqrt(variances_at(r, 1.5, u)[3]) for r in (rig, large))
    assert large_z[2:] == pytest.approx(0.5 * small_z[2:], rel=0.05)


def test_a_focal_length_that_is_off_is_a_scale_of_z() -> None:
    u = replace(NOTHING, focal_relative=1e-3, centre_px=0.01)
    z = np.sqrt(variances_at(make_rig(1), 1.25, u)[SOURCES.index("focal length"), 2])
    assert z == pytest.approx(1.25e-3, rel=0.02)


def test_a_hidden_led_makes_it_worse_and_nothing_depends_on_it() -> None:
    rig, u = make_rig(1), Uncertainty()
    robot = rig.robots[0]
    poses, _ = poses_at(rig, robot, 1.2, PLACES[:2], (30.0,))
    seen = np.ones((len(poses), 6))
    whole = covariances_of(rig, robot, poses, u, LIGHT, seen)
    seen[:, 2] = 0.0
    less = covariances_of(rig, robot, poses, u, LIGHT, seen)
    noise = np.diagonal(less[:, 0], axis1=1, axis2=2) / np.diagonal(whole[:, 0], axis1=1, axis2=2)
    assert np.all(noise > 0.98)  # weights differ a little
    assert noise.mean() > 1.1
    moved = replace(robot, leds=robot.leds + 1e-4 * one_led(6))
    assert np.allclose(covariances_of(replace(rig, robots=(moved,)), moved, poses, u, LIGHT, seen), less, rtol=2e-2)


@pytest.mark.parametrize(("a", "q"), [(1.5, 0.9), (3.0, 0.7), (6.0, 0.5)])
def test_the_noise_of_centres_is_the_independent_bound(a: float, q: float) -> None:
    bound = np.sqrt(np.diag(centre_bound(a, q * a, 0.0, 170.0)))
    ours = np.sqrt(centre_variances(a, q * a, 170.0, Look(psf_px=0.9, read_noise=1.2, gain=0.03), True))
    # The bound's differences of supersampled images make it a few percent too good.
    assert ours == pytest.approx(bound, rel=0.06)


def test_the_axes_of_the_noise_turn_with_the_ellipse() -> None:
    point = np.array([0.0, 0.0, 1.0])
    for angle in (0.0, 0.7, 2.0):
        lean = np.array([np.cos(angle), np.sin(angle), 0.0])
        normal = 0.8 * lean - 0.6 * np.array([0, 0, 1.0])
        noise, rounding = centre_covariances(point[None], normal[None], 0.004, 1000.0, Look())
        along, across = centre_variances(4.0, 2.4, 0.6 * Look().brightness, Look(), False)
        short = lean[:2]
        assert short @ noise[0] @ short == pytest.approx(across, rel=0.02)
        long = np.array([-short[1], short[0]])
        assert long @ noise[0] @ long == pytest.approx(along, rel=0.02)
        assert 0.0 < np.trace(rounding[0]) < ROUNDING * np.trace(noise[0])


def test_the_workspace_is_the_rigs_range_and_image() -> None:
    rig = make_rig(2, range_m=(0.9, 1.7))
    budget = budget_of(rig, Uncertainty(), LIGHT)
    assert budget.distances[[0, -1]] == pytest.approx([0.9, 1.7])
    assert np.isfinite(budget.by_place).all()
    total = budget.by_distance.sum(axis=1)
    assert np.all(np.diff(total[:, :3], axis=0) > 0.0)
    assert 0.0 < budget.across[0] < budget.across[-1] < rig.camera.width
    assert 0.0 < budget.down[0] < budget.down[-1] < rig.camera.height
    assert budget.by_tilt[0].sum(axis=0)[3] > 4.0 * budget.by_tilt[-1].sum(axis=0)[3]  # tilt is weak seen in front
