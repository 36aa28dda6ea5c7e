"""Frames of six spots under any lens (`lenses`), centred as the chain does it, beside their truth and their bound."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.centres.blobs import Blobs
from tests.centres.lenses import BACKGROUND, SIZE, Lens, Spot, expose
from tests.segmentation.test_segmentation import blobs_of

COLUMNS, ROWS = 3, 2  # spots of a frame
SCENES = 24  # phases and angles; each is seen as often as is asked for
BOUNDS = 3  # of them, that the bound is the mean of
ASPECT = 0.85
LARGEST_PX = 20.0
Disturb = Callable[[Floats, Spot, np.random.Generator], Floats]  # expected grey levels, spot -> grey levels


@dataclass(frozen=True, slots=True, eq=False)
class Centred:
    """n spots of one kind: errors (n, 2) px, their squares weighted by the covariance (n,), 2 expected, the variances'
    means (n,) px^2, and how many more were not found as one spot.
    """

    errors: Floats
    nees: Floats
    variances: Floats
    lost: int

    @property
    def rms(self) -> float:
        """Root mean square error of a coordinate, px."""
        return float(np.sqrt(np.mean(np.square(self.errors))))


@lru_cache(maxsize=64)
def scenes(lens: Lens, radius: float, level: float) -> list[Spot]:
    """Spots at random phases and angles: the same for every lens."""
    draws = np.random.default_rng(7).uniform((-0.5, -0.5, 0.0), (0.5, 0.5, np.pi), (SCENES, 3))
    return [Spot(lens, radius, ASPECT * radius, level, x=x, y=y, angle=angle) for x, y, angle in draws.tolist()]


@lru_cache(maxsize=64)
def _lights(lens: Lens, radius: float) -> Floats:
    """Light (scenes, SIZE, SIZE) of a spot of level 1."""
    return np.array([spot.light() - BACKGROUND for spot in scenes(lens, radius, 1.0)])


def bound(lens: Lens, radius: float, level: float) -> float:
    """The least error of a coordinate that any estimator can have, px."""
    covariances = [spot.bound() for spot in scenes(lens, radius, level)[:BOUNDS]]
    return float(np.sqrt(np.mean([np.trace(covariance) / 2 for covariance in covariances])))


def frames(
    lens: Lens, radius: float, level: float, count: int, disturb: Disturb | None = None
) -> Iterator[tuple[NDArray[np.uint8], Floats]]:
    """``count`` images of six spots, and the spots' true centres (6, 2) px."""
    rng = np.random.default_rng([11, round(level), round(10 * radius)])
    spots, lights = scenes(lens, radius, level), _lights(lens, radius)
    for frame in range(count):
        light, centres = np.zeros((SIZE * ROWS, SIZE * COLUMNS)), np.empty((COLUMNS * ROWS, 2))
        for k in range(COLUMNS * ROWS):
            number = (COLUMNS * ROWS * frame + k) % SCENES
            row, column = divmod(k, COLUMNS)
            patch = BACKGROUND + level * lights[number]
            if disturb is not None:
                patch = disturb(patch, spots[number], rng)
            light[row * SIZE : (row + 1) * SIZE, column * SIZE : (column + 1) * SIZE] = patch
            centres[k] = (column + 0.5) * SIZE + spots[number].x, (row + 0.5) * SIZE + spots[number].y
        yield expose(light, rng), centres


def near(blobs: Blobs, centre: Floats) -> int | None:
    """The row of the one kept spot near a place, if there is one."""
    rows = [int(row) for row in blobs.kept if np.hypot(*(blobs.centres_px[row] - centre)) < 2.0]
    return rows[0] if len(rows) == 1 else None


def centre_spots(lens: Lens, radius: float, level: float, count: int, disturb: Disturb | None = None) -> Centred:
    """Segment and centre ``count`` frames of six spots."""
    errors, nees, variances, lost = [], [], [], 0
    for image, centres in frames(lens, radius, level, count, disturb):
        blobs = blobs_of(image, LARGEST_PX)
        for centre in centres:
            row = near(blobs, centre)
            if row is None:
                lost += 1
                continue
            error = blobs.centres_px[row] - centre
            xx, xy, yy = blobs.covariances_px2[row]
            errors.append(error)
            nees.append(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))
            variances.append(0.5 * (xx + yy))
    return Centred(np.array(errors), np.array(nees), np.array(variances), lost)


def light_beside(height: float, away: float) -> Disturb:
    """Dim light, a Gaussian of 2 px, ``away`` px beside every spot, to any side."""

    def disturb(light: Floats, spot: Spot, rng: np.random.Generator) -> Floats:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        y, x = np.mgrid[:SIZE, :SIZE] - SIZE // 2
        u, v = x - spot.x - away * np.cos(angle), y - spot.y - away * np.sin(angle)
        return light + height * np.exp(-(u * u + v * v) / 8.0)

    return disturb


def step_beside(height: float, away: float) -> Disturb:
    """A background that is darker on one side, from ``away`` px beside every spot on: an arm's edge."""

    def disturb(light: Floats, spot: Spot, rng: np.random.Generator) -> Floats:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        y, x = np.mgrid[:SIZE, :SIZE] - SIZE // 2
        along = (x - spot.x) * np.cos(angle) + (y - spot.y) * np.sin(angle)
        return light + height / (1.0 + np.exp(2.0 * (along - away)))

    return disturb
