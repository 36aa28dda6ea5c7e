"""Weighted means of spots' light: the definition, laws, discs at the bound, LEDs with cups better than an edge says."""

import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.centres.weighted import WIDER, weigh_spots
from asterism.server.segmentation.spot_table import LEVEL, SLOPE_X, SLOPE_Y, WX0, WX1, WY0, WY1
from tests.centres.bounds import centre_bound
from tests.centres.rendering import Canvas
from tests.segmentation.test_segmentation import blobs_of

SIZE = 80


def weighed(image: NDArray[np.uint8]) -> Floats:
    """The centre of the brightest spot."""
    blobs = blobs_of(image)
    row = int(np.argmax(np.where(np.isin(np.arange(len(blobs)), blobs.kept), blobs.heights, 0.0)))
    assert weigh_spots(image, blobs.table, np.array([[row, -1]]), blobs.centres_px) == 1
    return blobs.centres_px[row].copy()


def test_it_is_where_the_weighted_light_balances(rng: np.random.Generator) -> None:
    image = Canvas.of(SIZE, SIZE).ellipse(40.3, 38.8, 2.5).ellipse(42.0, 39.6, 1.2, level=90.0).expose(rng)
    x, y = weighed(image)
    spot = blobs_of(image).table[0]
    v, u = np.mgrid[int(spot[WY0]) : int(spot[WY1]), int(spot[WX0]) : int(spot[WX1])]
    plane = (
        spot[LEVEL]
        + spot[SLOPE_X] * (u - 0.5 * (spot[WX0] + spot[WX1] - 1))
        + spot[SLOPE_Y] * (v - 0.5 * (spot[WY0] + spot[WY1] - 1))
    )
    light, away2 = image[v, u] - plane, (u - x) ** 2 + (v - y) ** 2
    # The one width that is WIDER times what it makes of the spot.
    widths = np.linspace(1.0, 4.0, 3001)
    seen = [(w * away2).sum() / (2.0 * w.sum()) for w in (light * np.exp(-0.5 * away2 / s**2) for s in widths)]
    told = np.sqrt(WIDER / (1.0 / np.array(seen) - 1.0 / widths**2))
    width = widths[np.argmin(np.abs(told - widths))]
    weight = light * np.exp(-0.5 * away2 / width**2)
    assert abs((weight * (u - x)).sum() / weight.sum()) < 2e-3
    assert abs((weight * (v - y)).sum() / weight.sum()) < 2e-3


def test_moving_and_turning_the_image_moves_and_turns_it(rng: np.random.Generator) -> None:
    image = Canvas.of(81, 81).ellipse(43.2, 37.6, 3.0, 2.2, 0.4).expose(rng)
    x, y = weighed(image)
    np.testing.assert_allclose(weighed(np.roll(image, (3, 4), axis=(0, 1))), [x + 4, y + 3], atol=2e-3)
    np.testing.assert_allclose(weighed(image.T.copy()), [y, x], atol=2e-3)
    np.testing.assert_allclose(weighed(image[:, ::-1].copy()), [80 - x, y], atol=2e-3)


@pytest.mark.parametrize(("radius", "level"), [(1.5, 40.0), (1.5, 170.0), (2.5, 40.0), (2.5, 170.0), (4.0, 170.0)])
def test_of_discs_it_is_nearly_the_best(rng: np.random.Generator, radius: float, level: float) -> None:
    errors = []
    for x, y in rng.uniform(39.5, 40.5, (60, 2)):
        errors.append(weighed(Canvas.of(SIZE, SIZE).ellipse(x, y, radius, level=level).expose(rng)) - [x, y])
    bound = np.sqrt(np.trace(centre_bound(radius, radius, 0.0, level)) / 2)
    assert np.sqrt(np.mean(np.square(errors))) < (1.4 if radius < 3.0 else 1.5) * bound


def test_an_overexposed_spot_is_where_its_light_is(rng: np.random.Generator) -> None:
    errors = []
    for x, y in rng.uniform(39.5, 40.5, (30, 2)):
        errors.append(weighed(Canvas.of(SIZE, SIZE).ellipse(x, y, 3.0, level=500.0).expose(rng)) - [x, y])
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


def test_a_neighbour_does_not_pull(rng: np.random.Generator) -> None:
    canvas = Canvas.of(SIZE, SIZE).ellipse(40.3, 38.8, 2.5)
    alone = weighed(canvas.expose())
    beside = weighed(canvas.ellipse(52.3, 38.8, 2.5, level=120.0).expose())
    np.testing.assert_allclose(beside, alone, atol=0.01)
