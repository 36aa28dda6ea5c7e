"""From image to spots: background, components, splitting, verdicts."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from asterism.protocol.messages import Fate
from asterism.server.centres.blobs import Blobs, find_blobs
from asterism.server.centres.leaning_spots import refine_leaning
from asterism.server.segmentation.background import background_of, interpolate
from asterism.server.segmentation.components import (
    AREA,
    COMPONENT_COLUMNS,
    PEAK,
    RUN_COLUMNS,
    START,
    X0,
    X1,
    Y0,
    Y1,
    connect,
)
from asterism.server.segmentation.pixels import whole_of
from asterism.server.segmentation.segment import Scratch
from asterism.server.segmentation.thresholds import BLOCK_ROWS, WORD, Thresholds, begin_thresholds, tell_box
from tests.centres.rendering import Canvas

NO_MASKS = np.empty((0, 4), np.int64)


def blobs_of(
    image: NDArray[np.uint8], largest: float = 12.0, masks: NDArray[np.int64] = NO_MASKS, estimator: str = "edge-model"
) -> Blobs:
    return find_blobs(image, largest, masks, estimator, Scratch.of(*image.shape))


def told_by(rows: NDArray[np.uint8], height: int) -> Thresholds:
    """Thresholds of which all are known."""
    told = Thresholds.of(height, rows.shape[1])
    told.rows[:], told.known[:] = rows, 1
    told.least[:] = np.minimum.reduceat(rows, np.arange(0, rows.shape[1], WORD), axis=1)
    return told


def fates_near(blobs: Blobs, x: float, y: float, within: float = 3.0) -> list[str]:
    """The fates of the spots near a place."""
    near = np.hypot(blobs.centres_px[:, 0] - x, blobs.centres_px[:, 1] - y) < within
    return [Fate.Name(int(fate)) for fate in blobs.fates[near]]


def test_background_follows_a_gradient_and_measures_noise(rng: np.random.Generator) -> None:
    y, x = np.mgrid[0:512, 0:640]
    plane = 20 + 0.05 * x + 0.03 * y
    image = np.clip(np.rint(plane + 2.0 * rng.standard_normal(plane.shape)), 0, 255).astype(np.uint8)
    level, noise = background_of(image)
    places = [(100, 100), (256, 320), (400, 560)]
    for py, px in places:
        assert interpolate(level, py, px, 512, 640) == pytest.approx(plane[py, px], abs=1.5)
        assert interpolate(noise, py, px, 512, 640) == pytest.approx(2.0, rel=0.25)


def test_a_lamp_that_fills_a_tile_does_not_raise_its_threshold(rng: np.random.Generator) -> None:
    canvas = Canvas.of(512, 640)
    canvas.ellipse(320, 256, 62)
    level, _ = background_of(canvas.expose(rng))
    assert level.max() < 15


def test_seed_thresholds_are_background_plus_sigmas_noise(rng: np.random.Generator) -> None:
    level, noise = rng.uniform(10, 60, (4, 5)), rng.uniform(0.5, 4, (4, 5))
    height, width = 500, 641
    told = Thresholds.of(height, width)
    begin_thresholds(level, noise, 5.0, 6.0, height, told)
    tell_box(told, height, whole_of(np.empty((height, width), np.uint8)))
    thresholds = told.rows
    least = np.repeat(told.least, WORD, axis=1)[:, :width]
    assert (thresholds >= least).all()
    assert (thresholds - least <= 32).all()
    for block, x in [(0, 0), (7, 100), (31, 320), (40, 640), (62, 5)]:
        y = block * BLOCK_ROWS + 0.5 * (BLOCK_ROWS - 1)
        # The noise is added at the tiles' centres first, then both are interpolated.
        knots = level + np.maximum(5.0 * noise, 6.0)
        rows = level + 0 * noise
        expected = interpolate(knots, y, x, height, width)
        assert rows.min() <= thresholds[block, x] <= expected + 8.0
        assert thresholds[block, x] == pytest.approx(expected, abs=4.0)


def test_components_equal_scipys_labelling(rng: np.random.Generator) -> None:
    for width in (7, 64, 101, 130, 192):
        image = (
            (ndimage.gaussian_filter(rng.standard_normal((97, width)), 1.2) * 300 + 40).clip(0, 255).astype(np.uint8)
        )
        blocks = -(-97 // BLOCK_ROWS)
        thresholds = rng.integers(80, 100, (blocks, width)).astype(np.uint8)
        runs = np.empty((5000, RUN_COLUMNS), np.int32)
        table = np.empty((1000, COMPONENT_COLUMNS), np.int32)
        told = told_by(thresholds, 97)
        count, n_runs = connect(image, told, whole_of(image), runs, np.empty(5000, np.int32), table)
        above = image > np.repeat(thresholds, BLOCK_ROWS, axis=0)[:97]
        labels, expected = ndimage.label(above, structure=np.ones((3, 3)))
        assert count == expected
        numbers = np.full(image.shape, -1)
        for y, first, end, number in runs[:n_runs]:
            numbers[y, first:end] = number
        assert np.array_equal(numbers >= 0, above)
        assert len(np.unique(np.stack([numbers[above], labels[above]]), axis=1).T) == expected
        assert np.array_equal(numbers[table[:count, Y0], table[:count, START]], np.arange(count))
        found = {tuple(row[[X0, X1, Y0, Y1, AREA, PEAK]].tolist()) for row in table[:count]}
        told = set()
        for number, (rows, columns) in enumerate(ndimage.find_objects(labels), start=1):
            inside = image[labels == number]
            told.add(
                (
                    columns.start,
                    columns.stop,
                    rows.start,
                    rows.stop,
                    inside.size,
                    int(inside.max()),
                )
            )
        assert found == told


def test_a_frame_full_of_texture_is_segmented_with_higher_thresholds(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (1024, 1280)).astype(np.uint8)
    assert len(blobs_of(image)) <= 4000


@pytest.mark.parametrize("level", [30.0, 100.0, 230.0])
def test_an_led_is_kept_at_any_brightness(rng: np.random.Generator, level: float) -> None:
    blobs = blobs_of(Canvas.of(200, 300).ellipse(150.3, 100.7, 2.5, level=level).expose(rng))
    assert fates_near(blobs, 150.3, 100.7) == ["UNEXPLAINED"]


def test_dim_leds_beside_bright_light_are_kept(rng: np.random.Generator) -> None:
    canvas = Canvas.of(256, 384, slope=(0.12, 0.0)).ellipse(60, 128, 20, level=220).ellipse(300, 128, 2.5, level=32)
    assert fates_near(blobs_of(canvas.expose(rng)), 300, 128) == ["UNEXPLAINED"]


def test_every_rejection_has_its_reason(rng: np.random.Generator) -> None:
    canvas = Canvas.of(400, 500).pixel(50, 50).ellipse(150, 100, 25).streak(300, 100, 26, 0.5).ellipse(1, 200, 2.5)
    canvas.ellipse(250, 300, 2.5).ellipse(400, 300, 2.5)
    blobs = blobs_of(canvas.expose(rng), masks=np.array([[380, 280, 420, 320]]))
    assert fates_near(blobs, 50, 50) == ["TOO_SMALL"]
    assert fates_near(blobs, 150, 100) == ["TOO_LARGE"]
    assert fates_near(blobs, 300, 100, 14) == ["ELONGATED"]
    assert fates_near(blobs, 1, 200, 5) == ["AT_EDGE"]
    assert fates_near(blobs, 250, 300) == ["UNEXPLAINED"]
    assert fates_near(blobs, 400, 300) == ["MASKED"]


def test_nothing_bright_vanishes_without_a_fate() -> None:
    for seed in range(6):
        draws = np.random.default_rng(seed)
        canvas = Canvas.of(300, 300)
        for _ in range(100):
            canvas.ellipse(*draws.uniform(140, 160, 2), 0.7, level=draws.uniform(40, 90))
        image = canvas.expose(draws)
        assert (image > 30).sum() > 150
        assert len(blobs_of(image, largest=16.0)) > 0, seed


@pytest.mark.parametrize("gap", [5.5, 7.0, 9.0])
def test_touching_leds_are_split(rng: np.random.Generator, gap: float) -> None:
    canvas = Canvas.of(100, 120).ellipse(50.2, 50.4, 2.5).ellipse(50.2 + gap, 50.4, 2.5, level=140)
    image = canvas.expose(rng)
    blobs = blobs_of(image)
    assert len(blobs.kept) == 2
    np.testing.assert_allclose(sorted(blobs.centres_px[blobs.kept, 0]), [50.2, 50.2 + gap], atol=0.5)
    refine_leaning(image, blobs.table, blobs.kept[:, None], blobs.centres_px, blobs.covariances_px2)
    np.testing.assert_allclose(sorted(blobs.centres_px[blobs.kept, 0]), [50.2, 50.2 + gap], atol=0.15)


def test_an_led_on_the_rim_of_a_lamp_is_found(rng: np.random.Generator) -> None:
    canvas = Canvas.of(200, 200).ellipse(80, 100, 16, level=120).ellipse(101, 100, 2.5, level=150)
    blobs = blobs_of(canvas.expose(rng))
    assert fates_near(blobs, 101, 100) == ["UNEXPLAINED"]
    assert fates_near(blobs, 80, 100, 6) == ["TOO_LARGE"]


def test_a_component_does_not_take_in_what_reaches_into_its_window(rng: np.random.Generator) -> None:
    # An L of light around an LED: their boxes overlap, they do not touch.
    canvas = Canvas.of(160, 160)
    for k in range(0, 60, 2):
        canvas.ellipse(40 + k, 110, 1.5, level=80).ellipse(40, 50 + k, 1.5, level=80)
    canvas.ellipse(70, 80, 2.5)
    blobs = blobs_of(canvas.expose(rng))
    assert fates_near(blobs, 70, 80).count("UNEXPLAINED") == 1


def test_noise_alone_is_no_spot(rng: np.random.Generator) -> None:
    for _ in range(3):
        blobs = blobs_of(Canvas.of(1024, 1280).expose(rng, read=2.5))
        assert len(blobs.kept) == 0
