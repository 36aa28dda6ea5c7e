"""The background of an image tile by tile, as the segmentation looks at it, told by rows of dots instead of its pixels.

Of a tile the segmentation asks for the median of some pairs of neighbours, and for their mean difference
(server/segmentation/background.py). Pairs that differ by no more than one grey level from each other tell both, and
pack to a tenth of the pixels themselves.
"""

import itertools
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# As in the segmentation: tiles, in each so many rows of samples, two neighbours of every so many pixels.
TILE_PX, SAMPLED_ROWS, STEP_PX = 128, 8, 4
LARGEST_STEP, EDGE, LEAST_LAMP, DARK_SAMPLES = 48, 4.0, 12.0, 4
EVEN = 6.0  # grey levels between tiles, up to which each has its own level: no threshold is lower
NOTHING = BRIGHTEST = np.uint8(255)  # a sample that is none

Image = NDArray[np.uint8]
Places = NDArray[np.intp]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Window = tuple[int, int, int, int]  # first and behind the last row, the same of columns


class Told(NamedTuple):
    """Of tiles (t,): the two middle values; the level, grey levels; whether it is the dark part that gives the level;
    the largest step that counts; and of all pairs (t, n) both values and their step.
    """

    lower: Image
    upper: Image
    level: Floats
    dark: Bools
    most: Image
    values: Image
    after: Image
    step: Image

    def of(self, which: Bools) -> "Told":
        """Of some of them."""
        return Told(
            self.lower[which],
            self.upper[which],
            self.level[which],
            self.dark[which],
            self.most[which],
            self.values[which],
            self.after[which],
            self.step[which],
        )


class Chosen(NamedTuple):
    """Tiles (t,) by their numbers, how many pairs (t, n) each has, where in the image's memory these begin, and where
    they are told to be kept; which of them stay as they are, and which are none.
    """

    tiles: Places
    numbers: Places
    first: Places
    kept_at: Places
    stays: Bools
    is_none: Bools

    def of(self, which: Bools | Places) -> "Chosen":
        """Some of them."""
        return Chosen(
            self.tiles[which],
            self.numbers[which],
            self.first[which],
            self.kept_at[which],
            self.stays[which],
            self.is_none[which],
        )


