"""Connected components of the pixels above their seed threshold, touching only the hot places of the frame.

One pass over the frame marks, block of eight rows by block, the columns in which any pixel exceeds its threshold (the
compiler turns it into SIMD code that runs at memory speed). Only marked columns are looked at again, row by row, while
the block is in the cache, as runs that are joined to components (8-neighbourhood) by union-find.
"""

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.background import BLOCK_ROWS
from asterism.server.segmentation.pixels import Box, index

# Columns of the component table; X1 and Y1 are exclusive, START is the column of a pixel of it in its first row.
X0, X1, Y0, Y1, AREA, PEAK, START = range(7)
COMPONENT_COLUMNS = 7

# Columns of the runs: row, first column, last but one, number of the component.
ROW, FIRST, END, NUMBER = range(4)
RUN_COLUMNS = 4

HOT_COLUMNS = 64  # that cold places are skipped by


def hot_width(width: int) -> int:
    """Columns of the marks for an image of that width, px: a multiple of HOT_COLUMNS."""
    return -(-width // HOT_COLUMNS) * HOT_COLUMNS


@compiled
def box_of(component):
    """The box of a row of the component table."""
    return Box(np.int64(component[X0]), np.int64(component[X1]), np.int64(component[Y0]), np.int64(component[Y1]))


@compiled
def _raise_to(row, tops):
    """Raise ``tops`` (w,) to a row (w,) of the image where that is brighter."""
    for x in range(tops.shape[0]):
        tops[x] = max(tops[x], row[x])


@compiled
def _mark_above(limit, tops):
    """Turn ``tops`` (w,) into marks: whether they are above the ``limit`` (w,)."""
    for x in range(tops.shape[0]):
        tops[x] = tops[x] > limit[x]


@compiled
def _mark_hot_columns(image, limit, y0, y1, hot):
    """Set ``hot`` (w,) where a row from ``y0`` to ``y1`` (exclusive) has a pixel above the ``limit`` (w,)."""
    hot[:] = 0
    # Row by row, the order in which memory is fastest.
    for y in range(y0, y1):
        _raise_to(image[y], hot)
    _mark_above(limit, hot)


@compiled
def _root(parent, k):
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@compiled
def _hot_segments(mark, words, segments):
    """Fill ``segments`` (capacity, 2) with first and last column but one of every hot stretch; return how many.

    ``mark`` (hot_width,) are a block's marks, ``words`` (hot_width / 8,) the same eight at a time.
    """
    count = 0
    inside = False
    for place in range(0, words.shape[0], 8):
        # Most of a block is cold: skip it 64 columns at a time.
        if not inside:
            any_hot = words[index(place)]
            for k in range(1, 8):
                any_hot |= words[index(place + k)]
            if any_hot == 0:
                continue
        for word in range(place, place + 8):
            if not inside and words[index(word)] == 0:
                continue
            for x in range(8 * word, 8 * word + 8):
                if (mark[index(x)] != 0) != inside:
                    inside = not inside
                    if inside:
                        segments[count, 0] = x
                    else:
                        segments[count, 1] = x
                        count += 1
    if inside:
        segments[count, 1] = mark.shape[0]
        count += 1
    return count


@compiled
def connect(image, thresholds, hot, runs, parent, table):
    """Fill ``table`` (capacity, COMPONENT_COLUMNS) int32 with the components and ``runs`` (capacity, RUN_COLUMNS) int32
    with their rows' stretches; return how many there are of both.

    ``hot`` (hot_width,) uint8, zero beyond the image's width, and ``parent`` (capacity,) are scratch. Returns -1
    components when a capacity does not suffice.
    """
    height, width = image.shape
    count = 0
    before, before_end, before_row = 0, 0, -2
    segments = np.empty((width // 2 + 1, 2), np.int32)
    words = hot.view(np.uint64)
    for block in range(thresholds.shape[0]):
        limit = thresholds[block]
        y0, y1 = block * BLOCK_ROWS, min((block + 1) * BLOCK_ROWS, height)
        _mark_hot_columns(image, limit, y0, y1, hot[:width])
        n_segments = _hot_segments(hot, words, segments)
        if n_segments == 0:
            continue
        for y in range(y0, y1):
            row = image[y]
            first = count
            for s in range(n_segments):
                inside = False
                for x in range(segments[s, 0], segments[s, 1]):
                    if (row[index(x)] > limit[index(x)]) != inside:
                        inside = not inside
                        if inside:
                            if count == runs.shape[0]:
                                return -1, count
                            runs[count, ROW], runs[count, FIRST] = y, x
                        else:
                            runs[count, END] = x
                            count += 1
                if inside:
                    runs[count, END] = segments[s, 1]
                    count += 1
            if count == first:
                continue
            if before_row != y - 1:
                before, before_end = first, first
            above = before
            for k in range(first, count):
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
            before, before_end, before_row = first, count, y
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
