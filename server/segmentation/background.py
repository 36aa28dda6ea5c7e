"""The image's background, coarse: its level and noise in tiles.

A tile's level is the median of a sparse sample of its pixels, so LEDs and lamps smaller than half a tile do not
move it; its noise comes from differences of neighbouring pixels, so a brightness gradient does not count as noise.
Between tile centres both are interpolated linearly. Tiles that a lamp or a patch of sun fills are replaced by the
median of their neighbours where those are darker.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.pixels import Box, index

TILE_PX = 128
_SAMPLED_ROWS = 8  # of a tile
_STEP_PX = 4  # between samples of a row
LARGEST_STEP = 48  # grey levels between neighbours: beyond it certainly an edge
LEAST_LAMP = 12.0  # grey levels by which light in a tile, or a tile that a lamp fills, stands out
MOST_RAMP = 16.0  # grey levels by which a tile is brighter than one beside it because the background is a gradient
DARK_SAMPLES = 4  # neighbours in a row, 16 px, that make a dark part of a tile
BRIGHTEST = np.uint8(255)
EDGE = 4.0  # times the mean step, from where on it is an edge (five sigma)
ZERO16, ONE16 = np.int16(0), np.int16(1)  # counts and sums of steps of a tile's few hundred samples


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


@compiled
def _count_up_to(values, most):
    """How many of the values (n,) uint8 are no more than ``most``, uint8."""
    number = ZERO16
    for k in range(values.shape[0]):
        number = np.int16(number + (ONE16 if values[k] <= most else ZERO16))
    return np.int64(number)


@compiled
def _middle_values(values, guess):
    """The two middle ones of values (n,) uint8; the nearer the ``guess`` of the lower, the sooner it is found."""
    n = values.shape[0]
    below, lower, up_to_lower = -1, 255, n
    at, step = guess, 1
    # Outwards from the guess until the lower one lies between, then by halves.
    while lower - below > 1:
        count = _count_up_to(values, np.uint8(at))
        if 2 * count >= n:
            lower, up_to_lower = at, count
        else:
            below = at
        if below < 0:
            at, step = max(lower - step, 0), 4 * step
        elif lower == 255:
            at, step = min(below + step, 254), 4 * step
        else:
            at = (below + lower) // 2
    upper = lower
    if 2 * up_to_lower <= n:
        upper = 255
        for value in values:
            if lower < value < upper:
                upper = np.int64(value)
    return lower, upper


@compiled
def _darkest(values):
    """The level of the darkest stretch of DARK_SAMPLES neighbours among values (n,) uint8, told by its brightest."""
    darkest = BRIGHTEST
    for k in range(values.shape[0] - DARK_SAMPLES + 1):
        first, last = max(values[k], values[index(k + 1)]), max(values[index(k + 2)], values[index(k + 3)])
        darkest = min(darkest, max(first, last))
    return float(darkest)


@compiled
def _mean_up_to(steps, most):
    """The mean of those steps (n,) uint8 that are no more than ``most``, which is LARGEST_STEP at most."""
    most = np.uint8(most)
    number, total = ZERO16, ZERO16
    for k in range(steps.shape[0]):
        counts = steps[k] <= most
        number = np.int16(number + (ONE16 if counts else ZERO16))
        total = np.int16(total + (np.int16(steps[k]) if counts else ZERO16))
    return total / max(np.int64(number), 1)


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
    lower = 0
    for ty in range(tiles_y):
        for tx in range(tiles_x):
            box = Box(
                tx * width // tiles_x, (tx + 1) * width // tiles_x, ty * height // tiles_y, (ty + 1) * height // tiles_y
            )
            count = _sample(image, box, values, steps)
            # A tile's neighbour is the best guess.
            lower, upper = _middle_values(values[:count], lower)
            middle, darkest = 0.5 * (lower + upper), _darkest(values[:count])
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
def background_of(image):
    """Level and noise maps (tiles_y, tiles_x), grey levels, of an (h, w) uint8 image."""
    height, width = image.shape
    tiles = (max(1, round(height / TILE_PX)), max(1, round(width / TILE_PX)))
    level, noise = np.empty(tiles), np.empty(tiles)
    measure_background(image, level, noise)
    level, noise = discount_lamps(level, noise)
    return follow_dark(level), noise
