"""The image's background, coarse: its level and noise in tiles, and from them the seed threshold of every pixel.

A tile's level is the median of a sparse lattice of its pixels, so LEDs and lamps smaller than half a tile do not
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
_LATTICE = 12  # samples a tile along each axis


@compiled
def measure_background(image, level, noise):
    """Fill ``level`` and ``noise`` (tiles_y, tiles_x), grey levels, from an (h, w) uint8 image."""
    height, width = image.shape
    tiles_y, tiles_x = level.shape
    samples = np.empty(_LATTICE * _LATTICE, np.uint8)
    for ty in range(tiles_y):
        for tx in range(tiles_x):
            y0, y1 = ty * height // tiles_y, (ty + 1) * height // tiles_y
            x0, x1 = tx * width // tiles_x, (tx + 1) * width // tiles_x
            count = 0
            differences = 0
            total = 0
            for i in range(_LATTICE):
                y = y0 + (2 * i + 1) * (y1 - y0) // (2 * _LATTICE)
                for j in range(_LATTICE):
                    # Every other row is shifted, so that no stripe pattern of the sensor falls onto the lattice.
                    x = x0 + (4 * j + 1 + 2 * (i & 1)) * (x1 - x0) // (4 * _LATTICE)
                    value = image[y, x]
                    samples[count] = value
                    count += 1
                    step = abs(np.int64(image[y, x + 1]) - np.int64(value)) if x + 1 < x1 else 0
                    if step < 48:  # an edge, not noise
                        total += step
                        differences += 1
            samples.sort()
            level[ty, tx] = 0.5 * (float(samples[count // 2 - 1]) + float(samples[count // 2]))
            # E|difference| = 2 sigma / sqrt(pi); at most a grey level of rounding hides what is below.
            noise[ty, tx] = max(0.5 * math.sqrt(math.pi) * total / max(differences, 1), 0.3)


@compiled
def discount_lamps(level, noise):
    """The same maps with bright outliers among the tiles replaced by the median of their neighbours."""
    tiles_y, tiles_x = level.shape
    level_out = level.copy()
    noise_out = noise.copy()
    around_level = np.empty(9)
    around_noise = np.empty(9)
    for ty in range(tiles_y):
        for tx in range(tiles_x):
            count = 0
            for y in range(max(ty - 1, 0), min(ty + 2, tiles_y)):
                for x in range(max(tx - 1, 0), min(tx + 2, tiles_x)):
                    around_level[count] = level[y, x]
                    around_noise[count] = noise[y, x]
                    count += 1
            middle = np.median(around_level[:count])
            spread = np.median(np.abs(around_level[:count] - middle))
            if level[ty, tx] > middle + max(4.0 * spread, 12.0):
                level_out[ty, tx] = middle
            quiet = np.median(around_noise[:count])
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
    knots = np.empty(tiles_x)
    for block in range(thresholds.shape[0]):
        y = block * BLOCK_ROWS + 0.5 * (BLOCK_ROWS - 1)
        v = min(max((y + 0.5) * tiles_y / height - 0.5, 0.0), tiles_y - 1.0)
        i = int(v)
        i1 = min(i + 1, tiles_y - 1)
        fv = v - i
        for tx in range(tiles_x):
            base = level[i, tx] + fv * (level[i1, tx] - level[i, tx])
            rough = noise[i, tx] + fv * (noise[i1, tx] - noise[i, tx])
            knots[tx] = min(base + max(sigmas * rough, least), 255.0)
        row = thresholds[block]
        scale = tiles_x / width
        start = 0
        for tx in range(-1, tiles_x):
            # Columns between the centres of tiles tx and tx + 1.
            end = width if tx == tiles_x - 1 else min(max(math.ceil((tx + 1.5) / scale - 0.5), 0), width)
            left = knots[max(tx, 0)]
            slope = knots[min(tx + 1, tiles_x - 1)] - left
            first = (start + 0.5) * scale - 0.5 - max(tx, 0)
            for x in range(start, end):
                row[x] = np.uint8(left + slope * (first + (x - start) * scale))
            start = end


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
