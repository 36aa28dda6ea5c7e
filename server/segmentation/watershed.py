"""Splitting a component that holds several peaks: a watershed in descending grey levels.

Peaks of little prominence are joined to their neighbour; every other one gets a region of its own. Source: Vincent and
Soille, "Watersheds in digital spaces", PAMI 1991, on the few pixels of one component.
"""

from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.components import START, Y0
from asterism.server.segmentation.pixels import index
from asterism.server.segmentation.thresholds import BLOCK_ROWS, tell_box

NOBODY, LAST = np.int32(-1), np.int32(2**31 - 1)
PROMINENCE = 0.12  # a peak that stands out less, as a share of its height, belongs to its neighbour


class Peaks(NamedTuple):
    """What peaks are judged by: the ``base`` they stand on and its ``noise``, grey levels; ``regions`` (n, 4)."""

    base: float
    noise: float
    regions: Any


@compiled
def _follow(regions, region, column):
    """The region that a column leads to in the end; the chain is shortened on the way, or it would grow long."""
    after = int(regions[region, column])
    while after != region:
        beyond = int(regions[after, column])
        regions[region, column] = beyond
        region, after = after, beyond
    return region


@compiled
def _top(regions, region):
    """The highest region of the connected group that a region belongs to."""
    return _follow(regions, region, 3)


@compiled
def _descending(image, rows, box):
    """The pixels of a box above their thresholds, in the ``rows`` (blocks, w), from the brightest on: their cells (n,)
    int32 in the box with a margin of one pixel around it, and their levels (n,) uint8.
    """
    width, cells = box.x1 - box.x0, (box.x1 - box.x0) * (box.y1 - box.y0)
    seeds, values, total = np.empty(cells, np.int32), np.empty(cells, np.uint8), 0
    counts = np.zeros(257, np.int32)
    for y in range(box.y0, box.y1):
        row, block, first = index(y), index(y // BLOCK_ROWS), (y - box.y0 + 1) * (width + 2) + 1
        for x in range(width):
            value = image[row, index(box.x0 + x)]
            # Put down in any case, and kept where it counts.
            seeds[index(total)], values[index(total)] = first + x, value
            total += value > rows[block, index(box.x0 + x)]
    for k in range(total):
        counts[256 - values[k]] += 1
    for k in range(256):
        counts[k + 1] += counts[k]
    order, levels = np.empty(total, np.int32), np.empty(total, np.uint8)
    for k in range(total):
        place = 255 - values[k]
        order[counts[place]], levels[counts[place]] = seeds[k], values[k]
        counts[place] += 1
    return order, levels


@compiled
def _brightest_beside(cell, stride, lit, marks):
    """The region of the brightest pixel beside a cell, -1 if none has any; and whether all have the same."""
    best, best_value, lowest, highest = np.int32(-1), np.int16(-1), LAST, np.int32(-1)
    first = cell - stride - 1
    for dy in range(3):
        for dx in range(3):
            place = index(first + dy * stride + dx)
            mark, beside = marks[place], lit[place]
            best = mark if beside > best_value else best
            best_value = beside if beside > best_value else best_value
            highest = mark if mark > highest else highest
            lowest = mark if NOBODY < mark < lowest else lowest
    return np.int64(best), lowest == highest


@compiled
def _judge_beside(cell, stride, marks, best, level, peaks):
    """Judge every other region that meets the one that is marked ``best`` in a cell of that level; whose the cell is
    in the end.
    """
    regions = peaks.regions
    mine = _follow(regions, best, 2)
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            place = index(cell + dy * stride + dx)
            mark = np.int64(marks[place])
            if mark < 0 or mark == best:
                continue
            other = _follow(regions, mark, 2)
            marks[place] = other  # where it leads to, for those that come after
            if other == mine:
                continue
            low, high = max(other, mine), min(other, mine)  # regions are made in descending order of peak
            top_low, top_high = _top(regions, low), _top(regions, high)
            regions[max(top_low, top_high), 3] = min(top_low, top_high)
            if regions[low, 1] >= 0.0:
                continue  # judged before
            rise = regions[low, 0] - peaks.base
            if regions[low, 0] - level >= max(4.0 * peaks.noise, 3.0, PROMINENCE * rise):
                regions[low, 1] = level
            else:
                regions[low, 2] = high
                mine = high if mine == low else mine
    return mine


@compiled
def _label(marks, regions, box, labels):
    """Fill ``labels`` (cells,) of a box with where the ``marks`` of its cells lead to."""
    width = box.x1 - box.x0
    ends = np.empty(regions.shape[0], np.int32)
    for region in range(regions.shape[0]):
        ends[region] = _follow(regions, region, 2)
    for y in range(box.y1 - box.y0):
        first, place = (y + 1) * (width + 2) + 1, y * width
        for x in range(width):
            mark = marks[index(first + x)]
            labels[index(place + x)] = ends[index(mark)] if mark > NOBODY else NOBODY


@compiled
def watershed(seeds, box, base, noise, labels, regions):
    """Split the pixels of a box above their ``seeds``' thresholds into regions, one for every prominent peak.

    ``labels`` (cells,) int32 is filled with region numbers (-1 outside); ``regions`` (`most_regions`, 4) float64 with
    peak, the level at which it meets a higher one (its saddle; -1 if it never does), the region it was joined to
    (itself if it stands alone), and a higher region of the connected group it belongs to (itself if it is the
    highest; see `_top`). Returns the number of regions, joined ones included.
    """
    tell_box(seeds.thresholds, seeds.image.shape[0], box)
    order, levels = _descending(seeds.image, seeds.thresholds.rows, box)
    # Cells with a margin around them, so that each has eight neighbours: ``lit`` are those that were looked at.
    width, height = box.x1 - box.x0, box.y1 - box.y0
    stride = width + 2
    lit, marks = np.empty(stride * (height + 2), np.int16), np.empty(stride * (height + 2), np.int32)
    lit[:], marks[:] = -1, -1
    count = 0
    for k in range(order.shape[0]):
        cell, level = order[k], float(levels[k])
        # First the brightest neighbour's region, then judge every other region that meets it here.
        best, one = _brightest_beside(cell, stride, lit, marks)
        lit[cell] = level
        if best < 0:
            regions[count, 0], regions[count, 1] = level, -1.0
            regions[count, 2] = regions[count, 3] = count
            marks[cell] = count
            count += 1
            continue
        marks[cell] = (
            _follow(regions, best, 2)
            if one
            else _judge_beside(cell, stride, marks, best, level, Peaks(base, noise, regions))
        )
    _label(marks, regions[:count], box, labels)
    return count


@compiled
def keep_group(labels, regions, box, component):
    """Mark (-2) the pixels of other components that reach into the box; they are measured on their own."""
    start = (component[Y0] - box.y0) * (box.x1 - box.x0) + component[START] - box.x0
    mine = _top(regions, labels[start])
    others = np.empty(regions.shape[0], np.bool_)
    for region in range(regions.shape[0]):
        others[region] = _top(regions, region) != mine
    for cell in range(labels.shape[0]):
        if labels[cell] >= 0 and others[labels[cell]]:
            labels[cell] = -2


@compiled
def most_regions(box):
    """How many regions a box can have: no two begin at pixels that touch."""
    return ((box.x1 - box.x0 + 1) // 2) * ((box.y1 - box.y0 + 1) // 2)
