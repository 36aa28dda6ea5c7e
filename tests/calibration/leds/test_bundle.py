"""Bundle adjustment of LED positions: laws of its gauge, honest covariances, mistakes among the centres."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, exp_rotation, log_rotation
from asterism.protocol.led_offset import LedOffset
from asterism.server.calibration.leds.bundle import Adjusted, Disc, Views, adjust, linearise
from asterism.server.calibration.leds.calibration import shape_sigma
from asterism.server.calibration.leds.gauge import Gauge, rigid_fit
from tests.calibration.leds.films import hand_poses, off_by
from tests.helpers import numeric_jacobian, random_rotation
from tests.rigs import FOCAL_PX, random_layouts

SIGMA_PX = 0.02
LAYOUT = random_layouts(1, 11)[0]
UP = np.array([0.0, 0.0, 1.0])
FLAT = Disc(UP, 0.0, UP)


def true_leds(rng: np.random.Generator) -> Floats:
    return np.column_stack([LAYOUT, 3e-4 * rng.standard_normal(6)])


def seen(
    rng: np.random.Generator,
    leds: Floats,
    count: int = 40,
    disc: Disc = FLAT,
    depths_m: tuple[float, float] = (0.8, 1.5),
) -> Views:
    """Noisy views of the LEDs; the poses are true."""
    poses = hand_poses(count, int(rng.integers(1 << 30)), depths_m=depths_m)
    information = np.tile(np.eye(2) * (FOCAL_PX / SIGMA_PX) ** 2, (count, 6, 1, 1))
    views = Views(
        np.zeros((count, 6, 2)),
        information,
        np.array([pose.rotation for pose in poses]),
        np.array([pose.position for pose in poses]),
    )
    exact = -linearise(leds, views, disc)[0]
    noisy = exact + rng.standard_normal(exact.shape) * SIGMA_PX / FOCAL_PX
    return Views(noisy, information, views.rotations, views.ts)


def length(leds: Floats, i: int = 0, j: int = 3) -> tuple[int, int, float]:
    return i, j, float(np.linalg.norm(leds[i] - leds[j]))


def error(adjusted: Adjusted, true: Floats, given: Floats) -> Floats:
    """(6, 3), in the frame that the adjustment keeps."""
    turn, shift = rigid_fit(true, given)
    return adjusted.leds - (true @ turn.T + shift)


DOME = replace(FLAT, offset=LedOffset.polynomial(np.array([0.0, 0.6e-3, 0.8e-3]), 1.2))


@pytest.mark.parametrize("disc", [Disc(UP, 1e-6, UP), DOME])
def test_derivatives_are_those_of_the_prediction(rng: np.random.Generator, disc: Disc) -> None:
    leds = true_leds(rng)
    views = seen(rng, leds, 3)
    _, by_pose, by_led = linearise(leds, views, disc)

    def of_pose(move: Floats) -> Floats:
        rotations, ts = views.rotations.copy(), views.ts.copy()
        rotations[0], ts[0] = exp_rotation(move[3:]) @ rotations[0], ts[0] + move[:3]
        return -linearise(leds, Views(views.rays, views.information, rotations, ts), disc)[0][0].ravel()

    def of_leds(values: Floats) -> Floats:
        return -linearise(values.reshape(6, 3), views, disc)[0][1].ravel()

    np.testing.assert_allclose(numeric_jacobian(of_pose, np.zeros(6)), by_pose[0].reshape(12, 6), atol=1e-7)
    numeric = numeric_jacobian(of_leds, leds.ravel()).reshape(6, 2, 6, 3)
    for led in range(6):
        np.testing.assert_allclose(numeric[led, :, led], by_led[1, led], atol=1e-7)


def test_the_centre_of_a_discs_image_is_that_of_its_rims_ellipse() -> None:
    """The closed form against points on the rim, projected, and the ellipse through them."""
    radius, normal = 0.01, np.array([0.5, -0.3, -0.8])
    normal = normal / np.linalg.norm(normal)
    centre = np.array([0.12, -0.2, 0.6])
    across = np.cross(normal, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, 50, endpoint=False)[:, None]
    rim = centre + radius * (np.cos(angle) * across + np.sin(angle) * np.cross(normal, across))
    x, y = (rim[:, :2] / rim[:, 2:]).T
    # The conic a x2 + b xy + c y2 + d x + e y = 1 and its centre.
    a, b, c, d, e = np.linalg.lstsq(np.column_stack([x * x, x * y, y * y, x, y]), np.ones(50), rcond=None)[0]
    middle = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
    leds = np.zeros((6, 3))
    views = Views(np.zeros((1, 6, 2)), np.zeros((1, 6, 2, 2)), np.eye(3)[None], centre[None])
    predicted = -linearise(leds, views, Disc(normal, radius, normal))[0][0, 0]
    np.testing.assert_allclose(predicted, middle, atol=1e-11)
    assert np.linalg.norm(predicted - centre[:2] / centre[2]) * FOCAL_PX > 0.1


@pytest.mark.parametrize(
    ("disc", "depths_m"),
    [
        (FLAT, (0.8, 1.5)),
        (replace(FLAT, radius=0.004), (0.3, 0.5)),
        (DOME, (0.3, 0.5)),
    ],
    ids=["points", "discs", "domes"],
)
def test_errors_are_as_large_as_the_covariance_says(
    rng: np.random.Generator, disc: Disc, depths_m: tuple[float, float]
) -> None:
    """Eleven of the eighteen numbers are free: their weighted squared errors average 11 over many films."""
    films = 20
    squared = []
    for _ in range(films):
        leds = true_leds(rng)
        given = leds + off_by(rng, 1e-3)
        adjusted = adjust(given, seen(rng, leds, 40, disc, depths_m), Gauge(given, length(leds)), disc)
        off = error(adjusted, leds, given).ravel()
        squared.append(off @ np.linalg.pinv(adjusted.covariance, rcond=1e-8, hermitian=True) @ off)
        assert np.linalg.matrix_rank(adjusted.covariance, tol=1e-8 * np.trace(adjusted.covariance)) == 11
        assert 0.7 < adjusted.chi2_per_dof < 1.3
    assert abs(np.mean(squared) - 11) < 4 * np.sqrt(2 * 11 / films)


def test_the_frame_and_the_measured_distance_are_kept(rng: np.random.Generator) -> None:
    leds = true_leds(rng)
    given = leds + off_by(rng, 1e-3)
    views = seen(rng, leds)
    first, second, metres = length(leds, 4, 1)
    for stretched in (1.0, 1.02):
        adjusted = adjust(given, views, Gauge(given, (first, second, stretched * metres)), FLAT)
        turn, shift = rigid_fit(adjusted.leds, given)
        np.testing.assert_allclose(turn, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(shift, np.zeros(3), atol=1e-9)
        assert np.linalg.norm(adjusted.leds[4] - adjusted.leds[1]) == pytest.approx(stretched * metres, abs=1e-12)
        # What is fixed by convention has no uncertainty.
        shifted = np.tile(np.eye(3), (6, 1))
        assert np.abs(shifted.T @ adjusted.covariance @ shifted).max() < 1e-20


@pytest.mark.parametrize("anchors", [(0, 3), (4, 1)])
def test_two_leds_hold_the_frame(rng: np.random.Generator, anchors: tuple[int, int]) -> None:
    """The first stays, the second keeps its direction; errors in that frame are as large as the covariance says."""
    first, second = anchors
    squared, films = [], 20
    for _ in range(films):
        leds = true_leds(rng)
        given = leds + off_by(rng, 1e-3)
        gauge = Gauge(given, length(leds), anchors)
        adjusted = adjust(given, seen(rng, leds), gauge, FLAT)
        np.testing.assert_allclose(adjusted.leds[first], given[first], atol=1e-12)
        along, kept = (points[second] - points[first] for points in (adjusted.leds, given))
        np.testing.assert_allclose(along / np.linalg.norm(along), kept / np.linalg.norm(kept), atol=1e-9)
        turn, _ = rigid_fit(adjusted.leds, given)
        assert np.degrees(np.arccos(turn[2, 2])) < 4.0  # the plate is not turned over
        _, turn, shift = gauge.placed(leds)
        off = (adjusted.leds - (leds @ turn.T + shift)).ravel()
        squared.append(off @ np.linalg.pinv(adjusted.covariance, rcond=1e-8, hermitian=True) @ off)
        assert adjusted.sigmas[first].max() < 1e-12
    assert abs(np.mean(squared) - 11) < 4 * np.sqrt(2 * 11 / films)


def test_the_shapes_sigma_is_the_same_whatever_holds_the_frame(rng: np.random.Generator) -> None:
    leds = true_leds(rng)
    given, views = leds + off_by(rng, 1e-3), seen(rng, leds)
    shapes = [
        shape_sigma(adjust(given, views, Gauge(given, length(leds), anchors), FLAT))
        for anchors in (None, (0, 3), (2, 5))
    ]
    np.testing.assert_allclose(shapes, shapes[0], rtol=1e-6)


def test_frames_move_as_far_as_they_are_said_to(rng: np.random.Generator) -> None:
    """Given positions drawn anew, off by one sigma: how far the frame that they hold is from the true one."""
    leds, sigmas = true_leds(rng), (0.3e-3, 0.1e-3)
    for anchors in (None, (0, 3)):
        shifts, turns = [], []
        for _ in range(300):
            gauge = Gauge(leds + rng.standard_normal((6, 3)) * [sigmas[0], *sigmas], length(leds), anchors)
            _, turn, shift = gauge.placed(leds)
            place = leds[0] if anchors else leds.mean(axis=0)
            shifts.append(turn @ place + shift - place)
            turns.append(log_rotation(turn))
        told = gauge.frame_sigmas(*sigmas, UP)
        assert np.sqrt(np.mean(np.square(shifts), axis=0)).max() == pytest.approx(told[0], rel=0.15)
        spread = np.cov(np.transpose(turns))
        assert np.sqrt(np.linalg.eigvalsh(spread[:2, :2])[-1]) == pytest.approx(told[1], rel=0.3)
        assert np.sqrt(spread[2, 2]) == pytest.approx(told[2], rel=0.15)


def test_moving_the_robots_frame_moves_the_result_with_it(rng: np.random.Generator) -> None:
    leds = true_leds(rng)
    given, views = leds + off_by(rng, 1e-3), seen(rng, leds)
    here = adjust(given, views, Gauge(given, length(leds)), FLAT)
    turn, shift = random_rotation(rng), np.array([0.1, -0.2, 0.3])
    rotations = views.rotations @ turn.T
    moved = Views(views.rays, views.information, rotations, views.ts - rotations @ shift)
    there = given @ turn.T + shift
    elsewhere = adjust(there, moved, Gauge(there, length(leds)), Disc(turn @ UP, 0.0, turn @ UP))
    np.testing.assert_allclose(elsewhere.leds, here.leds @ turn.T + shift, atol=1e-8)


def test_wrong_tilts_at_the_start_are_turned_over(rng: np.random.Generator) -> None:
    leds = true_leds(rng)
    given, views = leds + off_by(rng, 1e-3), seen(rng, leds)
    right = adjust(given, views, Gauge(given, length(leds)), FLAT)
    sight = views.ts / np.linalg.norm(views.ts, axis=1, keepdims=True)
    mirror = np.eye(3) - 2 * sight[:, :, None] * sight[:, None]
    mirrored = mirror @ views.rotations @ np.diag([1.0, 1.0, -1.0])
    wrong = np.where((rng.random(len(views)) < 0.3)[:, None, None], mirrored, views.rotations)
    found = adjust(given, Views(views.rays, views.information, wrong, views.ts), Gauge(given, length(leds)), FLAT)
    np.testing.assert_allclose(found.leds, right.leds, atol=1e-7)


def test_wrong_centres_are_left_out(rng: np.random.Generator) -> None:
    leds = true_leds(rng)
    given, views = leds + off_by(rng, 1e-3), seen(rng, leds, 60)
    rays = views.rays.copy()
    wrong = rng.choice(360, 20, replace=False)
    rays.reshape(-1, 2)[wrong] += rng.uniform(0.5, 3.0, (20, 2)) / FOCAL_PX
    adjusted = adjust(
        given, Views(rays, views.information, views.rotations, views.ts), Gauge(given, length(leds)), FLAT
    )
    assert 20 <= adjusted.left_out < 60
    off = error(adjusted, leds, given)
    assert (np.abs(off) < 4.5 * adjusted.sigmas).all()
