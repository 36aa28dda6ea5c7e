"""Every bright spot of a frame, with its sub-pixel centre and its fate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.server.background import BLOCK_ROWS, background_of, seed_thresholds
from asterism.server.centre import ESTIMATOR_NUMBERS, refine_centres
from asterism.server.components import COMPONENT_COLUMNS, connect, hot_width, mark_hot_columns
from asterism.server.spots import FATE, HEIGHT, SEMI_A, SEMI_B, SPOT_COLUMNS, measure_spots

Ints = NDArray[np.int64]

SEED_SIGMAS = 5.0  # a pixel this far above its background may belong to a spot
SEED_LEAST = 6.0  # grey levels; below that quantisation rules
MOST_RUNS = 60_000
MOST_SPOTS = 4_000


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """n bright spots; row i of every array is the same spot.

    ``centres_px`` (n, 2); ``covariances_px2`` (n, 3) xx, xy, yy of the centres (0 for rejected spots); ``heights``
    (n,) grey levels above the local background; ``radii_px`` (n,); ``fates`` (n,) as in the frame report;
    ``robots`` and ``leds`` (n,) say whose LED it is, -1 for nobody's (robots in the rig's order); ``table`` is the spot
    table they come from.
    """

    centres_px: Floats
    covariances_px2: Floats
    heights: Floats
    radii_px: Floats
    fates: Ints
    robots: Ints
    leds: Ints
    table: Floats

    def __len__(self) -> int:
        return len(self.fates)

    @property
    def kept(self) -> Ints:
        """Rows of the spots that were not rejected."""
        return np.flatnonzero((self.fates == Fate.UNEXPLAINED) | (self.fates == Fate.LED))


class Scratch:
    """Work arrays for frames of one size, reused so that no frame pays for fresh memory."""

    def __init__(self, height: int, width: int) -> None:
        blocks = (height + BLOCK_ROWS - 1) // BLOCK_ROWS
        self.thresholds = np.empty((blocks, width), np.uint8)
        self.hot = np.zeros((blocks, hot_width(width)), np.uint8)
        self.runs = np.empty((MOST_RUNS, 3), np.int32)
        self.parent = np.empty(MOST_RUNS, np.int32)
        self.components = np.empty((MOST_SPOTS, COMPONENT_COLUMNS), np.int32)
        self.spots = np.empty((MOST_SPOTS, SPOT_COLUMNS))


def find_blobs(
    image: NDArray[np.uint8],
    largest_radius_px: float,
    masks: Ints,
    estimator: str,
    scratch: Scratch,
) -> Blobs:
    """Segment an (h, w) uint8 image and centre what looks like an LED.

    ``masks`` (m, 4) are x0, y0, x1, y1 px inclusive; ``estimator`` is one of protocol.rig.ESTIMATORS. A frame so full
    of bright texture that its components overflow the tables is segmented again with higher seed thresholds.
    """
    height, width = image.shape
    level, noise = background_of(image)
    sigmas, least = SEED_SIGMAS, SEED_LEAST
    while True:
        seed_thresholds(level, noise, sigmas, least, height, width, scratch.thresholds)
        mark_hot_columns(image, scratch.thresholds, scratch.hot)
        count = connect(image, scratch.thresholds, scratch.hot, scratch.runs, scratch.parent, scratch.components)
        if count >= 0:
            break
        sigmas, least = 1.5 * sigmas, 1.5 * least
    n = measure_spots(
        image,
        scratch.thresholds,
        scratch.components,
        count,
        level,
        noise,
        sigmas,
        least,
        largest_radius_px,
        masks,
        scratch.spots,
    )
    spots = scratch.spots[:n].copy()
    centres, covariances = np.empty((n, 2)), np.empty((n, 3))
    refine_centres(image, spots, ESTIMATOR_NUMBERS[estimator], centres, covariances)
    return Blobs(
        centres,
        covariances,
        spots[:, HEIGHT].copy(),
        np.sqrt(spots[:, SEMI_A] * spots[:, SEMI_B]),
        spots[:, FATE].astype(np.int64),
        np.full(n, -1),
        np.full(n, -1),
        spots,
    )
