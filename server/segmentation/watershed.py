"""Splitting a component that holds several peaks: a watershed in descending grey levels.

Peaks of little prominence are joined to their neighbour; every other one gets a region of its own. Source: Vincent and
Soille, "Watersheds in digital spaces", PAMI 1991, on the few pixels of one component.
"""

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.components import START, Y0
from asterism.server.segmentation.pixels import index
from asterism.server.segmentation.thresholds import BLOCK_ROWS, tell_box

PROMINENCE = 0.12  # a peak that stands out less, as a share of its height, belongs to its neighbour


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
def watershed(seeds, box, base, noise, labels, regions):
    """Split the pixels of a box above their ``seeds``' thresholds into regions, one for every prominent peak.

    ``labels`` (cells,) int32 is filled with region numbers (-1 outside); ``regions`` (`most_regions`, 4) float64 with
    peak, the level at which it meets a higher one (its saddle; -1 if it never does), the region it was joined to
    (itself if it stands alone), and a higher region of the connected group it belongs to (itself if it is the
    highest; see `_top`). Returns the number of regions, joined ones included.
    """
    image, thresholds = seeds.image, seeds.thresholds.rows
    tell_box(seeds.thresholds, image.shape[0], box)
    x0, y0 = box.x0, box.y0
    width, height = box.x1 - x0, box.y1 - y0
    cells = width * height
    counts = np.zeros(257, np.int32)
    for y in range(height):
        limit = thresholds[(y + y0) // BLOCK_ROWS]
        for x in range(width):
            labels[y * width + x] = -1
            value = image[y + y0, x + x0]
            if value > limit[x + x0]:
                counts[255 - value + 1] += 1
    for k in range(256):
        counts[k + 1] += counts[k]
    order = np.empty(max(counts[256], 1), np.int32)
    total = counts[256]
    for y in range(height):
        limit = thresholds[(y + y0) // BLOCK_ROWS]
        for x in range(width):
            value = image[y + y0, x + x0]
            if value > limit[x + x0]:
                order[counts[255 - value]] = y * width + x
                counts[255 - value] += 1
    count = 0
    for k in range(total):
        cell = order[k]
        cy, cx = cell // width, cell % width
        value = float(image[cy + y0, cx + x0])
        best, best_value, one = -1, -1, True
        # First the brightest neighbour's region, then judge every other region that meets it here.
        for ny in range(max(cy - 1, 0), min(cy + 2, height)):
            for nx in range(max(cx - 1, 0), min(cx + 2, width)):
                label = np.int64(labels[index(ny * width + nx)])
                if label >= 0:
                    one &= best < 0 or label == best
                    beside = np.int64(image[index(ny + y0), index(nx + x0)])
                    if beside > best_value:
                        best, best_value = label, beside
        if best < 0:
            regions[count, 0], regions[count, 1] = value, -1.0
            regions[count, 2] = regions[count, 3] = count
            labels[cell] = count
            count += 1
            continue
        mine = _follow(regions, best, 2)
        if one:
            labels[cell] = mine
            continue
        for ny in range(max(cy - 1, 0), min(cy + 2, height)):
            for nx in range(max(cx - 1, 0), min(cx + 2, width)):
                other = labels[ny * width + nx]
                if other < 0:
                    continue
                other = _follow(regions, other, 2)
                if other == mine:
                    continue
                low, high = max(other, mine), min(other, mine)  # regions are made in descending order of peak
                top_low, top_high = _top(regions, low), _top(regions, high)
                regions[max(top_low, top_high), 3] = min(top_low, top_high)
                if regions[low, 1] >= 0.0:
                    continue  # judged before
                rise = regions[low, 0] - base
                if regions[low, 0] - value >= max(4.0 * noise, 3.0, PROMINENCE * rise):
                    regions[low, 1] = value
                else:
                    regions[low, 2] = high
                    mine = high if mine == low else mine
        labels[cell] = mine
    for cell in range(cells):
        if labels[cell] >= 0:
            labels[cell] = _follow(regions, labels[cell], 2)
    return count


@compiled
def keep_group(labels, regions, box, component):
    """Mark (-2) the pixels of other components that reach into the box; they are measured on their own."""
    start = (component[Y0] - box.y0) * (box.x1 - box.x0) + component[START] - box.x0
    mine = _top(regions, labels[start])
    for cell in range(labels.shape[0]):
        if labels[cell] >= 0 and _top(regions, labels[cell]) != mine:
            labels[cell] = -2


@compiled
def most_regions(box):
    """How many regions a box can have: no two begin at pixels that touch."""
    return ((box.x1 - box.x0 + 1) // 2) * ((box.y1 - box.y0 + 1) // 2)
