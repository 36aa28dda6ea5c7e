"""Frames of which only the windows around spots are kept: the rest is plain, at the level of the background.

A spot's window shows its surroundings, as far as its centre and its fate depend on them. What else solving again looks
at is how bright and how noisy the background is, tile by tile, and whether the picture was compressed
(server/segmentation/background.py, server/centres/compression.py). Of the tiles about a spot the pixels stay that tell
it, so that it is solved as before; of all others dotted rows tell it, which are drawn anew every `REFRESH` frames, and
where the light changes.
"""

import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.messages import Fate

# As in the segmentation: tiles, in each so many rows of samples, two neighbours of every so many pixels.
TILE_PX, SAMPLED_ROWS, STEP_PX = 128, 8, 4
LARGEST_STEP, EDGE, LEAST_LAMP, DARK_SAMPLES = 48, 4.0, 12.0, 4
COMPRESSED_ROWS, COMPRESSED_LEVELS, COMPRESSED = 16, 40, 0.9

OF_LIGHT = frozenset({int(Fate.LED), int(Fate.UNEXPLAINED)})
LIGHT_TIMES, LIGHT_PX = 2.0, 9.0  # half a window's side: so many radii of a spot, and so much more
OTHER_TIMES, OTHER_PX = 6.0, 8.0  # of one that was rejected, which may be long or ragged
LARGEST_PX = 200.0  # of a lamp no more is kept
EVEN = 6.0  # grey levels between tiles, up to which each has its own level: no threshold is lower
REFRESH = 600  # frames
CHANGED, CHANGED_MUCH = 0.6, 4.0  # grey levels of the mean, from which on the light has changed; so much at once
LEAST_AGE = 60  # frames, unless it has changed much: lamps flicker

Image = NDArray[np.uint8]
Window = tuple[int, int, int, int]  # first and behind the last row, the same of columns
_NOWHERE = np.empty(0, np.intp)


class Spot(NamedTuple):
    """Where a spot is and how large, px, and its fate."""

    x: float
    y: float
    radius: float
    fate: int