class Tiles:
    """Those of images (height, width); a tile is told by its number, row by row."""

    def __init__(self, height: int, width: int) -> None:
        self.down, self.across = max(1, round(height / TILE_PX)), max(1, round(width / TILE_PX))
        self.ys = [tile * height // self.down for tile in range(self.down + 1)]
        self.xs = [tile * width // self.across for tile in range(self.across + 1)]
        rows = np.array([_sampled(y0, y1) for y0, y1 in itertools.pairwise(self.ys)])
        columns = [_columns(x0, x1) for x0, x1 in itertools.pairwise(self.xs)]
        numbers = np.tile([sum(map(len, of_tile)) for of_tile in columns], self.down)
        most = max(int(numbers.max()), DARK_SAMPLES)
        is_none = np.arange(most) >= numbers[:, None]
        # Where there are fewer, the last one stands for those that are not there, and stays as it is.
        stays = np.arange(most) >= np.where(numbers < most, numbers - 1, most)[:, None]
        first = np.array([_places(width, at, of_tile, most) for at in rows for of_tile in columns])
        at_rows = np.arange(rows.size).reshape(rows.shape)
        kept_at = np.array([_places(width, at, of_tile, most) for at in at_rows for of_tile in columns])
        self.all = Chosen(np.arange(len(numbers)), numbers, first, kept_at, stays, is_none)
        self._chosen = self.all
        self._rows_above = np.searchsorted(rows.reshape(-1), np.arange(height + 1)).tolist()
        self._kept = np.zeros((rows.size, width), np.bool_)  # pairs of the rows that are looked at, by their first

    def mark(self, windows: Iterable[Window]) -> None:
        """Pairs of which a pixel lies in one of these, inside the image, are kept as they are by `dot`."""
        self._kept[:] = False
        for y0, y1, x0, x1 in windows:
            self._kept[self._rows_above[y0] : self._rows_above[y1], max(x0 - 1, 0) : x1] = True

    def choose(self, x: Floats, y: Floats) -> Chosen:
        """The tiles between whose middles points (n,) px lie."""
        tiles = self._about(x, y)
        if not np.array_equal(tiles, self._chosen.tiles):
            self._chosen = self.all.of(tiles)
        return self._chosen

    def measure(self, image: Image, chosen: Chosen) -> Told:
        """Look at tiles (t,) of an image as the segmentation does."""
        pixels, numbers = image.reshape(-1), chosen.numbers
        values, after = pixels[chosen.first], pixels[1:][chosen.first]
        step = np.maximum(values, after) - np.minimum(values, after)
        counted = values
        if chosen.stays.any():
            counted = np.where(chosen.is_none, NOTHING, values)
            step[chosen.is_none] = NOTHING
        ordered, each = np.sort(counted, axis=1, kind="stable"), np.arange(len(numbers))
        lower, upper = ordered[each, (numbers - 1) // 2], ordered[each, numbers // 2]
        level = 0.5 * (lower.astype(np.float64) + upper)
        dark = ordered[:, 0] < level - LEAST_LAMP
        if dark.any():
            two = np.maximum(counted[:, 1:], counted[:, :-1])
            darkest = np.maximum(two[:, 2:], two[:, :-2]).min(axis=1)
            dark = darkest < level - LEAST_LAMP
            level[dark] = darkest[dark]
        total, number = _up_to(step, np.full(len(numbers), LARGEST_STEP - 1, np.uint8))
        most = np.minimum((EDGE * (total / np.maximum(number, 1))).astype(np.uint8) + 1, LARGEST_STEP).astype(np.uint8)
        return Told(lower, upper, level, dark, most, values, after, step)

    def dot(self, out: Image, chosen: Chosen, told: Told) -> None:
        """Draw pairs that tell the same of tiles (t,) into an image, where none is kept."""
        free = ~(self._kept.reshape(-1)[chosen.kept_at] | chosen.stays)
        place = np.cumsum(free, axis=1, dtype=np.int16)  # from 1
        # As many of the free ones as before are no more than the lower middle value.
        lower, upper = told.lower[:, None], told.upper[:, None]
        below = np.count_nonzero(free & (told.values <= lower), axis=1)
        low = np.where(place <= below.astype(np.int16)[:, None], lower, upper)
        # Their steps are of the same sum; all the larger ones first: what is alike in long runs packs best.
        every = place[:, -1].astype(np.intp)
        total, number = _up_to(np.where(free, told.step, NOTHING), told.most)
        total = np.rint(total / np.maximum(number, 1) * every).astype(np.intp)
        step, more = np.divmod(total, np.maximum(every, 1))
        high = low + (step.astype(np.uint8)[:, None] + (place <= more.astype(np.int16)[:, None]))
        high = np.where(high < low, BRIGHTEST, high)
        pixels = out.reshape(-1)
        pixels[chosen.first] = np.where(free, low, told.values)
        pixels[1:][chosen.first] = np.where(free, high, told.after)

    def copy(self, image: Image, out: Image, chosen: Chosen) -> None:
        """Copy the pairs of tiles (t,) themselves."""
        pixels, now = out.reshape(-1), image.reshape(-1)
        pixels[chosen.first] = now[chosen.first]
        pixels[1:][chosen.first] = now[1:][chosen.first]

    def _about(self, x: Floats, y: Floats) -> Places:
        row = (y * (self.down / self.ys[-1]) + 0.5).astype(np.intp)  # from 1 behind which a middle lies
        column = (x * (self.across / self.xs[-1]) + 0.5).astype(np.intp)
        row, column = np.minimum(row, self.down), np.minimum(column, self.across)
        # With a border all around: of what lies beyond the last middle.
        wide = self.across + 2
        wanted = np.zeros((self.down + 2, wide), np.bool_)
        corner = row * wide + column
        wanted.reshape(-1)[np.concatenate([corner, corner + 1, corner + wide, corner + wide + 1])] = True
        return np.flatnonzero(wanted[1:-1, 1:-1])

    def are_even(self, level: Floats) -> Bools:
        """Of tiles of that ``level`` (all,): whether it is hardly above that of any around."""
        grid = level.reshape(self.down, self.across)
        return (grid - lowest_around(grid) <= EVEN).reshape(-1)


def lowest_around(level: Floats) -> Floats:
    """The lowest of each tile (down, across) and those around it."""
    wide = np.pad(level, 1, mode="edge")
    lines = np.minimum(np.minimum(wide[:-2], wide[1:-1]), wide[2:])
    return np.minimum(np.minimum(lines[:, :-2], lines[:, 1:-1]), lines[:, 2:])


def _sampled(y0: int, y1: int) -> list[int]:
    """The rows of a tile that are looked at."""
    return [y0 + (2 * i + 1) * (y1 - y0) // (2 * SAMPLED_ROWS) for i in range(SAMPLED_ROWS)]


def _columns(x0: int, x1: int) -> list[Places]:
    """Of each of these rows the columns of the first ones of a tile's pairs."""
    return [np.arange(x0 + (i & 1) * (STEP_PX // 2), x1 - 1, STEP_PX) for i in range(SAMPLED_ROWS)]


def _places(width: int, rows: NDArray[np.intp], columns: list[Places], most: int) -> Places:
    """Where in memory the pairs of a tile's rows begin, the last one as often as there are fewer than ``most``."""
    places = np.concatenate([y * width + x for y, x in zip(rows, columns, strict=True)])
    return np.pad(places, (0, most - len(places)), mode="edge")


def _up_to(steps: Image, most: Image) -> tuple[Places, Places]:
    """The sum of those steps (t, n) of each tile that are no more than its ``most``, and how many there are."""
    few = steps <= most[:, None]
    return np.add.reduce(steps * few, axis=1, dtype=np.intp), np.count_nonzero(few, axis=1)
