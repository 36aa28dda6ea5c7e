"""The morphological opening of a smoothed image: what is left when everything narrower than a square is taken away.

An erosion (the least of every square window), then a dilation (the greatest): a plane, a ramp and the side of a lamp
stay as they are, spots of light narrower than the square vanish. The window is a square, so rows and columns come one
after the other, and the least of 2 n pixels in a row is that of two times n: any window takes a few passes, which the
compiler makes SIMD code of. Source: Serra, "Image analysis and mathematical morphology", 1982; the doubling follows
Gil and Kimmel, "Efficient dilation, erosion, opening, and closing algorithms", PAMI 2002.
"""

from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.pixels import index

MOST_HALF = 24  # px: half the side of the largest square, without its middle
PART = 128  # pixels that SIMD code takes at a time: rows are as long as a multiple of it, so that nothing is left over
DARKEST, BRIGHTEST = np.uint8(0), np.uint8(255)
TWO16, EIGHT16 = np.uint16(2), np.uint16(8)


class OpeningRoom(NamedTuple):
    """Room for images up to a size: ``smooth`` and ``opened``, flat uint8 for their rows, the latter with a border for
    the window; ``lines`` (3, columns) uint8 and ``sums`` (columns,) uint16.
    """

    smooth: Any
    opened: Any
    lines: Any
    sums: Any


def opening_room(height: int, width: int) -> OpeningRoom:
    """For images of that size, px."""
    columns = -(-width // PART) * PART
    smooth = np.empty(height * columns, np.uint8)
    opened = np.empty((height + 2 * MOST_HALF) * columns, np.uint8)
    padded = columns + 2 * MOST_HALF + PART
    return OpeningRoom(smooth, opened, np.empty((3, padded), np.uint8), np.empty(padded, np.uint16))


@compiled
def _add_rows(above, row, below, sums):
    """Fill ``sums`` (n,) with 1 2 1 of three rows (n,)."""
    for x in range(sums.shape[0]):
        sums[x] = np.uint16(above[x]) + TWO16 * np.uint16(row[x]) + np.uint16(below[x])


@compiled
def _add_columns(sums, out):
    """Fill ``out`` (n,) with a sixteenth of 1 2 1 along ``sums`` (at least n + 2,)."""
    for x in range(out.shape[0]):
        out[x] = np.uint16(sums[x] + TWO16 * sums[index(x + 1)] + sums[index(x + 2)] + EIGHT16) >> 4


@compiled
def _smooth(image, box, sums, out):
    """Fill ``out`` (rows, columns) with the smoothed pixels of a box; beyond the image's edge its outermost count."""
    height, width = image.shape
    left, right = max(box.x0 - 1, 0), min(box.x1 + 1, width)
    start = left - (box.x0 - 1)
    end = start + right - left
    sums[:] = 0
    for y in range(box.y0, box.y1):
        above, row, below = image[max(y - 1, 0)], image[y], image[min(y + 1, height - 1)]
        _add_rows(above[left:right], row[left:right], below[left:right], sums[start:end])
        sums[0], sums[end] = sums[start], sums[end - 1]
        _add_columns(sums, out[y - box.y0])


@compiled
def _lesser(a, b, out):
    for x in range(out.shape[0]):
        out[x] = min(a[x], b[x])


@compiled
def _greater(a, b, out):
    for x in range(out.shape[0]):
        out[x] = max(a[x], b[x])


# The same in place: where two arguments were one array, the compiler's SIMD code would stand aside.


@compiled
def _lessen(a, b):
    for x in range(a.shape[0]):
        a[x] = min(a[x], b[x])


@compiled
def _heighten(a, b):
    for x in range(a.shape[0]):
        a[x] = max(a[x], b[x])


@compiled
def _along_row(source, width, half, greatest, lines, out):
    """Fill the first ``width`` of ``out`` (n,) with the least (greatest) of ``source`` within ``half`` px."""
    side, n = 2 * half + 1, out.shape[0]
    outside = DARKEST if greatest else BRIGHTEST
    line, next_line = lines[0], lines[1]
    line[:half] = outside
    for x in range(width):
        line[index(half + x)] = source[index(x)]
    line[half + width : n + 2 * half] = outside
    reach = 1
    while reach < side:
        step = min(reach, side - reach)
        reach += step
        # Of the pixels beyond the row's end as many as are asked for later, in whole parts.
        left = -(-(n + side - reach) // PART) * PART
        if greatest:
            _greater(line[:left], line[step : step + left], next_line[:left])
        else:
            _lesser(line[:left], line[step : step + left], next_line[:left])
        line, next_line = next_line, line
    for x in range(n):
        out[x] = line[x]


@compiled
def _erode(smooth, width, half, lines, rows):
    """Fill the first rows of ``rows`` (n + 2 half, columns) with the erosion of ``smooth`` (n, columns)."""
    height = smooth.shape[0]
    for y in range(half):
        rows[y] = BRIGHTEST
        rows[half + height + y] = BRIGHTEST
    for y in range(height):
        _along_row(smooth[y], width, half, False, lines, rows[half + y])
    side, reach = 2 * half + 1, 1
    while reach < side:
        step = min(reach, side - reach)
        reach += step
        for y in range(rows.shape[0] - reach + 1):
            _lessen(rows[y], rows[y + step])


@compiled
def _dilate(width, half, lines, rows):
    """Turn the first rows of ``rows`` (n + 2 half, columns) into their dilation, which comes to lie ``half`` lower."""
    last = rows.shape[0] - half
    for y in range(last - half):
        _along_row(rows[y], width, half, True, lines, rows[y])
    for y in range(last - half, last):
        rows[y] = DARKEST
    side, reach = 2 * half + 1, 1
    while reach < side:
        step = min(reach, side - reach)
        reach += step
        for y in range(last - 1, step - 1, -1):
            _heighten(rows[y], rows[y - step])


@compiled
def open_box(image, box, half, room):
    """A box's smoothed pixels, and their opening by a square of side 2 ``half`` + 1 px, each (rows, columns) uint8.

    There are more columns than the box has, which say nothing. What lies outside the box does not count. Both lie in
    the `OpeningRoom`.
    """
    height, width = box.y1 - box.y0, box.x1 - box.x0
    columns = -(-width // PART) * PART
    smooth = room.smooth[: height * columns].reshape(height, columns)
    rows = room.opened[: (height + 2 * half) * columns].reshape(height + 2 * half, columns)
    _smooth(image, box, room.sums, smooth)
    _erode(smooth, width, half, room.lines, rows)
    _dilate(width, half, room.lines, rows)
    return smooth, rows[half : half + height]
