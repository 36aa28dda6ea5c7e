"""The pixels of a window as flat arrays of single precision, padded to whole registers: for sums over them.

The compiler turns a loop over such arrays into SIMD code; with the padding nothing is left for a slow loop over the
rest, which for spots of a hundred pixels would take as long. Pixels that do not count have weight zero.
"""

from typing import NamedTuple

import numpy as np

from asterism.server.compiled import compiled, compiled_sums

# Rows of gathered pixels: place from the window's middle, px, grey level, 1 or 0 for a pixel that does not count, and
# room for one more value.
PX, PY, GREY, COUNTS, RISE = range(5)
PIXEL_ROWS = 5
LANES = 16  # numbers of single precision in a register
SPARE = 4 * LANES  # room for the padding of two parts, and for the last row's rest of a register

f32 = np.float32  # a plain number in an expression would make the compiler compute it in double precision
index = np.uint64  # of an array: one that might be negative keeps the compiler from using SIMD
ZERO, HALF, ONE, TWO = f32(0.0), f32(0.5), f32(1.0), f32(2.0)


class Box(NamedTuple):
    """A window in the image, px: columns from ``x0`` to ``x1``, rows from ``y0`` to ``y1``, the ends not in it."""

    x0: int
    x1: int
    y0: int
    y1: int


@compiled
def whole_of(image):
    """The whole image."""
    return Box(np.int64(0), image.shape[1], np.int64(0), image.shape[0])


@compiled
def cells_of(box):
    """How many pixels a box has."""
    return (box.x1 - box.x0) * (box.y1 - box.y0)


@compiled
def grown(box, margin, within):
    """A box with a margin on every side, as far as it stays within another."""
    return Box(
        max(box.x0 - margin, within.x0),
        min(box.x1 + margin, within.x1),
        max(box.y0 - margin, within.y0),
        min(box.y1 + margin, within.y1),
    )


@compiled
def reaches_edge(box, image):
    """Whether a box reaches the edge of the image, so that light may be cut off."""
    return box.x0 < 2 or box.y0 < 2 or box.x1 > image.shape[1] - 2 or box.y1 > image.shape[0] - 2


@compiled
def room_for(cells):
    """Empty (PIXEL_ROWS, capacity) float32 for the pixels of a window of so many cells."""
    return np.empty((PIXEL_ROWS, int(cells) + SPARE), np.float32)


@compiled_sums
def gather_box(image, box, middle_x, middle_y, pixels, n):
    """Put the pixels of a box behind the first ``n`` of ``pixels``; return how many there are now.

    Their places are told from (``middle_x``, ``middle_y``) px.
    """
    xs, ys, values = pixels[PX], pixels[PY], pixels[GREY]
    x0 = box.x0
    width = box.x1 - x0
    # Whole registers, where the image is wide enough: the next row overwrites what is too much.
    padded = (width + LANES - 1) & -LANES
    if x0 + padded > image.shape[1]:
        padded = width
    left = f32(x0 - middle_x)
    for y in range(box.y0, box.y1):
        row, v = image[y], f32(y - middle_y)
        for k in range(padded):
            place = index(n + k)
            xs[place], ys[place], values[place] = left + f32(k), v, f32(row[index(x0 + k)])
        n += width
    return n


@compiled
def pad(pixels, start, end):
    """Let the pixels from ``start`` to ``end`` count, and add some that do not up to a multiple of LANES: to where."""
    padded = -(-end // LANES) * LANES
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    for i in range(start, padded):
        counts[index(i)] = ONE
    # A whole register, whatever of it is too much: no number of rounds that nobody could predict.
    last = padded - LANES
    for k in range(LANES if start < padded else 0):
        place, inside = index(last + k), last + k < end
        xs[place] = xs[place] if inside else ZERO
        ys[place] = ys[place] if inside else ZERO
        values[place] = values[place] if inside else ZERO
        counts[place] = ONE if inside else ZERO
    return padded
