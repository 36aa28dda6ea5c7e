"""The image's background, coarse: its level and noise in tiles, and from them the seed threshold of every pixel.

A tile's level is the median of a sparse sample of its pixels, so LEDs and lamps smaller than half a tile do not
move it; its noise comes from differences of neighbouring pixels, so a brightness gradient does not count as noise.
Between tile centres both are interpolated linearly. Tiles that a lamp or a patch of sun fills are replaced by the
median of their neighbours where those are darker.
"""

import math

import numpy as np

from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.pixels import Box, index

TILE_PX = 128
BLOCK_ROWS = 8  # rows that share one row of seed thresholds
_SAMPLED_ROWS = 8  # of a tile
_STEP_PX = 4  # between samples of a row
_PART_BITS = 7  # of a grey level's parts, in which thresholds are stepped
LARGEST_STEP = 48  # grey levels between neighbours: beyond it certainly an edge
LEAST_LAMP = 12.0  # grey levels by which light in a tile, or a tile that a lamp fills, stands out
MOST_RAMP = 16.0  # grey levels by which a tile is brighter than one beside it because the background is a gradient
DARK_SAMPLES = 4  # neighbours in a row, 16 px, that make a dark part of a tile
EDGE = 4.0  # times the mean step, from where on it is an edge (five sigma)
ZERO32, ONE32 = np.int32(0), np.int32(1)


