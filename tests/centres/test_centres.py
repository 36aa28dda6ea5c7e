"""Sub-pixel centres: shift and gain laws, known truth, honest covariances."""

import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import ESTIMATORS
from asterism.server.centres.centre import GAIN, REFINERS, refine_centres
from asterism.server.centres.leaning_spots import refine_leaning
from asterism.server.segmentation.spot_table import MISFIT, SHOULDER, X, Y
from tests.centres.rendering import Canvas
from tests.segmentation.test_segmentation import blobs_of

# Where every estimator is at home: the discs of Zernike moments have a radius of 3.5 px.
RADII = [(estimator, 5.0 if estimator == "zernike" else 2.5) for estimator in ESTIMATORS]


def centre(image: NDArray[np.uint8], estimator: str = "edge-model") -> tuple[Floats, Floats]:
    """Centre and covariance of the one spot that was kept."""
    blobs = blobs_of(image, estimator=estimator)
    assert len(blobs.kept) == 1
    xx, xy, yy = blobs.covariances_px2[blobs.kept[0]]
    return blobs.centres_px[blobs.kept[0]], np.array([[xx, xy], [xy, yy]])


@pytest.mark.parametrize(("estimator", "radius"), RADII)
def test_shifting_the_image_by_whole_pixels_shifts_the_centre(
    rng: np.random.Generator, estimator: str, radius: float
) -> None:
    image = Canvas.of(80, 90).ellipse(40.31, 38.77, radius).expose(rng)
    here, _ = centre(image, estimator)
    for dx, dy in ((5, 0), (0, -7), (3, 4)):
        there, _ = centre(np.roll(image, (dy, dx), axis=(0, 1)), estimator)
        # The background's interpolation moves by a little.
        np.testing.assert_allclose(there - here, [dx, dy], atol=2e-3)


@pytest.mark.parametrize(("estimator", "radius"), RADII)
def test_turning_the_image_turns_the_centre(rng: np.random.Generator, estimator: str, radius: float) -> None:
    image = Canvas.of(81, 81).ellipse(43.2, 37.6, 1.2 * radius, 0.9 * radius, 0.4).expose(rng)
    x, y = centre(image, estimator)[0]
    np.testing.assert_allclose(centre(image.T.copy(), estimator)[0], [y, x], atol=2e-3)
    np.testing.assert_allclose(centre(image[:, ::-1].copy(), estimator)[0], [80 - x, y], atol=2e-3)


ALLOWED = {"edge-model": 0.004, "grey-square": 0.02, "clip": 0.008, "zernike": 0.006}  # px, without noise


@pytest.mark.parametrize(
    ("estimator", "radius"),
    [(name, radius) for name in ALLOWED for radius in ((3.5, 4.0, 6.0) if name == "zernike" else (1.5, 2.5, 4.0))],
)
def test_without_noise_the_centre_is_right_at_every_phase(estimator: str, radius: float) -> None:
    errors = []
    for x, y in np.random.default_rng(3).uniform(39.5, 40.5, (12, 2)):
        image = Canvas.of(80, 80).ellipse(x, y, radius, 0.85 * radius, 0.6, level=190).expose()
        errors.append(centre(image, estimator)[0] - [x, y])
    assert np.sqrt(np.mean(np.square(errors))) < ALLOWED[estimator]


LOOKS = [(2.0, 170.0), (3.0, 170.0), (2.5, 60.0)]  # radius px, grey levels
LARGE_LOOKS = [(3.5, 170.0), (4.5, 170.0), (4.0, 60.0)]


@pytest.mark.parametrize(
    ("estimator", "radius", "level"),
    [(name, *look) for name in ESTIMATORS for look in (LARGE_LOOKS if name == "zernike" else LOOKS)],
)
def test_covariance_is_meant(rng: np.random.Generator, estimator: str, radius: float, level: float) -> None:
    # Squared error weighted by the covariance averages 2, the number of coordinates; within a third is asked of single
    # spots whose shape is not known.
    squares = []
    for _ in range(120):
        x, y = rng.uniform(29.5, 30.5, 2)
        image = Canvas.of(60, 60).ellipse(x, y, radius, 0.9 * radius, rng.uniform(0, 3), level=level).expose(rng)
        found, covariance = centre(image, estimator)
        error = found - [x, y]
        squares.append(error @ np.linalg.solve(covariance, error))
    assert 1.2 < np.mean(squares) < 2.9


def test_twofold_overexposure_costs_little(rng: np.random.Generator) -> None:
    errors = []
    for _ in range(40):
        x, y = rng.uniform(29.5, 30.5, 2)
        errors.append(centre(Canvas.of(60, 60).ellipse(x, y, 2.6, level=500).expose(rng))[0] - [x, y])
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


