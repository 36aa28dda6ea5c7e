"""Frames of which only the windows around spots are kept: the rest is plain, at the level of the background.

A spot's window shows its surroundings, as far as its centre and its fate depend on them: those of a robot's LEDs,
where other light is near, are the widest. What else solving again looks at is how bright and how noisy the background
is, tile by tile (`tiles`), and whether the picture was compressed (server/centres/compression.py). Of the tiles about
a spot that is told in every frame, so that the spot is solved as before; of all others it is drawn anew every `REFRESH`
frames, and where the light changes.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.messages import Fate
from asterism.recordings.tiles import STEP_PX, TILE_PX, Floats, Image, Tiles, Window, lowest_around

LED, UNEXPLAINED = int(Fate.LED), int(Fate.UNEXPLAINED)
COMPRESSED_ROWS, COMPRESSED_LEVELS, COMPRESSED = 16, 40, 0.9


class Margin(NamedTuple):
    """Half a window's side: so many ``times`` the radius of a spot, and so much more, px."""

    times: float
    px: float


LIGHT = Margin(2.0, 9.0)  # of an LED that other light may lean on
ALONE = Margin(1.45, 7.0)  # of one that none does, and of what looks like one
STRANGE = Margin(1.2, 4.0)  # of what looks like one, far from all LEDs: it is seen, no more
OTHER = Margin(6.0, 8.0)  # of one that was rejected, which may be long or ragged
LARGEST_PX = 200.0  # of a lamp no more is kept
LONG = 1.5  # times its radius, how far a spot may reach
NEAR_PX = 30.0  # from edge to edge, up to which one may lean on the other
REFRESH = 600  # frames
CHANGED, CHANGED_MUCH = 0.6, 4.0  # grey levels of the mean, from which on the light has changed; so much at once
LEAST_AGE = 60  # frames, unless it has changed much: lamps flicker
FEW_TILES = 0.45  # of all, of which the pixels themselves are kept: a third of the time that dots take
MOST = 0.6  # of those that are told, that must be even for dots to do: polished floors shine everywhere
UNEVEN = 1.0  # grey levels, from which on a tile's level is another


class Spots(NamedTuple):
    """Columns (n,): where spots are and how large, px, and their fates."""

    x: Floats
    y: Floats
    radius: Floats
    fate: NDArray[np.int64]


class SpotWindows:
    """For frames (height, width); one buffer is used again and again."""

    def __init__(self, height: int, width: int) -> None:
        self._plain = np.empty((height, width), np.uint8)
        self._out = np.empty_like(self._plain)
        self._tiles = Tiles(height, width)
        self._level = np.empty(0)
        self._even = np.empty(0, np.bool_)
        self._age = REFRESH
        self._mean = -math.inf

    def keep(self, image: Image, spots: Spots) -> Image:
        """What is kept of an (h, w) image with these spots; valid until the next call."""
        mean = float(image[min(TILE_PX, image.shape[0]) // 2 :: TILE_PX, :: STEP_PX * STEP_PX].mean())
        self._age += 1
        change = abs(mean - self._mean)
        if self._age > REFRESH or change > CHANGED_MUCH or (change > CHANGED and self._age > LEAST_AGE):
            self._age, self._mean = 0, mean
            self._draw(image)
        out, windows = self._out, _windows(spots, *image.shape)
        out[:] = self._plain
        for y0, y1, x0, x1 in windows:
            out[y0:y1, x0:x1] = image[y0:y1, x0:x1]
        self._tell_tiles(image, spots, windows)
        return out

    def _draw(self, image: Image) -> None:
        """Draw the background of an image in all tiles."""
        tiles, plain = self._tiles, self._plain
        told = tiles.measure(image, tiles.all)
        self._level, self._even = told.level, tiles.are_even(told.level)
        grid = told.level.reshape(tiles.down, tiles.across)
        levels = np.where(self._even.reshape(grid.shape), grid, lowest_around(grid)).astype(np.uint8)
        plain[:] = np.repeat(np.repeat(levels, np.diff(tiles.ys), axis=0), np.diff(tiles.xs), axis=1)
        if not _is_compressed(image):
            plain[::COMPRESSED_ROWS, ::2] += plain[::COMPRESSED_ROWS, ::2] < 255
        tiles.mark(())
        tiles.dot(plain, tiles.all, told)

    def _tell_tiles(self, image: Image, spots: Spots, windows: list[Window]) -> None:
        """Tell the background of the tiles about the spots."""
        chosen = self._tiles.choose(spots.x, spots.y)
        if len(chosen.tiles) <= FEW_TILES * len(self._level):
            self._tiles.copy(image, self._out, chosen)
            return
        self._tiles.mark(windows)
        told = self._tiles.measure(image, chosen)
        if np.abs(self._level[chosen.tiles] - told.level).max(initial=0.0) > UNEVEN:
            self._level[chosen.tiles] = told.level
            self._even = self._tiles.are_even(self._level)
        # On a slope, or where light covers half a tile, one level for all of it would be light in its dark part.
        plain = self._even[chosen.tiles] & ~told.dark
        if plain.all():
            self._tiles.dot(self._out, chosen, told)
        elif plain.mean() < MOST:
            self._tiles.copy(image, self._out, chosen)
        else:
            self._tiles.dot(self._out, chosen.of(plain), told.of(plain))
            self._tiles.copy(image, self._out, chosen.of(~plain))


def _windows(spots: Spots, height: int, width: int) -> list[Window]:
    """Around every spot, as wide as what it is asks for."""
    x, y, radius, _ = spots
    times, more = _margins(spots)
    half = np.minimum(times * radius + more, LARGEST_PX)
    ends = np.array([y - half, y + half + 2.0, x - half, x + half + 2.0])
    np.maximum(ends, 0.0, out=ends)
    np.minimum(ends[:2], height, out=ends[:2])
    np.minimum(ends[2:], width, out=ends[2:])
    return list(zip(*ends.astype(int).tolist(), strict=True))


def _margins(spots: Spots) -> Floats:
    """Of each spot (2, n): how many times its radius is kept, and how many px more."""
    fate = spots.fate
    is_led = fate == LED
    margins = np.where(is_led, _column(ALONE), _column(OTHER))
    if is_led.all():
        return margins
    leds, others = np.flatnonzero(is_led), np.flatnonzero(~is_led)
    away = np.hypot(spots.x[leds, None] - spots.x[others], spots.y[leds, None] - spots.y[others])
    near = away - LONG * (spots.radius[leds, None] + spots.radius[others]) < NEAR_PX
    margins[:, leds[near.any(axis=1)]] = _column(LIGHT)
    of_others, near_led = fate[others], near.any(axis=0)
    margins[:, others[(of_others == UNEXPLAINED) & near_led]] = _column(ALONE)
    margins[:, others[(of_others == UNEXPLAINED) & ~near_led]] = _column(STRANGE)
    return margins


def _column(margin: Margin) -> Floats:
    return np.array(margin)[:, None]


def _is_compressed(image: Image) -> bool:
    """As server/centres/compression.py has it."""
    rows = image[::COMPRESSED_ROWS]
    median = int(np.median(rows[:, ::COMPRESSED_ROWS]))
    background = rows[:, 1:] <= min(median + COMPRESSED_LEVELS, 254)
    equal = (rows[:, 1:] == rows[:, :-1]) & background
    return int(equal.sum()) > COMPRESSED * max(int(background.sum()), 1)
