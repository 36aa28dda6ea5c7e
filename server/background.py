"""The image's background, coarse: its level and noise in tiles, and from them the seed threshold of every pixel.

A tile's level is the median of a sparse sample of its pixels, so LEDs and lamps smaller than half a tile do not
move it; its noise comes from differences of neighbouring pixels, so a brightness gradient does not count as noise.
Between tile centres both are interpolated linearly. Tiles that a lamp or a patch of sun fills are replaced by the
median of their neighbours where those are darker.
"""

import math

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled

TILE_PX = 128
BLOCK_ROWS = 8  # rows that share one row of seed thresholds
_SAMPLED_ROWS = 8  # of a tile
_STEP_PX = 4  # between samples of a row
LARGEST_STEP = 48  # grey levels between neighbours: beyond it certainly an edge
EDGE = 4.0  # times the mean step, from where on it is an edge (five sigma)


@compiled
def measure_background(image, level, noise):
    """Fill ``level`` and ``noise`` (tiles_y, tiles_x), grey levels, from an (h, w) uint8 image."""
    height, width = image.shape
    tiles_y, tiles_x = level.shape
    counts, steps = np.empty(256, np.int32), np.empty(LARGEST_STEP + 1, np.int32)
    for ty in range(tiles_y):
        y0, y1 = ty * height // tiles_y, (ty + 1) * height // tiles_y
        for tx in range(tiles_x):
            x0, x1 = tx * width // tiles_x, (tx + 1) * width // tiles_x
            counts[:] = 0
            steps[:] = 0
            samples = 0
            for i in range(_SAMPLED_ROWS):
                row = image[y0 + (2 * i + 1) * (y1 - y0) // (2 * _SAMPLED_ROWS)]
                # Every other row is shifted, so that no stripe pattern of the sensor falls onto the samples.
                for x in range(x0 + (i & 1) * (_STEP_PX // 2), x1 - 1, _STEP_PX):
                    value = np.int64(row[x])
                    step = abs(np.int64(row[x + 1]) - value)
                    counts[value] += 1
                    samples += 1
                    steps[min(step, LARGEST_STEP)] += 1
            # The median: half way between the two middle samples.
            below, lower, upper = 0, -1, -1
            for value in range(256):
                below += counts[value]
                if lower < 0 and 2 * below >= samples:
                    lower = value
                if 2 * below > samples:
                    upper = value
                    break
            level[ty, tx] = 0.5 * (lower + upper)
            # Steps far beyond the usual are edges, not noise. E|difference| = 2 sigma / sqrt(pi); at most a grey level
            # of rounding hides what is below.
            usual = _mean_up_to(steps, LARGEST_STEP - 1)
            usual = _mean_up_to(steps, int(EDGE * usual) + 1)
            noise[ty, tx] = max(0.5 * math.sqrt(math.pi) * usual, 0.3)


@compiled
def _mean_up_to(counts, most):
    """The mean of counted values 0, 1, ... up to ``most``."""
    number, total = 0, 0
    for value in range(min(most + 1, counts.shape[0])):
        number += counts[value]
        total += value * counts[value]
    return total / max(number, 1)


@compiled
def _median(values, count):
    """The median of the first ``count`` values, which are sorted in place: few of them."""
    for i in range(1, count):
        value = values[i]
        k = i
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])


@compiled
def discount_lamps(level, noise):
    """The same maps with bright outliers among the tiles replaced by the median of their neighbours."""
    tiles_y, tiles_x = level.shape
    level_out = level.copy()
    noise_out = noise.copy()
    around = np.empty(9)
    for ty in range(tiles_y):
        for tx in range(tiles_x):
            y0, y1, x0, x1 = max(ty - 1, 0), min(ty + 2, tiles_y), max(tx - 1, 0), min(tx + 2, tiles_x)
            count = 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    around[count] = level[y, x]
                    count += 1
            middle = _median(around, count)
            for k in range(count):
                around[k] = abs(around[k] - middle)
            spread = _median(around, count)
            if level[ty, tx] > middle + max(4.0 * spread, 12.0):
                level_out[ty, tx] = middle
            count = 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    around[count] = noise[y, x]
                    count += 1
            quiet = _median(around, count)
            if noise[ty, tx] > 2.0 * quiet:
                noise_out[ty, tx] = quiet
    return level_out, noise_out


@compiled
def interpolate(tiles, y, x, height, width):
    """Bilinear value at pixel (x, y) of a map whose values stand at tile centres; constant beyond the outer ones."""
    tiles_y, tiles_x = tiles.shape
    v = min(max((y + 0.5) * tiles_y / height - 0.5, 0.0), tiles_y - 1.0)
    u = min(max((x + 0.5) * tiles_x / width - 0.5, 0.0), tiles_x - 1.0)
    i, j = int(v), int(u)
    i1, j1 = min(i + 1, tiles_y - 1), min(j + 1, tiles_x - 1)
    fv, fu = v - i, u - j
    upper = tiles[i, j] + fu * (tiles[i, j1] - tiles[i, j])
    lower = tiles[i1, j] + fu * (tiles[i1, j1] - tiles[i1, j])
    return upper + fv * (lower - upper)


@compiled
def seed_thresholds(level, noise, sigmas, least, height, width, thresholds):
    """Fill ``thresholds`` (blocks, w) uint8: a pixel above its block's threshold may belong to a spot.

    The threshold is the background plus ``sigmas`` times its noise, at least ``least`` grey levels.
    """
    tiles_y, tiles_x = level.shape
    # First along x, one line for each row of tiles; then every block is a blend of two lines.
    lines = np.empty((tiles_y, width), np.float32)
    per_px = tiles_x / width
    for ty in range(tiles_y):
        for x in range(width):
            u = min(max((x + 0.5) * per_px - 0.5, 0.0), tiles_x - 1.0)
            j = int(u)
            j1 = min(j + 1, tiles_x - 1)
            left = level[ty, j] + max(sigmas * noise[ty, j], least)
            right = level[ty, j1] + max(sigmas * noise[ty, j1], least)
            lines[ty, x] = min(left + (u - j) * (right - left), 255.0)
    for block in range(thresholds.shape[0]):
        y = block * BLOCK_ROWS + 0.5 * (BLOCK_ROWS - 1)
        v = min(max((y + 0.5) * tiles_y / height - 0.5, 0.0), tiles_y - 1.0)
        i = int(v)
        upper, lower = lines[i], lines[min(i + 1, tiles_y - 1)]
        part = np.float32(v - i)
        row = thresholds[block]
        for x in range(width):
            row[x] = np.uint8(np.int32(upper[x] + part * (lower[x] - upper[x])))


def tile_shape(height: int, width: int) -> tuple[int, int]:
    """How many tiles an (h, w) image has along y and x."""
    return max(1, round(height / TILE_PX)), max(1, round(width / TILE_PX))


def background_of(image: NDArray[np.uint8]) -> tuple[Floats, Floats]:
    """Level and noise maps (tiles_y, tiles_x), grey levels, of an (h, w) uint8 image."""
    level = np.empty(tile_shape(*image.shape))
    noise = np.empty_like(level)
    measure_background(image, level, noise)
    cleaned: tuple[Floats, Floats] = discount_lamps(level, noise)
    return cleaned
