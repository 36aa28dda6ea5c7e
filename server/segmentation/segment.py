"""One compiled call for the way from a frame to its spots, and one from the spots to the robots' answers.

Python takes a microsecond for every call and every small array: here only loops over tables are left to it.
"""

import math

from asterism.protocol.messages import Fate
from asterism.server.compiled import compiled
from asterism.server.segmentation.background import background_of, seed_thresholds
from asterism.server.segmentation.components import connect
from asterism.server.segmentation.spots import FATE, HEIGHT, SEMI_A, SEMI_B, measure_spots

SEED_SIGMAS = 5.0  # a pixel this far above its background may belong to a spot
SEED_LEAST = 6.0  # grey levels; below that quantisation rules
LED = int(Fate.LED)  # as a plain integer for the compiled code


@compiled
def segment(
    image, largest_radius_px, masks, thresholds, hot, runs, parent, components, spots,
):  # fmt: skip
    """Fill ``spots`` (capacity, SPOT_COLUMNS) with the bright spots of an (h, w) uint8 image; return how many.

    All others are scratch. A frame so full of bright texture that its components overflow the tables is segmented again
    with higher seed thresholds.
    """
    height, width = image.shape
    level, noise = background_of(image)
    sigmas, least = SEED_SIGMAS, SEED_LEAST
    while True:
        seed_thresholds(level, noise, sigmas, least, height, width, thresholds)
        count = connect(image, thresholds, hot, runs, parent, components)
        if count >= 0:
            break
        sigmas, least = 1.5 * sigmas, 1.5 * least
    return measure_spots(
        image, thresholds, components, count, level, noise, sigmas, least, largest_radius_px, masks, spots
    )


@compiled
def describe(spots, heights, radii, fates, robots, leds):
    """Fill the columns (n,) of Blobs from the spot table (n, SPOT_COLUMNS); nobody owns a spot yet."""
    for k in range(spots.shape[0]):
        heights[k] = spots[k, HEIGHT]
        radii[k] = math.sqrt(spots[k, SEMI_A] * spots[k, SEMI_B])
        fates[k] = int(spots[k, FATE])
        robots[k] = leds[k] = -1


@compiled
def tell_whose(robots, assignment, rows, chosen, residuals, fates, owners, leds, spots, left, rms):
    """Write into the blobs' columns whose LEDs they are, and collect what the robots' answers tell of them.

    ``robots`` (m,) indices into the rig; ``assignment`` (m, 6) places in ``rows``, which are rows of the blobs, -1 for
    LEDs not seen; ``chosen`` (m,) of the two minima, -1 for none; ``residuals`` (m, 2, 6, 2) px. Fills ``spots`` (m, 6)
    with rows of the blobs, ``left`` (m, 6, 2) with the chosen minimum's residuals and ``rms`` (m,) with their root mean
    square over the LEDs seen, px.
    """
    for k in range(robots.shape[0]):
        square, count = 0.0, 0
        for led in range(assignment.shape[1]):
            place = assignment[k, led]
            spots[k, led] = rows[place] if place >= 0 else -1
            left[k, led] = residuals[k, chosen[k], led]
            if place < 0:
                continue
            square += left[k, led, 0] ** 2 + left[k, led, 1] ** 2
            count += 1
            if chosen[k] >= 0:
                row = rows[place]
                fates[row], owners[row], leds[row] = LED, robots[k], led
        rms[k] = math.sqrt(square / max(count, 1))