class SpotWindows:
    """For frames (height, width); one buffer is used again and again."""

    def __init__(self, height: int, width: int) -> None:
        self._plain = np.empty((height, width), np.uint8)
        self._out = np.empty_like(self._plain)
        self._windows: set[Window] = set()
        self._tiles: set[tuple[int, int]] = set()  # about them
        self._places = _NOWHERE  # of what tells those tiles
        self._age = REFRESH
        self._mean = -math.inf
        tiles_y, tiles_x = max(1, round(height / TILE_PX)), max(1, round(width / TILE_PX))
        self._ys = [tile * height // tiles_y for tile in range(tiles_y + 1)]
        self._xs = [tile * width // tiles_x for tile in range(tiles_x + 1)]

        self._samples = {
            (ty, tx): _places(width, self._ys[ty], self._ys[ty + 1], self._xs[tx], self._xs[tx + 1])
            for ty in range(tiles_y)
            for tx in range(tiles_x)
        }

    def keep(self, image: Image, spots: Iterable[Spot]) -> Image:
        """What is kept of an (h, w) image with these spots; valid until the next call."""
        mean = float(image[min(TILE_PX, image.shape[0]) // 2 :: TILE_PX, :: STEP_PX * STEP_PX].mean())
        self._age += 1
        change = abs(mean - self._mean)
        if self._age > REFRESH or change > CHANGED_MUCH or (change > CHANGED and self._age > LEAST_AGE):
            self._age, self._mean = 0, mean
            _draw(image, self._plain, self._ys, self._xs)
            self._out[:] = self._plain
            self._windows, self._tiles = set(), set()
        windows = {self._window(spot) for spot in spots}
        for y0, y1, x0, x1 in self._windows - windows:
            self._out[y0:y1, x0:x1] = self._plain[y0:y1, x0:x1]
        self._windows = windows
        self._tell_tiles(image)
        for y0, y1, x0, x1 in windows:
            self._out[y0:y1, x0:x1] = image[y0:y1, x0:x1]
        return self._out

    def _tell_tiles(self, image: Image) -> None:
        """Keep what tells the background of the tiles about the windows; the others' goes back to what it was."""
        blocks = {self._about(window) for window in self._windows}
        tiles = {(ty, tx) for y0, y1, x0, x1 in blocks for ty in range(y0, y1) for tx in range(x0, x1)}
        out, now, plain = self._out.reshape(-1), image.reshape(-1), self._plain.reshape(-1)
        if tiles != self._tiles:
            for tile in self._tiles - tiles:
                out[self._samples[tile]] = plain[self._samples[tile]]
            self._tiles = tiles
            self._places = np.concatenate([_NOWHERE, *(self._samples[tile] for tile in sorted(tiles))])
        out[self._places] = now[self._places]

    def _about(self, window: Window) -> Window:
        """The tiles between whose centres a window lies: the first and the one behind the last, down and across."""
        (height, width), tiles_y, tiles_x = self._out.shape, len(self._ys) - 1, len(self._xs) - 1
        y0, y1 = window[0] * tiles_y / height - 0.5, window[1] * tiles_y / height - 0.5
        x0, x1 = window[2] * tiles_x / width - 0.5, window[3] * tiles_x / width - 0.5
        down, across = min(int(y1) + 2, tiles_y), min(int(x1) + 2, tiles_x)
        return max(int(y0), 0), down, max(int(x0), 0), across

    def _window(self, spot: Spot) -> Window:
        half = LIGHT_TIMES * spot.radius + LIGHT_PX if spot.fate in OF_LIGHT else OTHER_TIMES * spot.radius + OTHER_PX
        half = min(half, LARGEST_PX)
        x, y = spot.x, spot.y
        return max(int(y - half), 0), max(int(y + half) + 2, 0), max(int(x - half), 0), max(int(x + half) + 2, 0)


def _draw(image: Image, plain: Image, ys: list[int], xs: list[int]) -> None:
    """Fill ``plain`` (h, w) with the background of an image, in the tiles between ``ys`` and ``xs``."""
    told = [[_measure(image, y0, y1, x0, x1) for x0, x1 in itertools.pairwise(xs)] for y0, y1 in itertools.pairwise(ys)]
    level = np.array([[tile[0] for tile in row] for row in told])
    lowest, highest = _lowest(level), -_lowest(-level)
    dotted = not _is_compressed(image)
    for ty, row in enumerate(told):
        for tx, (middle, step) in enumerate(row):
            even = highest[ty, tx] - lowest[ty, tx] <= EVEN
            tile = plain[ys[ty] : ys[ty + 1], xs[tx] : xs[tx + 1]]
            tile[:] = int(middle if even else lowest[ty, tx])
            if dotted:
                first = -ys[ty] % COMPRESSED_ROWS
                tile[first::COMPRESSED_ROWS, ::2] += tile[first::COMPRESSED_ROWS, ::2] < 255
            _dot(tile, middle, step)


def _places(width: int, y0: int, y1: int, x0: int, x1: int) -> NDArray[np.intp]:
    """Where in the image's memory the pixels are that tell a tile's background."""
    places = []
    for y, shift in zip(_sampled(y0, y1), _shifts(), strict=True):
        first = y * width + np.arange(x0 + shift, x1 - 1, STEP_PX)
        places += [first, first + 1]
    return np.sort(np.concatenate(places))


def _sampled(y0: int, y1: int) -> list[int]:
    return [y0 + (2 * i + 1) * (y1 - y0) // (2 * SAMPLED_ROWS) for i in range(SAMPLED_ROWS)]


def _measure(image: Image, y0: int, y1: int, x0: int, x1: int) -> tuple[float, float]:
    """A tile's level, and the mean step between neighbours, grey levels, as the segmentation takes them."""
    rows = [image[y, x0:x1].astype(np.int16) for y in _sampled(y0, y1)]
    pairs = [(row[shift:-1:STEP_PX], row[shift + 1 :: STEP_PX]) for row, shift in zip(rows, _shifts(), strict=True)]
    values = np.concatenate([value for value, _ in pairs])
    steps = np.abs(np.concatenate([after[: len(value)] - value for value, after in pairs]))
    if len(values) < DARK_SAMPLES:
        return float(image[y0, x0]), 0.0
    usual = _mean_up_to(steps, LARGEST_STEP - 1)
    middle = float(np.median(values))
    stretches = np.lib.stride_tricks.sliding_window_view(values, DARK_SAMPLES).max(axis=1)
    darkest = float(stretches.min())
    level = darkest if darkest < middle - LEAST_LAMP else middle
    return level, _mean_up_to(steps, min(int(EDGE * usual) + 1, LARGEST_STEP))


def _shifts() -> list[int]:
    return [(i & 1) * (STEP_PX // 2) for i in range(SAMPLED_ROWS)]


def _mean_up_to(steps: NDArray[np.int16], most: int) -> float:
    few = steps[steps <= most]
    return float(few.mean()) if few.size else 0.0


def _dot(tile: Image, level: float, step: float) -> None:
    """Rows of pairs whose median is the level, and whose mean step that of the tile."""
    height, width = tile.shape
    wanted = 0.0
    for y, shift in zip(_sampled(0, height), _shifts(), strict=True):
        at = np.arange(shift, width - 1, STEP_PX)
        # Half of them a level higher, where the median lies between two.
        low = np.full(len(at), int(level))
        if level != int(level):
            low[::2] += 1
        total = np.floor(wanted + step * np.arange(1, len(at) + 1)).astype(int)
        steps = np.diff(total, prepend=int(np.floor(wanted)))
        wanted += step * len(at)
        tile[y] = int(level)
        tile[y, at] = low
        tile[y, at + 1] = np.minimum(low + steps, 255)


def _is_compressed(image: Image) -> bool:
    """As server/centres/compression.py has it."""
    rows = image[::COMPRESSED_ROWS]
    median = int(np.median(rows[:, ::COMPRESSED_ROWS]))
    background = rows[:, 1:] <= min(median + COMPRESSED_LEVELS, 254)
    equal = (rows[:, 1:] == rows[:, :-1]) & background
    return int(equal.sum()) > COMPRESSED * max(int(background.sum()), 1)


def _lowest(level: NDArray[np.float64]) -> NDArray[np.float64]:
    """The lowest of each tile and those around it."""
    wide = np.pad(level, 1, mode="edge")
    lines = np.minimum(np.minimum(wide[:-2], wide[1:-1]), wide[2:])
    return np.minimum(np.minimum(lines[:, :-2], lines[:, 1:-1]), lines[:, 2:])
