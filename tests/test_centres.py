"""Sub-pixel centres: shift and gain laws, known truth, honest covariances."""

import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from tests.rendering import Canvas
from tests.test_segmentation import blobs_of

ESTIMATORS = ("edge-model", "grey-square")


def centre(image: NDArray[np.uint8], estimator: str = "edge-model") -> tuple[Floats, Floats]:
    """Centre and covariance of the one spot that was kept."""
    blobs = blobs_of(image, estimator=estimator)
    assert len(blobs.kept) == 1
    xx, xy, yy = blobs.covariances_px2[blobs.kept[0]]
    return blobs.centres_px[blobs.kept[0]], np.array([[xx, xy], [xy, yy]])


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_shifting_the_image_by_whole_pixels_shifts_the_centre(rng: np.random.Generator, estimator: str) -> None:
    image = Canvas.of(80, 90).ellipse(40.31, 38.77, 2.4).expose(rng)
    here, _ = centre(image, estimator)
    for dx, dy in ((5, 0), (0, -7), (3, 4)):
        there, _ = centre(np.roll(image, (dy, dx), axis=(0, 1)), estimator)
        # The background's interpolation moves by a little.
        np.testing.assert_allclose(there - here, [dx, dy], atol=2e-3)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_turning_the_image_turns_the_centre(rng: np.random.Generator, estimator: str) -> None:
    image = Canvas.of(81, 81).ellipse(43.2, 37.6, 3.0, 2.2, 0.4).expose(rng)
    x, y = centre(image, estimator)[0]
    np.testing.assert_allclose(centre(image.T.copy(), estimator)[0], [y, x], atol=2e-3)
    np.testing.assert_allclose(centre(image[:, ::-1].copy(), estimator)[0], [80 - x, y], atol=2e-3)


@pytest.mark.parametrize(("estimator", "allowed"), [("edge-model", 0.004), ("grey-square", 0.02)])
@pytest.mark.parametrize("radius", [1.5, 2.5, 4.0])
def test_without_noise_the_centre_is_right_at_every_phase(estimator: str, allowed: float, radius: float) -> None:
    errors = []
    for x, y in np.random.default_rng(3).uniform(39.5, 40.5, (12, 2)):
        image = Canvas.of(80, 80).ellipse(x, y, radius, 0.85 * radius, 0.6, level=190).expose()
        errors.append(centre(image, estimator)[0] - [x, y])
    assert np.sqrt(np.mean(np.square(errors))) < allowed


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize(("radius", "level"), [(2.0, 170.0), (3.0, 170.0), (2.5, 60.0)])
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


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_gradient_of_the_background_costs_little(estimator: str) -> None:
    errors = []
    for x, y in np.random.default_rng(5).uniform(59.5, 60.5, (10, 2)):
        image = Canvas.of(120, 120, slope=(0.5, -0.3), background=50).ellipse(x, y, 2.6, level=120).expose()
        errors.append(centre(image, estimator)[0] - [x, y])
    assert np.sqrt(np.mean(np.square(errors))) < 0.012


@pytest.mark.parametrize("away", [4.5, 5.5, 7.0])
def test_a_dim_mirror_image_beside_an_led_is_said_or_removed(rng: np.random.Generator, away: float) -> None:
    # Before a robot claims the spot, its covariance owns up to the light beside it; afterwards both are fitted.
    from asterism.server.centre import refine_leaning

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
        refine_leaning(image, blobs.table, np.array([row]), blobs.centres_px, blobs.covariances_px2)
        after.append(np.abs(blobs.centres_px[row] - [x, y]).max())
    assert np.percentile(before, 90) < 4.0
    assert np.median(after) < 0.08
