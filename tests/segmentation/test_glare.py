"""LEDs inside, beside and at the edge of broad light; nothing bright without a fate; bounded work."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from asterism.protocol.geometry import Floats
from asterism.server.segmentation.background import background_of
from asterism.server.segmentation.crowds import MOST_COMPONENTS, MOST_RUNS
from asterism.server.segmentation.opening import open_box, opening_room
from asterism.server.segmentation.pixels import Box, whole_of
from asterism.server.segmentation.segment import SEED_LEAST, SEED_SIGMAS, Scratch, segment
from asterism.server.segmentation.spot_table import (
    FATE,
    MASKED,
    MISFIT,
    NOISE,
    TOO_LARGE,
    UNEXPLAINED,
    WX0,
    WX1,
    WY0,
    WY1,
    X,
    Y,
)
from asterism.server.segmentation.thresholds import BLOCK_ROWS, Thresholds, begin_thresholds, tell_box
from tests.centres.rendering import Canvas

HEIGHT, WIDTH = 384, 512
NO_MASKS = np.empty((0, 4), np.int64)
Image = NDArray[np.uint8]


def spots_of(image: Image, largest: float = 12.0, masks: NDArray[np.int64] = NO_MASKS) -> Floats:
    """The spot table of an image."""
    scratch = Scratch.of(*image.shape)
    return scratch.spots[: segment(image, largest, masks, scratch)].copy()


def turned(draws: np.random.Generator) -> tuple[Floats, Floats]:
    """Coordinates of all pixels from a drawn place, turned by a drawn angle."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    x, y = x - draws.uniform(180, WIDTH - 180), y - draws.uniform(150, HEIGHT - 150)
    angle = draws.uniform(0, np.pi)
    return np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x


def glare(kind: str, top: float, draws: np.random.Generator) -> Floats:
    """Expected grey levels of a lamp's reflection, 100 to 300 px broad."""
    u, v = turned(draws)
    broad_u, broad_v = draws.uniform(50, 150, 2)
    if kind == "soft":
        share = np.exp(-1.6 * ((u / broad_u) ** 2 + (v / broad_v) ** 2))
    elif kind == "cone":
        share = np.clip(1 - np.hypot(u / broad_u, v / broad_v), 0, 1)
    else:
        edge = draws.uniform(2, 8)
        inside = np.minimum(broad_u - np.abs(u), broad_v - np.abs(v))
        share = 1 / (1 + np.exp(np.clip(-inside / edge, -50, 50)))
    light = 10 + top * share
    if kind == "core":
        light += 400 / (1 + np.exp(np.clip((np.hypot(u - 0.3 * broad_u, v) - 20) / 2, -50, 50)))
    if kind == "brushed":
        light *= 1 + 0.05 * 5 * ndimage.gaussian_filter(draws.standard_normal(light.shape), (1, 12))
    return np.asarray(light)


