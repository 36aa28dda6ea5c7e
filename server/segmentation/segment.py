"""One compiled call for the way from a frame to its spots.

Python takes a microsecond for every call and every small array: here only loops over tables are left to it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.segmentation.background import BLOCK_ROWS, background_of, seed_thresholds
from asterism.server.segmentation.components import COMPONENT_COLUMNS, connect, hot_width
from asterism.server.segmentation.spot_table import FATE, HEIGHT, SEMI_A, SEMI_B, SPOT_COLUMNS
from asterism.server.segmentation.spots import Background, Limits, measure_spots

SEED_SIGMAS = 5.0  # a pixel this far above its background may belong to a spot
SEED_LEAST = 6.0  # grey levels; below that quantisation rules
MOST_RUNS = 60_000
MOST_SPOTS = 4_000


class Scratch(NamedTuple):
    """Work arrays for frames of one size, reused so that no frame pays for fresh memory: seed ``thresholds``
    (blocks, w) of blocks of rows; ``hot``, ``runs``, ``parent`` and ``components`` as `connect` takes them; ``spots``
    (MOST_SPOTS, SPOT_COLUMNS), which are found.
    """

    thresholds: NDArray[np.uint8]
    hot: NDArray[np.uint8]
    runs: NDArray[np.int32]
    parent: NDArray[np.int32]
    components: NDArray[np.int32]
    spots: Floats

    @staticmethod
    def of(height: int, width: int) -> "Scratch":
        """For frames of that size, px."""
        blocks = (height + BLOCK_ROWS - 1) // BLOCK_ROWS
        return Scratch(
            np.empty((blocks, width), np.uint8),
            np.zeros(hot_width(width), np.uint8),
            np.empty((MOST_RUNS, 3), np.int32),
            np.empty(MOST_RUNS, np.int32),
            np.empty((MOST_SPOTS, COMPONENT_COLUMNS), np.int32),
            np.empty((MOST_SPOTS, SPOT_COLUMNS)),
        )


@compiled
def segment(image, largest_radius_px, masks, scratch):
    """Fill the spots of ``scratch`` with the bright spots of an (h, w) uint8 image; return how many.

    ``masks`` (m, 4) are x0, y0, x1, y1 px inclusive. A frame so full of bright texture that its components overflow the
    tables is segmented again with higher seed thresholds.
    """
    height, width = image.shape
    level, noise = background_of(image)
    thresholds, components = scratch.thresholds, scratch.components
    sigmas, least = SEED_SIGMAS, SEED_LEAST
    while True:
        seed_thresholds(level, noise, sigmas, least, height, width, thresholds)
        count = connect(image, thresholds, scratch.hot, scratch.runs, scratch.parent, components)
        if count >= 0:
            break
        sigmas, least = 1.5 * sigmas, 1.5 * least
    limits = Limits(sigmas, least, largest_radius_px, masks)
    return measure_spots(image, thresholds, components[:count], Background(level, noise), limits, scratch.spots)


@compiled
def describe(spots, heights, radii, fates, robots, leds):
    """Fill the columns (n,) of Blobs from the spot table (n, SPOT_COLUMNS); nobody owns a spot yet."""
    for k in range(spots.shape[0]):
        heights[k] = spots[k, HEIGHT]
        radii[k] = math.sqrt(spots[k, SEMI_A] * spots[k, SEMI_B])
        fates[k] = int(spots[k, FATE])
        robots[k] = leds[k] = -1
