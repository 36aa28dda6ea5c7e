"""Spots that other light leans on: centres near what both lights' noise allows, with covariances that are meant."""

import numpy as np
import pytest

from asterism.server.centres.leaning_spots import refine_leaning
from asterism.server.segmentation.spot_table import SHOULDER
from tests.centres.rendering import Canvas
from tests.centres.test_centres import blobs_of

SIBLINGS = ((120.3, 40.1), (170.7, 39.6))  # other LEDs of the robot, that nothing leans on


def beside(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, float, float]:
    """Error (2,) px of an LED's centre with other light beside it, weighted by its covariance, and its sigma.

    The light is noticed by whoever centres the spot alone.
    """
    a = rng.uniform(2.2, 4.0)
    b, turn, level = a * rng.uniform(0.75, 1.0), rng.uniform(0, np.pi), rng.uniform(90, 190)
    at = 40 + rng.uniform(-0.5, 0.5, 2)
    canvas = Canvas.of(80, 200, 8.0)
    canvas.psf_px = rng.uniform(0.65, 0.9)
    for x, y in ((at[0], at[1]), *SIBLINGS):
        canvas.ellipse(x, y, a, b, turn, level)
    along = rng.uniform(0, 2 * np.pi)
    away = np.array([np.cos(along), np.sin(along)]) * a
    if kind == "mirror image":
        x, y = at + away * rng.uniform(0.9, 2.5)
        canvas.ellipse(x, y, a, b, turn, level * rng.uniform(0.2, 0.55))
    elif kind == "touching LED":
        x, y = at + away * rng.uniform(2.1, 2.6)
        canvas.ellipse(x, y, a, b, turn, level * rng.uniform(0.8, 1.2))
    else:
        x, y = at + away * rng.uniform(1.0, 2.0)
        canvas.ellipse(x, y, rng.uniform(2, 5), level=level * rng.uniform(0.2, 0.5), blur=rng.uniform(2.5, 4.0))
    image = canvas.expose(rng)
    blobs = blobs_of(image)
    rows = [int(np.argmin(np.hypot(*(blobs.centres_px - place).T))) for place in (at, *SIBLINGS)]
    if blobs.table[rows[0], SHOULDER] == 0.0:
        return beside(rng, kind)
    refine_leaning(image, blobs.table, np.array([rows]), blobs.centres_px, blobs.covariances_px2)
    xx, xy, yy = blobs.covariances_px2[rows[0]]
    error = blobs.centres_px[rows[0]] - at
    nees = float(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))
    return error, nees, float(np.sqrt(0.5 * (xx + yy)))


@pytest.mark.parametrize("kind", ["mirror image", "touching LED", "halo"])
def test_an_led_beside_other_light_is_centred_as_well_as_told(rng: np.random.Generator, kind: str) -> None:
    found = [beside(rng, kind) for _ in range(40)]
    nees = np.array([nees for _, nees, _ in found])
    assert 0.4 < np.median(nees) < 2.5  # 1.39 where covariances are meant
    assert np.mean(nees) < 4.0
    assert np.median([np.abs(error).max() for error, _, _ in found]) < 0.02
    assert np.median([sigma for _, _, sigma in found]) < 0.02


def test_an_led_between_two_other_lights_is_centred_too(rng: np.random.Generator) -> None:
    away, nees = [], []
    for _ in range(20):
        x, y = 40 + rng.uniform(-0.5, 0.5, 2)
        canvas = Canvas.of(80, 200, 8.0).ellipse(x, y, 3.0, level=170)
        for place in SIBLINGS:
            canvas.ellipse(*place, 3.0, level=170)
        canvas.ellipse(x + 1.0, y + 4.5, 3.0, level=60).ellipse(x - 4.5, y - 1.5, 2.0, 0.8, 0.7, level=80)
        image = canvas.expose(rng)
        blobs = blobs_of(image)
        rows = [int(np.argmin(np.hypot(*(blobs.centres_px - place).T))) for place in ((x, y), *SIBLINGS)]
        refine_leaning(image, blobs.table, np.array([rows]), blobs.centres_px, blobs.covariances_px2)
        error, (xx, xy, yy) = blobs.centres_px[rows[0]] - [x, y], blobs.covariances_px2[rows[0]]
        away.append(np.abs(error).max())
        nees.append(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))
    assert np.median(away) < 0.02
    assert np.median(nees) < 4.0


def test_two_leds_in_one_spot_are_anywhere_in_it(rng: np.random.Generator) -> None:
    for _ in range(10):
        canvas = Canvas.of(80, 80, 8.0).ellipse(40.2, 40.1, 3.0, level=170).ellipse(45.0, 41.0, 3.0, level=165)
        image = canvas.expose(rng)
        blobs = blobs_of(image)
        if len(blobs.kept) > 1:
            continue
        refine_leaning(image, blobs.table, blobs.kept[:, None], blobs.centres_px, blobs.covariances_px2)
        assert blobs.covariances_px2[blobs.kept[0], 0] > 1.0
