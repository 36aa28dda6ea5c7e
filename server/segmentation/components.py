"""Connected components of the pixels above their seed threshold, touching only the hot places of the frame.

One pass over the frame compares WORD columns at a time with the least threshold there (the compiler turns it into SIMD
code that runs at memory speed). Where any of them is brighter, their own thresholds tell a bit for each, and the bits
the runs of the row; runs are joined to components (8-neighbourhood) by union-find.
"""

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.pixels import Box, index
from asterism.server.segmentation.thresholds import BLOCK_ROWS, WORD, tell

# Columns of the component table; X1 and Y1 are exclusive, START is the column of a pixel of it in its first row.
X0, X1, Y0, Y1, AREA, PEAK, START = range(7)
COMPONENT_COLUMNS = 7

# Columns of the runs: row, first column, last but one, number of the component.
ROW, FIRST, END, NUMBER = range(4)
RUN_COLUMNS = 4

NO, YES = np.uint8(0), np.uint8(1)
ZERO64, ONE64 = np.uint64(0), np.uint64(1)
# Of a place's number, from the highest on: the bits that are set in every word in which only that place's is.
HALVES = tuple(np.uint64(sum(1 << place for place in range(WORD) if place & half)) for half in (32, 16, 8, 4, 2, 1))


@compiled
def box_of(component):
    """The box of a row of the component table."""
    return Box(np.int64(component[X0]), np.int64(component[X1]), np.int64(component[Y0]), np.int64(component[Y1]))


@compiled
def _is_hot(image, y, start, bar):
    """Whether any of the WORD pixels of row ``y`` from ``start`` on is above ``bar``."""
    row, hot = index(y), NO
    for k in range(WORD):
        hot = np.uint8(hot | (YES if image[row, index(start + k)] > bar else NO))
    return hot != NO


@compiled
def _next_hot(image, least, y, end, start):
    """The first place, from column ``start`` of row ``y`` on by whole WORDs, where one of the WORD pixels of the row
    that begin there is above the ``least`` threshold (blocks, words): its row, ``end`` if there is none above that
    row, and column.
    """
    width = image.shape[1]
    rest = width // WORD * WORD
    for row in range(y, end):
        block = index(row // BLOCK_ROWS)
        for place in range(start, rest, WORD):
            if _is_hot(image, row, place, least[block, index(place // WORD)]):
                return row, place
        # At the row's end as many pixels, for SIMD code, if there are so many.
        at_end = start <= rest < width
        if at_end and (width < WORD or _is_hot(image, row, width - WORD, least[block, index(rest // WORD)])):
            return row, rest
        start = 0
    return end, 0


@compiled
def _bits_above(image, rows, y, start):
    """Which pixels of row ``y`` from ``start`` on, WORD of them at most, are above their threshold in the ``rows``
    (blocks, w): a bit for each.
    """
    row, block = index(y), index(y // BLOCK_ROWS)
    bits = ZERO64
    for k in range(min(WORD, image.shape[1] - start)):
        above = image[row, index(start + k)] > rows[block, index(start + k)]
        bits |= (ONE64 if above else ZERO64) << np.uint64(k)
    return bits


@compiled
def _lowest(bits):
    """The place of the lowest bit that is set: by halves, without a branch."""
    bit = bits & (~bits + ONE64)
    return (
        (32 if bit & HALVES[0] else 0) + (16 if bit & HALVES[1] else 0) + (8 if bit & HALVES[2] else 0)
        + (4 if bit & HALVES[3] else 0) + (2 if bit & HALVES[4] else 0) + (1 if bit & HALVES[5] else 0)
    )  # fmt: skip


@compiled
def _find_runs(image, thresholds, within, runs):
    """Fill ``runs`` with the stretches that are above their `Thresholds`, in the rows of the box ``within``; return how
    many there are, and whether that is all.
    """
    height, width = image.shape
    count, inside = 0, ZERO64
    # Most of a frame is cold.
    y, start = _next_hot(image, thresholds.least, within.y0, within.y1, 0)
    while y < within.y1:
        if not thresholds.known[y // BLOCK_ROWS, start // WORD]:
            tell(thresholds, height, y // BLOCK_ROWS, start // WORD)
        bits = _bits_above(image, thresholds.rows, y, start)
        edges = bits ^ (bits << ONE64 | inside)
        while edges != ZERO64:
            x = start + _lowest(edges)
            edges &= edges - ONE64
            if inside == ZERO64:
                if count == runs.shape[0]:
                    return count, False
                runs[count, ROW], runs[count, FIRST] = y, x
            else:
                runs[count, END] = x
                count += 1
            inside ^= ONE64
        start += WORD
        if inside != ZERO64 and start >= width:
            runs[count, END] = width
            count += 1
            inside = ZERO64
        if inside == ZERO64:
            y, start = _next_hot(image, thresholds.least, y, within.y1, start)
    return count, True


@compiled
def _root(parent, k):
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@compiled
def _join_runs(runs, parent):
    """Make ``parent`` (n,) lead from each of the ``runs`` (n, RUN_COLUMNS) to the first one of its component."""
    before, before_end, first = 0, 0, 0
    while first < runs.shape[0]:
        y, end = runs[first, ROW], first
        while end < runs.shape[0] and runs[end, ROW] == y:
            end += 1
        if before < before_end and runs[before, ROW] != y - 1:
            before = before_end
        above = before
        for k in range(first, end):
            parent[k] = k
            while above < before_end and runs[above, END] < runs[k, FIRST]:
                above += 1
            other = above
            while other < before_end and runs[other, FIRST] <= runs[k, END]:
                a, b = _root(parent, k), _root(parent, other)
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
                other += 1
            # The last run that touched may touch the next run of this row as well.
            above = max(above, other - 1)
        before, before_end, first = first, end, end


@compiled
def connect(image, thresholds, within, runs, parent, table):
    """Fill ``table`` (capacity, COMPONENT_COLUMNS) int32 with the components and ``runs`` (capacity, RUN_COLUMNS) int32
    with their rows' stretches; return how many there are of both. Only rows of the box ``within`` are looked at.

    The image's `Thresholds` become known where it is bright. ``parent`` (capacity,) is scratch. Returns -1 components
    when a capacity does not suffice.
    """
    width = image.shape[1]
    count, complete = _find_runs(image, thresholds, within, runs)
    if not complete:
        return -1, count
    _join_runs(runs[:count], parent)
    components = 0
    for k in range(count):
        root = _root(parent, k)
        y, start, end = runs[k, ROW], runs[k, FIRST], runs[k, END]
        # The root comes before every other run of its component, in its first row.
        if root == k:
            if components == table.shape[0]:
                return -1, count
            runs[k, NUMBER] = components
            entry = table[components]
            entry[X0], entry[X1], entry[Y0], entry[Y1] = width, 0, y, y + 1
            entry[AREA] = entry[PEAK] = 0
            entry[START] = start
            components += 1
        else:
            runs[k, NUMBER] = runs[root, NUMBER]
            entry = table[runs[k, NUMBER]]
        entry[X0] = min(entry[X0], start)
        entry[X1] = max(entry[X1], end)
        entry[Y1] = max(entry[Y1], y + 1)
        entry[AREA] += end - start
        row = image[y]
        peak = entry[PEAK]
        for x in range(start, end):
            peak = max(peak, row[index(x)])
        entry[PEAK] = peak
    return components, count