def add_leds(canvas: Canvas, draws: np.random.Generator, where: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Eight LEDs apart from one another ``where`` light changes by less than 5 grey a px; their places."""
    steep = np.hypot(*np.gradient(ndimage.gaussian_filter(canvas.light, 1.0)))
    fits = where & (ndimage.maximum_filter(steep, 15) < 5) & (ndimage.maximum_filter(canvas.light, 15) < 200)
    fits[:20], fits[-20:], fits[:, :20], fits[:, -20:] = False, False, False, False
    places: list[tuple[float, float]] = []
    for y, x in draws.permutation(np.argwhere(fits))[:400]:
        if len(places) < 8 and all(np.hypot(x - u, y - v) > 28 for u, v in places):
            places.append((x + draws.uniform(-0.5, 0.5), y + draws.uniform(-0.5, 0.5)))
    for x, y in places:
        canvas.ellipse(x, y, draws.choice([1.5, 2.5, 4.0, 6.0]), level=draws.choice([50.0, 80.0, 150.0]))
    return places


def missed(spots: Floats, places: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The places with no kept spot within a pixel."""
    kept = spots[spots[:, FATE] == UNEXPLAINED]
    return [(x, y) for x, y in places if not (np.hypot(kept[:, X] - x, kept[:, Y] - y) < 1.0).any()]


@pytest.mark.parametrize("kind", ["soft", "cone", "sharp", "core", "brushed"])
@pytest.mark.parametrize("top", [50.0, 110.0, 180.0])
def test_leds_in_glare_are_found(kind: str, top: float) -> None:
    for seed in range(3):
        draws = np.random.default_rng([seed, int(top)])
        canvas = Canvas(glare(kind, min(top, 110.0) if kind == "brushed" else top, draws))
        places = add_leds(canvas, draws, canvas.light > 10 + 0.1 * top)
        assert missed(spots_of(canvas.expose(draws)), places) == [], seed


@pytest.mark.parametrize("top", [60.0, 200.0])
def test_leds_in_the_dark_beside_broad_light_are_found(top: float) -> None:
    for seed in range(3):
        draws = np.random.default_rng(seed)
        canvas = Canvas(glare("sharp", top, draws))
        dark = canvas.light < 12
        near = ndimage.binary_dilation(~dark, iterations=50)
        places = add_leds(canvas, draws, dark & near)
        assert missed(spots_of(canvas.expose(draws)), places) == [], seed


def test_leds_on_a_dark_plate_on_a_bright_floor_are_found() -> None:
    for seed in range(3):
        draws = np.random.default_rng(seed)
        u, v = turned(draws)
        outside = np.maximum(np.abs(u), np.abs(v)) - draws.uniform(30, 60)
        canvas = Canvas(10 + 160 / (1 + np.exp(np.clip(-outside / 2, -50, 50))))
        places = add_leds(canvas, draws, canvas.light < 12)
        assert places
        assert missed(spots_of(canvas.expose(draws)), places) == [], seed


def seeds_without_fate(image: Image, spots: Floats) -> int:
    """Pixels above their seed threshold that lie in no spot's window."""
    height, width = image.shape
    level, noise = background_of(image)
    thresholds = Thresholds.of(height, width)
    begin_thresholds(level, noise, SEED_SIGMAS, SEED_LEAST, height, thresholds)
    tell_box(thresholds, height, whole_of(image))
    above = image > np.repeat(thresholds.rows, BLOCK_ROWS, axis=0)[:height]
    for x0, x1, y0, y1 in spots[:, [WX0, WX1, WY0, WY1]].astype(int):
        above[y0:y1, x0:x1] = False
    return int(above.sum())


def test_every_pixel_above_its_threshold_has_a_fate(rng: np.random.Generator) -> None:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    spikes = 10 + 245.0 * ((x % 3 == 0) & (y % 3 == 0))
    images = [
        Canvas(glare("soft", 240, rng)).expose(rng),
        Canvas(glare("core", 120, rng) * (1 + 0.3 * rng.standard_normal((HEIGHT, WIDTH)))).expose(rng),
        Canvas(spikes).expose(rng),
        Canvas(10 + 120.0 * rng.random((HEIGHT, WIDTH)) ** 8 * (x > 200)).expose(rng),
        rng.integers(0, 256, (HEIGHT, WIDTH)).astype(np.uint8),
    ]
    for number, image in enumerate(images):
        assert seeds_without_fate(image, spots_of(image)) == 0, number


def test_glitter_costs_no_dim_led_elsewhere(rng: np.random.Generator) -> None:
    canvas = Canvas.of(HEIGHT, WIDTH)
    places = [(300.3, 60.2), (380.7, 200.4), (450.1, 330.0)]
    for place in places:
        canvas.ellipse(*place, 2.5, level=30)
    # One pixel in nine, in half of the image: ten times more components than there is room for.
    canvas.light[::3, :250:3] += rng.uniform(40, 200, canvas.light[::3, :250:3].shape)
    spots = spots_of(canvas.expose(rng, gain=0.0))
    assert missed(spots, places) == []
    assert (spots[:, FATE] == TOO_LARGE).sum() > 10  # the cells that are too full


def test_work_is_bounded(rng: np.random.Generator) -> None:
    cells = (HEIGHT // 64) * (WIDTH // 64)
    scratch = Scratch.of(HEIGHT, WIDTH)
    assert len(scratch.runs) == MOST_RUNS * cells
    assert len(scratch.components) == MOST_COMPONENTS * cells
    for share in (0.02, 0.1, 0.5):
        image = np.where(rng.random((HEIGHT, WIDTH)) < share, rng.integers(60, 256, (HEIGHT, WIDTH)), 10)
        assert segment(image.astype(np.uint8), 12.0, NO_MASKS, scratch) < len(scratch.spots)


def test_one_frame_leaves_nothing_for_the_next(rng: np.random.Generator) -> None:
    scratch = Scratch.of(HEIGHT, WIDTH)
    for kind in ("core", "soft", "core"):
        image = Canvas(glare(kind, 120, rng)).ellipse(250, 100, 2.5).ellipse(254, 101, 2.5).expose(rng)
        found = scratch.spots[: segment(image, 12.0, NO_MASKS, scratch)]
        assert (found[:, FATE] == TOO_LARGE).any()
        assert np.array_equal(found[:, :MISFIT], spots_of(image)[:, :MISFIT])
        assert not scratch.painted.any()
        assert not scratch.residue.any()


def test_masks_hold_inside_glare(rng: np.random.Generator) -> None:
    canvas = Canvas(10 + 100 * np.exp(-((np.mgrid[0:HEIGHT, 0:WIDTH][1] - 256.0) ** 2) / 2 / 80**2))
    canvas.ellipse(250, 100, 2.5).ellipse(250, 200, 2.5)
    spots = spots_of(canvas.expose(rng), masks=np.array([[240, 190, 260, 210]]))
    fates = {int(y): fate for y, fate in zip(np.rint(spots[:, Y] / 100), spots[:, FATE], strict=True) if fate != 3}
    assert missed(spots, [(250, 100)]) == []
    assert fates[2] == MASKED


def test_the_noise_of_a_spot_in_glare_is_that_around_it(rng: np.random.Generator) -> None:
    canvas = Canvas.of(HEIGHT, WIDTH)
    canvas.light[60:320, 100:420] += 150
    places = [(150.0 + 50 * i, 120.0 + 50 * j) for i in range(5) for j in range(4)]
    for place in places:
        canvas.ellipse(*place, 2.5, level=80)
    spots = spots_of(canvas.expose(rng, read=1.2, gain=0.03))
    kept = spots[spots[:, FATE] == UNEXPLAINED]
    assert missed(spots, places) == []
    true = np.sqrt(1.2**2 + 0.03 * 150)
    assert np.median(kept[:, NOISE]) == pytest.approx(true, rel=0.15)


def test_opening_equals_scipys(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (90, 140)).astype(np.uint8)
    for ends, half in [((0, 140, 0, 90), 5), ((13, 77, 20, 85), 12), ((50, 130, 0, 40), 24)]:
        box = Box(*(np.int64(end) for end in ends))
        smooth, opened = open_box(image, box, half, opening_room(90, 140))
        kernel = np.outer([1, 2, 1], [1, 2, 1])
        expected = (ndimage.correlate(image.astype(int), kernel, mode="nearest") + 8) >> 4
        expected = expected[box.y0 : box.y1, box.x0 : box.x1]
        size = (2 * half + 1, 2 * half + 1)
        eroded = ndimage.grey_erosion(expected, size=size, mode="constant", cval=255)
        assert np.array_equal(smooth[:, : expected.shape[1]], expected)
        widened = ndimage.grey_dilation(eroded, size=size, mode="constant", cval=0)
        assert np.array_equal(opened[:, : expected.shape[1]], widened)
