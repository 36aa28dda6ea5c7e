"""Pictures worse than the camera's: compressed ones, and motion while the shutter is open; covariances stay meant."""

from functools import lru_cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.segmentation.spot_table import SHOULDER
from tests.centres.lenses import BACKGROUND, SIZE, Lens, Spot, expose, gauss
from tests.segmentation.test_segmentation import blobs_of

USUAL = gauss(0.8)
ROBOTS, LEDS = 4, 6
FRAMES = 3  # of 24 spots: one sigma of a mean NEES is 12 %


def streak(along_x: float, along_y: float) -> Lens:
    """The usual lens while the spot moves by so many px: a line is a sinc."""
    return lambda fx, fy: USUAL(fx, fy) * np.sinc(along_x * fx + along_y * fy)


@lru_cache(maxsize=FRAMES)
def drawn(frame: int, widths: float) -> tuple[Floats, list[Spot]]:
    """Light of a frame of four robots' LEDs, a robot to a row, anywhere in their cells; each robot moves by so many
    widths of its spots.
    """
    rng = np.random.default_rng([17, frame])
    light, spots = np.full((ROBOTS * SIZE, LEDS * SIZE), BACKGROUND), []
    for row in range(ROBOTS):
        a, aspect, angle, way = rng.uniform((1.6, 0.6, 0.0, 0.0), (3.5, 1.0, np.pi, 2 * np.pi))
        level, far = rng.uniform(80.0, 240.0), 2.0 * a * widths
        lens = streak(far * np.cos(way), far * np.sin(way)) if widths else USUAL
        for column in range(LEDS):
            x, y = rng.uniform(-4.0, 4.0, 2)
            spot = Spot(lens, a, aspect * a, level, x=x, y=y, angle=angle)
            light[row * SIZE : (row + 1) * SIZE, column * SIZE : (column + 1) * SIZE] = spot.light()
            spots.append(spot)
    return light, spots


def compressed(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """The image through JPEG."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def centred(quality: int | None = None, widths: float = 0.0) -> tuple[Floats, Floats, Floats, Floats]:
    """Of all n spots: error (n, 2) px, covariance (n, 2, 2) px^2, bound of a coordinate (n,) px^2, SHOULDER (n,)."""
    errors, covariances, bounds, shoulders = [], [], [], []
    for frame in range(FRAMES):
        light, spots = drawn(frame, widths)
        image = expose(light, np.random.default_rng([18, frame]))
        blobs = blobs_of(image if quality is None else compressed(image, quality), 20.0)
        for k, spot in enumerate(spots):
            row, column = divmod(k, LEDS)
            centre = np.array([column + 0.5, row + 0.5]) * SIZE + [spot.x, spot.y]
            if column == 0:
                bound = np.trace(spot.bound()) / 2.0
            (found,) = (i for i in blobs.kept if np.hypot(*(blobs.centres_px[i] - centre)) < 3.0)
            xx, xy, yy = blobs.covariances_px2[found]
            errors.append(blobs.centres_px[found] - centre)
            covariances.append([[xx, xy], [xy, yy]])
            bounds.append(bound)
            shoulders.append(blobs.table[found, SHOULDER])
    return np.array(errors), np.array(covariances), np.array(bounds), np.array(shoulders)


def nees(errors: Floats, covariances: Floats) -> float:
    """Squared error weighted by the covariance, over the 2 that are expected."""
    return float(np.mean(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors))) / 2.0


def test_clean_pictures_are_not_widened() -> None:
    errors, covariances, bounds, shoulders = centred()
    assert 0.65 < nees(errors, covariances) < 1.3
    # A quarter of the variance for the sensor's gain, which few spots tell so well only.
    assert np.mean(np.trace(covariances, axis1=1, axis2=2) / 2.0 / bounds) < 1.5
    assert not np.any(shoulders)


@pytest.mark.parametrize("quality", [95, 85])
def test_covariances_of_compressed_pictures_are_meant(quality: int) -> None:
    errors, covariances, _, shoulders = centred(quality)
    assert 0.5 < nees(errors, covariances) < 2.0
    # Compression errors are no other light.
    assert np.mean(shoulders > 0.0) < 0.25


@pytest.mark.parametrize("widths", [0.5, 1.0, 2.0])
def test_streaks_are_centred_at_mid_exposure_with_covariances_that_are_meant(widths: float) -> None:
    errors, covariances, bounds, shoulders = centred(widths=widths)
    assert np.sqrt(np.mean(np.sum(np.square(errors), axis=1) / 2.0 / bounds)) < (1.5 if widths <= 1.0 else 2.0)
    assert 0.4 < nees(errors, covariances) < 2.0
    assert np.mean(shoulders > 0.0) < (0.35 if widths <= 1.0 else 0.5)


def test_what_leans_on_some_spots_is_not_taken_for_noise_of_the_picture() -> None:
    beside = np.random.default_rng(3)
    light, spots = drawn(0, 0.0)
    image = expose(light, np.random.default_rng(4))
    y, x = np.mgrid[: light.shape[0], : light.shape[1]]
    for k, spot in enumerate(spots[:8]):
        row, column = divmod(k, LEDS)
        away = beside.uniform(0, 2 * np.pi)
        cx, cy = (column + 0.5) * SIZE + spot.x + 5.0 * np.cos(away), (row + 0.5) * SIZE + spot.y + 5.0 * np.sin(away)
        light = light + 40.0 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 8.0)
    leaned = blobs_of(expose(light, np.random.default_rng(4)), 20.0)
    clean = blobs_of(image, 20.0)
    for row in leaned.kept:
        if leaned.centres_px[row, 1] < 2 * SIZE:
            continue
        same = int(np.argmin(np.hypot(*(clean.centres_px - leaned.centres_px[row]).T)))
        # But for what the spots tell of the sensor's gain, nothing has changed.
        np.testing.assert_allclose(leaned.covariances_px2[row], clean.covariances_px2[same], rtol=0.15, atol=1e-6)
