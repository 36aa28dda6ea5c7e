"""One compiled call for the way from a frame to its spots.

Python takes a microsecond for every call and every small array: here only loops over tables are left to it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.segmentation.background import background_of
from asterism.server.segmentation.components import COMPONENT_COLUMNS, RUN_COLUMNS
from asterism.server.segmentation.crowds import MOST_COMPONENTS, MOST_RUNS, cells_for, connect_all
from asterism.server.segmentation.glare import LEAST_HALF, MOST_LEVELS, first_half, glares_of, let_fall, lift
from asterism.server.segmentation.opening import OpeningRoom, opening_room
from asterism.server.segmentation.pixels import whole_of
from asterism.server.segmentation.spot_table import FATE, HEIGHT, SEMI_A, SEMI_B, SPOT_COLUMNS
from asterism.server.segmentation.spots import Background, Limits, Seeds, measure_spots, tell_crowds
from asterism.server.segmentation.thresholds import Thresholds, begin_thresholds

SEED_SIGMAS = 5.0  # a pixel this far above its background may belong to a spot
SEED_LEAST = 6.0  # grey levels; below that quantisation rules
SPLIT_SPOTS = 1000  # rows of the spot table for spots split from others, beyond one for each component


class Scratch(NamedTuple):
    """Work arrays for frames of one size, reused so that no frame pays for fresh memory: seed ``thresholds`` and
    ``bars``, those of the residue; ``runs``, ``parent`` and ``components`` as
    `connect` takes them; ``crowded`` cells as in `crowds`; ``painted`` and ``residue`` (h, w), 0 between frames, and
    ``opening`` as in `glare`; ``spots`` (capacity, SPOT_COLUMNS), which are found.
    """

    thresholds: Thresholds
    bars: Thresholds
    runs: NDArray[np.int32]
    parent: NDArray[np.int32]
    components: NDArray[np.int32]
    crowded: NDArray[np.uint8]
    painted: NDArray[np.uint8]
    residue: NDArray[np.uint8]
    opening: OpeningRoom
    spots: Floats

    @staticmethod
    def of(height: int, width: int) -> "Scratch":
        """For frames of that size, px."""
        cells = cells_for(height, width)
        number = cells[0] * cells[1]
        components = MOST_COMPONENTS * number
        return Scratch(
            Thresholds.of(height, width),
            Thresholds.of(height, width),
            np.empty((MOST_RUNS * number, RUN_COLUMNS), np.int32),
            np.empty(MOST_RUNS * number, np.int32),
            np.empty((components, COMPONENT_COLUMNS), np.int32),
            np.zeros(cells, np.uint8),
            np.zeros((height, width), np.uint8),
            np.zeros((height, width), np.uint8),
            opening_room(height, width),
            np.empty(((1 + MOST_LEVELS) * (components + SPLIT_SPOTS) + number, SPOT_COLUMNS)),
        )


@compiled
def segment(image, largest_radius_px, masks, scratch):
    """Fill the spots of ``scratch`` with the bright spots of an (h, w) uint8 image; return how many.

    ``masks`` (m, 4) are x0, y0, x1, y1 px inclusive. Every pixel above its seed threshold lies in the window of a spot,
    whatever its fate: what is too large to be one is told as such, and looked into (`glare`); so are cells too full of
    texture (`crowds`).
    """
    level, noise = background_of(image)
    scratch.crowded[:] = 0
    begin_thresholds(level, noise, SEED_SIGMAS, SEED_LEAST, image.shape[0], scratch.thresholds)
    count, runs = connect_all(image, scratch.thresholds, whole_of(image), scratch)
    background, limits = Background(level, noise), Limits(SEED_SIGMAS, SEED_LEAST, largest_radius_px, masks)
    seeds = Seeds(image, scratch.thresholds, False)
    components = scratch.components[:count]
    found = measure_spots(image, seeds, components, background, limits, scratch.spots[: count + SPLIT_SPOTS])
    half = first_half(largest_radius_px)
    for _ in range(MOST_LEVELS):
        glares = glares_of(components)
        if half < LEAST_HALF or not glares.any():
            break
        reach = lift(image, components, glares, scratch.runs[:runs], half, scratch)
        scratch.bars.known[:] = 0
        scratch.bars.least[:] = 0
        count, runs = connect_all(scratch.residue, scratch.bars, reach, scratch)
        seeds, components = Seeds(scratch.residue, scratch.bars, True), scratch.components[:count]
        room = scratch.spots[found : found + count + SPLIT_SPOTS]
        found += measure_spots(image, seeds, components, background, limits, room)
        let_fall(reach, scratch)
        half //= 2
    return found + tell_crowds(image, scratch.crowded, background, scratch.spots[found:])


@compiled
def describe(spots, heights, radii, fates, robots, leds):
    """Fill the columns (n,) of Blobs from the spot table (n, SPOT_COLUMNS); nobody owns a spot yet."""
    for k in range(spots.shape[0]):
        heights[k] = spots[k, HEIGHT]
        radii[k] = math.sqrt(spots[k, SEMI_A] * spots[k, SEMI_B])
        fates[k] = int(spots[k, FATE])
        robots[k] = leds[k] = -1
