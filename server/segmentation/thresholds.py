"""Seed thresholds: how bright a pixel must be to belong to a spot; told where it is asked for.

At the tiles' centres the threshold is the background plus so many sigmas of its noise. Between them it is interpolated,
for BLOCK_ROWS rows at a time. Nearly all of a frame is darker than the least threshold around: so only that is told
everywhere, for WORD columns together, and the columns' own ones where a pixel is brighter, or a spot is looked into.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.background import TILE_PX
from asterism.server.segmentation.pixels import index

BLOCK_ROWS = 8  # rows that share one row of seed thresholds
WORD = 64  # columns that are looked at together: one bit each in a machine word
_PART_BITS = 7  # of a grey level's parts, in which thresholds are stepped
_ROUNDED = 0.5  # grey levels: more than a threshold lies below what is interpolated, for stepping and rounding


class Thresholds(NamedTuple):
    """Of frames of one size: ``lines`` (tiles_y, w) float32, thresholds at the heights of the tiles' centres; ``rows``
    (blocks, w) uint8, those of every block of rows, where ``known`` (blocks, words) uint8 is not 0; ``least`` (blocks,
    words) uint8, which none of WORD columns is below.
    """

    lines: Any
    least: Any
    known: Any
    rows: Any

    @staticmethod
    def of(height: int, width: int) -> "Thresholds":
        """Of 0 everywhere, for frames of that size, px."""
        blocks, words = -(-height // BLOCK_ROWS), -(-width // WORD)
        least, known = np.zeros((blocks, words), np.uint8), np.zeros((blocks, words), np.uint8)
        lines = np.zeros((max(1, round(height / TILE_PX)), width), np.float32)
        return Thresholds(lines, least, known, np.zeros((blocks, width), np.uint8))


@compiled
def _fill_ramp(start, slope, x0, line):
    """Fill ``line`` (n,) float32 with a ramp; its first pixel is the one at column ``x0``."""
    for k in range(line.shape[0]):
        line[k] = start + slope * np.float32(np.int32(x0) + np.int32(k))


@compiled
def _line_of_seeds(level, noise, sigmas, least, line, minima):
    """Fill ``line`` (w,) float32 with the seed thresholds at the height of a row of tiles' centres, and ``minima``
    (words,) with the least ones of WORD columns.
    """
    tiles, width = level.shape[0], line.shape[0]
    per_px = tiles / width
    minima[:] = np.float32(255.0)
    # From one tile's centre to the next it is a ramp; beyond the outer ones it is level.
    for j in range(-1, tiles):
        x0 = max(math.ceil((j + 0.5) / per_px - 0.5), 0)
        x1 = min(math.ceil((j + 1.5) / per_px - 0.5), width)
        j0, j1 = max(j, 0), min(j + 1, tiles - 1)
        left = min(level[j0] + max(sigmas * noise[j0], least), 255.0)
        rise = min(level[j1] + max(sigmas * noise[j1], least), 255.0) - left
        start, slope = np.float32(left + rise * (0.5 * per_px - 0.5 - j)), np.float32(rise * per_px)
        _fill_ramp(start, slope, x0, line[x0:x1])
        # Of a ramp's part the least is at one of its ends.
        for word in range(x0 // WORD, -(-x1 // WORD)):
            first, last = max(x0, WORD * word), min(x1, WORD * (word + 1)) - 1
            if first <= last:
                minima[word] = min(minima[word], line[first], line[last])


@compiled
def _ramp_of(block, per_block, tiles):
    """The row of tiles above a ``block`` of rows (-1 above the first), and how far below its centre the block lies, in
    rows of tiles.
    """
    place = (block + 0.5) * per_block - 0.5
    tile = min(math.floor(place), tiles - 1)
    return tile, place - tile


@compiled
def begin_thresholds(level, noise, sigmas, least, height, thresholds):
    """Let `Thresholds` be the background's ``level`` (tiles_y, tiles_x) plus ``sigmas`` times its ``noise``, at least
    ``least`` grey levels, in a frame of that height.
    """
    tiles, words = level.shape[0], thresholds.least.shape[1]
    minima = np.empty((tiles, words), np.float32)
    for tile in range(tiles):
        _line_of_seeds(level[tile], noise[tile], sigmas, least, thresholds.lines[tile], minima[tile])
    thresholds.known[:] = 0
    per_block = BLOCK_ROWS * tiles / height
    for block in range(thresholds.least.shape[0]):
        tile, part = _ramp_of(block, per_block, tiles)
        upper, lower = minima[max(tile, 0)], minima[min(tile + 1, tiles - 1)]
        for word in range(words):
            told = upper[word] + part * (lower[word] - upper[word]) - _ROUNDED
            thresholds.least[block, word] = np.uint8(max(told, 0.0))


@compiled
def tell(thresholds, height, block, word):
    """Make the rows' thresholds of WORD columns in a block known, in a frame of that height.

    They are a blend of two lines, stepped from block to block in whole parts of a grey level.
    """
    lines, rows = thresholds.lines, thresholds.rows
    tiles, width = lines.shape
    per_block = BLOCK_ROWS * tiles / height
    tile, part = _ramp_of(block, per_block, tiles)
    steps = 0
    while steps < block and _ramp_of(block - steps - 1, per_block, tiles)[0] == tile:
        steps += 1
        part = _ramp_of(block - steps, per_block, tiles)[1]
    upper, lower, row = index(max(tile, 0)), index(min(tile + 1, tiles - 1)), index(block)
    start, parts = np.float32(part), np.float32(1 << _PART_BITS)
    for x in range(WORD * word, min(WORD * (word + 1), width)):
        column = index(x)
        above, rise = lines[upper, column], lines[lower, column] - lines[upper, column]
        now = np.int16(parts * (above + start * rise))
        change = np.int16(parts * np.float32(per_block) * rise)
        rows[row, column] = np.uint8(np.int16(now + steps * change) >> _PART_BITS)
    thresholds.known[block, word] = 1


@compiled
def tell_box(thresholds, height, box):
    """Make the thresholds in a box known, in a frame of that height."""
    for block in range(box.y0 // BLOCK_ROWS, -(-box.y1 // BLOCK_ROWS)):
        for word in range(box.x0 // WORD, -(-box.x1 // WORD)):
            if not thresholds.known[block, word]:
                tell(thresholds, height, block, word)