@pytest.mark.parametrize(("estimator", "radius"), RADII)
def test_a_gradient_of_the_background_costs_little(estimator: str, radius: float) -> None:
    errors = []
    for x, y in np.random.default_rng(5).uniform(59.5, 60.5, (10, 2)):
        image = Canvas.of(120, 120, slope=(0.5, -0.3), background=50).ellipse(x, y, radius, level=120).expose()
        errors.append(centre(image, estimator)[0] - [x, y])
    assert np.sqrt(np.mean(np.square(errors))) < 0.012


def test_a_spot_too_small_for_zernike_moments_keeps_its_moment_centre_and_says_so(rng: np.random.Generator) -> None:
    for _ in range(20):
        x, y = rng.uniform(29.5, 30.5, 2)
        blobs = blobs_of(Canvas.of(60, 60).ellipse(x, y, 1.0, level=200).expose(rng), estimator="zernike")
        (row,) = blobs.kept
        np.testing.assert_array_equal(blobs.centres_px[row], blobs.table[row, [X, Y]])
        xx, xy, yy = blobs.covariances_px2[row]
        assert xx == yy >= 1.0
        assert xy == 0.0
        assert np.hypot(*(blobs.centres_px[row] - [x, y])) < 0.2


def test_a_neighbours_light_does_not_move_the_edge(rng: np.random.Generator) -> None:
    errors = []
    for _ in range(20):
        x, y = rng.uniform(31.5, 32.5, 2)
        image = Canvas.of(64, 80).ellipse(x, y, 4.5).ellipse(x + 12.0, y, 4.5, level=240).expose(rng)
        blobs = blobs_of(image, estimator="zernike")
        row = int(np.argmin(np.hypot(*(blobs.centres_px - [x, y]).T)))
        errors.append(blobs.centres_px[row] - [x, y])
    assert np.sqrt(np.mean(np.square(errors))) < 0.025  # 0.06 with the edge pixels that see it


@pytest.mark.parametrize("estimator", ["grey-square", "clip", "zernike"])
def test_an_estimator_without_misfit_marks_no_spot_as_strange(rng: np.random.Generator, estimator: str) -> None:
    # What it does not tell of is zero: neither misfit, nor light to one side, nor evidence of the sensor's gain.
    image = Canvas.of(80, 80).ellipse(40.2, 39.7, 4.5).expose(rng)
    spots = blobs_of(image).table
    spots[:, [SHOULDER, MISFIT]] = 0.0
    gain = refine_centres(image, spots, estimator, np.empty((1, 2)), np.empty((1, 3)))
    np.testing.assert_array_equal(spots[:, [SHOULDER, MISFIT]], 0.0)
    assert gain == pytest.approx(GAIN)


def test_every_estimator_of_the_rig_has_a_number() -> None:
    assert sorted(REFINERS) == sorted(ESTIMATORS)


@pytest.mark.parametrize("away", [4.5, 5.5, 7.0])
def test_a_dim_mirror_image_beside_an_led_is_said_or_removed(rng: np.random.Generator, away: float) -> None:
    # Before a robot claims the spot, its covariance owns up to the light beside it; afterwards both are fitted.
    before, after = [], []
    for _ in range(25):
        x, y = rng.uniform(29.5, 30.5, 2)
        angle = rng.uniform(0, 2 * np.pi)
        canvas = Canvas.of(64, 64).ellipse(x, y, 2.5, level=180)
        canvas.ellipse(x + away * np.cos(angle), y + away * np.sin(angle), 2.5, level=50, blur=1.8)
        image = canvas.expose(rng)
        blobs = blobs_of(image)
        row = int(np.argmin(np.hypot(blobs.centres_px[:, 0] - x, blobs.centres_px[:, 1] - y)))
        error = blobs.centres_px[row] - [x, y]
        sigma = np.sqrt(blobs.covariances_px2[row, 0])
        before.append(np.abs(error).max() / sigma)
        refine_leaning(image, blobs.table, np.array([[row]]), blobs.centres_px, blobs.covariances_px2)
        after.append(np.abs(blobs.centres_px[row] - [x, y]).max())
    assert np.percentile(before, 90) < 4.0
    assert np.median(after) < 0.08


def test_a_lone_led_is_not_moved_by_light_that_is_not_there() -> None:
    draws = np.random.default_rng(5)
    worst = 0.0
    for _ in range(20):
        canvas = Canvas.of(400, 480)
        places = []
        for row, column in np.ndindex(5, 6):
            x, y = 40 + 80 * column + draws.uniform(-5, 5), 40 + 80 * row + draws.uniform(-5, 5)
            canvas.ellipse(x, y, 2.0, 1.7, draws.uniform(0, 3), level=100)
            places.append((x, y))
        image = canvas.expose(draws)
        blobs = blobs_of(image)
        refine_leaning(image, blobs.table, blobs.kept[:, None], blobs.centres_px, blobs.covariances_px2)
        for x, y in places:
            worst = max(worst, np.hypot(*(blobs.centres_px[blobs.kept] - [x, y]).T).min())
    assert worst < 0.08  # five sigma of 0.015 px
