"""Light beside single LEDs of a robot (rough floors, edges of lamps, mirror images): covariances that are meant."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from asterism.protocol.geometry import Floats
from asterism.server.centres.common_light import find_common_light
from asterism.server.centres.leaning_spots import refine_leaning
from tests.centres.rendering import Canvas
from tests.segmentation.test_segmentation import blobs_of

CELL, LEDS, ROBOTS = 56, 6, 4
FRAMES = 8  # of a kind: 24 spots each
Other = Callable[[np.random.Generator, Floats, float, float], Floats]  # centre, radius px, level -> light (CELL, CELL)


def _across(rng: np.random.Generator, at: Floats) -> Floats:
    """Distance (CELL, CELL) px along any direction from a place."""
    angle = rng.uniform(0, 2 * np.pi)
    y, x = np.mgrid[:CELL, :CELL]
    out: Floats = (x - at[0]) * np.cos(angle) + (y - at[1]) * np.sin(angle)
    return out


def rough(rng: np.random.Generator, at: Floats, radius: float, level: float) -> Floats:
    """Texture of 1 to 8 grey levels RMS."""
    texture = gaussian_filter(rng.standard_normal((CELL, CELL)), rng.uniform(1.5, 5.0), mode="wrap")
    out: Floats = rng.uniform(1, 8) * (texture - texture.min()) / texture.std()
    return out


def edge(rng: np.random.Generator, at: Floats, radius: float, level: float) -> Floats:
    """The edge of a brighter surface, beside the spot or across it."""
    out: Floats = rng.uniform(2, 40) / (1.0 + np.exp(radius * rng.uniform(-0.5, 2.5) - _across(rng, at)))
    return out


def mirror(rng: np.random.Generator, at: Floats, radius: float, level: float) -> Floats:
    """The LED's image in a floor, beside it, blurred and dimmed."""
    away, angle = radius * rng.uniform(1.2, 3.0), rng.uniform(0, 2 * np.pi)
    x, y = at + away * np.array([np.cos(angle), np.sin(angle)])
    blur = float(np.hypot(0.8, 0.4 * radius * rng.uniform()))
    return Canvas.of(CELL, CELL, 0.0).ellipse(x, y, radius, level=level * rng.uniform(0.05, 0.4), blur=blur).light


def drawn(rng: np.random.Generator, other: Other | None) -> tuple[NDArray[np.uint8], Floats]:
    """A picture of four robots' LEDs, on half of which other light leans, and their centres (24, 2) px."""
    light, centres = np.full((CELL * ROBOTS, CELL * LEDS), 8.0), np.empty((ROBOTS * LEDS, 2))
    for k in range(ROBOTS * LEDS):
        row, column = divmod(k, LEDS)
        radius, level, at = (2.2, 3.0, 3.6, 4.2)[row], rng.uniform(90, 180), CELL / 2 + rng.uniform(-2, 2, 2)
        cell = Canvas.of(CELL, CELL, 0.0).ellipse(*at.tolist(), radius, 0.85 * radius, 0.4 * row, level).light
        if other is not None and rng.random() < 0.5:
            cell = cell + other(rng, at, radius, level)
        light[row * CELL : (row + 1) * CELL, column * CELL : (column + 1) * CELL] += cell
        centres[k] = at + CELL * np.array([column, row])
    return Canvas(light).expose(rng), centres


def centred(rng: np.random.Generator, other: Other | None) -> tuple[Floats, Floats]:
    """Of all spots that were found: squared error weighted by the covariance, over the 2 that are expected; how many
    times wider the variance became as their robots were known.
    """
    nees, wider = [], []
    for _ in range(FRAMES):
        image, centres = drawn(rng, other)
        blobs = blobs_of(image, 20.0)
        rows = [[i for i in blobs.kept if np.hypot(*(blobs.centres_px[i] - centre)) < 3.0] for centre in centres]
        robots = np.array([found[0] if len(found) == 1 else -1 for found in rows]).reshape(ROBOTS, LEDS)
        before = blobs.covariances_px2.copy()
        refine_leaning(image, blobs.table, robots, blobs.centres_px, blobs.covariances_px2)
        widened, commons = np.zeros(len(blobs), np.bool_), np.empty((ROBOTS, 3))
        find_common_light(image, blobs.table, robots, blobs.centres_px, blobs.covariances_px2, widened, commons)
        for row, centre in zip(robots.ravel(), centres, strict=True):
            if row >= 0:
                xx, xy, yy = blobs.covariances_px2[row]
                error = blobs.centres_px[row] - centre
                nees.append(error @ np.linalg.solve([[xx, xy], [xy, yy]], error) / 2.0)
                wider.append(xx / before[row, 0])
    return np.array(nees), np.array(wider)


@pytest.mark.parametrize("other", [rough, edge, mirror])
def test_covariances_of_leds_that_other_light_leans_on_are_meant(rng: np.random.Generator, other: Other) -> None:
    nees, _ = centred(rng, other)
    assert 0.4 < np.mean(nees) < 2.0


def test_covariances_of_leds_alone_stay_as_they_were(rng: np.random.Generator) -> None:
    nees, wider = centred(rng, None)
    assert 0.7 < np.mean(nees) < 1.3
    assert np.mean(wider) < 1.1
    assert np.median(wider) == 1.0