@compiled
def _sample(image, box, values, steps):
    """Fill ``values`` and ``steps``, to the next pixel, with the samples of a tile; return how many there are."""
    count = 0
    for i in range(_SAMPLED_ROWS):
        row = image[box.y0 + (2 * i + 1) * (box.y1 - box.y0) // (2 * _SAMPLED_ROWS)]
        # Every other row is shifted, so that no stripe pattern of the sensor falls onto the samples.
        start = box.x0 + (i & 1) * (_STEP_PX // 2)
        taken = max(-(-(box.x1 - 1 - start) // _STEP_PX), 0)
        for k in range(taken):
            value, after = row[index(start + _STEP_PX * k)], row[index(start + _STEP_PX * k + 1)]
            values[index(count + k)] = value
            steps[index(count + k)] = after - value if after > value else value - after
        count += taken
    return count


@compiled_sums
def _up_to(values, most):
    """How many of the values (n,) uint8 are no more than ``most``, and their sum."""
    number, total = ZERO32, ZERO32
    for k in range(values.shape[0]):
        value = np.int32(values[k])
        number += ONE32 if value <= most else ZERO32
        total += value if value <= most else ZERO32
    return number, total


@compiled
def _middle(values):
    """The median of values (n,) uint8: half way between the two middle ones."""
    below, lower = -1, 255
    while lower - below > 1:
        half = (below + lower) // 2
        number, _ = _up_to(values, np.int32(half))
        if 2 * number >= values.shape[0]:
            lower = half
        else:
            below = half
    number, _ = _up_to(values, np.int32(lower))
    upper = lower
    if 2 * number <= values.shape[0]:
        upper = 255
        for value in values:
            if lower < value < upper:
                upper = np.int64(value)
    return 0.5 * (lower + upper)


@compiled
def _darkest(values):
    """The level of the darkest stretch of DARK_SAMPLES neighbours among values (n,) uint8, told by its brightest."""
    darkest = 255
    for k in range(values.shape[0] - DARK_SAMPLES + 1):
        brightest = max(values[k], values[k + 1], values[k + 2], values[k + 3])
        darkest = min(darkest, brightest)
    return float(darkest)


@compiled
def _mean_up_to(values, most):
    number, total = _up_to(values, np.int32(min(most, 255)))
    return total / max(number, 1)


@compiled
def measure_background(image, level, noise):
    """Fill ``level`` and ``noise`` (tiles_y, tiles_x), grey levels, from an (h, w) uint8 image.

    A tile's level is its median, but where a part of it is darker by more than LEAST_LAMP it is that of the dark part:
    what is brighter is light, of which `glare` takes care, and an LED in the dark must not be lost for it.
    """
    height, width = image.shape
    tiles_y, tiles_x = level.shape
    most = _SAMPLED_ROWS * (width // (tiles_x * _STEP_PX) + 2)
    values, steps = np.empty(most, np.uint8), np.empty(most, np.uint8)
    for ty in range(tiles_y):
        for tx in range(tiles_x):
            box = Box(
                tx * width // tiles_x, (tx + 1) * width // tiles_x, ty * height // tiles_y, (ty + 1) * height // tiles_y
            )
            count = _sample(image, box, values, steps)
            middle, darkest = _middle(values[:count]), _darkest(values[:count])
            level[ty, tx] = darkest if darkest < middle - LEAST_LAMP else middle
            # Steps far beyond the usual are edges, not noise. E|difference| = 2 sigma / sqrt(pi); at most a grey level
            # of rounding hides what is below.
            usual = _mean_up_to(steps[:count], LARGEST_STEP - 1)
            usual = _mean_up_to(steps[:count], min(int(EDGE * usual) + 1, LARGEST_STEP))
            noise[ty, tx] = max(0.5 * math.sqrt(math.pi) * usual, 0.3)


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
            darkest, least = np.inf, np.inf
            for y in range(y0, y1):
                for x in range(x0, x1):
                    darkest, least = min(darkest, level[y, x]), min(least, noise[y, x])
            # Most tiles stand out from no neighbour: no need for medians.
            if level[ty, tx] > darkest + LEAST_LAMP:
                count = _around(level, x0, x1, y0, y1, around)
                middle = _median(around, count)
                for k in range(count):
                    around[k] = abs(around[k] - middle)
                spread = _median(around, count)
                if level[ty, tx] > middle + max(4.0 * spread, LEAST_LAMP):
                    level_out[ty, tx] = middle
            if noise[ty, tx] > 2.0 * least:
                quiet = _median(around, _around(noise, x0, x1, y0, y1, around))
                if noise[ty, tx] > 2.0 * quiet:
                    noise_out[ty, tx] = quiet
    return level_out, noise_out


@compiled
def follow_dark(level):
    """The same map where tiles that are brighter than one beside them by more than MOST_RAMP take its level.

    Between tile centres levels are interpolated: without that the dark beside broad light would be told too bright.
    """
    tiles_y, tiles_x = level.shape
    followed = level.copy()
    for ty in range(tiles_y):
        for tx in range(tiles_x):
            darkest = level[ty, tx]
            for y in range(max(ty - 1, 0), min(ty + 2, tiles_y)):
                for x in range(max(tx - 1, 0), min(tx + 2, tiles_x)):
                    darkest = min(darkest, level[y, x])
            if level[ty, tx] > darkest + MOST_RAMP:
                followed[ty, tx] = darkest
    return followed


@compiled
def _around(tiles, x0, x1, y0, y1, around):
    """Copy a box (exclusive ends) of tiles into ``around``; return how many there are."""
    count = 0
    for y in range(y0, y1):
        for x in range(x0, x1):
            around[count] = tiles[y, x]
            count += 1
    return count


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
def _line_of_seeds(level, noise, sigmas, least, line):
    """Fill ``line`` (w,) float32 with the seed thresholds at the height of a row of tiles' centres."""
    tiles, width = level.shape[0], line.shape[0]
    per_px = tiles / width
    # From one tile's centre to the next it is a ramp; beyond the outer ones it is level.
    for j in range(-1, tiles):
        x0 = max(math.ceil((j + 0.5) / per_px - 0.5), 0)
        x1 = min(math.ceil((j + 1.5) / per_px - 0.5), width)
        j0, j1 = max(j, 0), min(j + 1, tiles - 1)
        left = min(level[j0] + max(sigmas * noise[j0], least), 255.0)
        rise = min(level[j1] + max(sigmas * noise[j1], least), 255.0) - left
        start, slope = np.float32(left + rise * (0.5 * per_px - 0.5 - j)), np.float32(rise * per_px)
        for x in range(x0, x1):
            line[x] = start + slope * np.float32(x)


@compiled
def seed_thresholds(level, noise, sigmas, least, height, width, thresholds):
    """Fill ``thresholds`` (blocks, w) uint8: a pixel above its block's threshold may belong to a spot.

    The threshold is the background plus ``sigmas`` times its noise, at least ``least`` grey levels.
    """
    tiles_y = level.shape[0]
    lines = np.empty((tiles_y, width), np.float32)
    for ty in range(tiles_y):
        _line_of_seeds(level[ty], noise[ty], sigmas, least, lines[ty])
    # Every block is a blend of two lines: stepped from block to block in parts of a grey level, which is what the
    # compiler makes the fastest code of.
    now, change = np.empty(width, np.int16), np.empty(width, np.int16)
    per_block = BLOCK_ROWS * tiles_y / height
    before = -2
    for block in range(thresholds.shape[0]):
        v = (block + 0.5) * per_block - 0.5
        i = min(math.floor(v), tiles_y - 1)
        if i != before:
            before = i
            upper, lower = lines[max(i, 0)], lines[min(i + 1, tiles_y - 1)]
            part, parts = np.float32(v - i), np.float32(1 << _PART_BITS)
            for x in range(width):
                now[x] = np.int16(parts * (upper[x] + part * (lower[x] - upper[x])))
                change[x] = np.int16(parts * np.float32(per_block) * (lower[x] - upper[x]))
        row = thresholds[block]
        for x in range(width):
            row[x] = now[x] >> _PART_BITS
            now[x] += change[x]


@compiled
def background_of(image):
    """Level and noise maps (tiles_y, tiles_x), grey levels, of an (h, w) uint8 image."""
    height, width = image.shape
    tiles = (max(1, round(height / TILE_PX)), max(1, round(width / TILE_PX)))
    level, noise = np.empty(tiles), np.empty(tiles)
    measure_background(image, level, noise)
    level, noise = discount_lamps(level, noise)
    return follow_dark(level), noise
