"""Splitting a component that holds several peaks: a watershed in descending grey levels.

Peaks of little prominence are joined to their neighbour; every other one gets a region of its own. Source: Vincent and
Soille, "Watersheds in digital spaces", PAMI 1991, on the few pixels of one component.
"""

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.components import AREA, PEAK

PROMINENCE = 0.12  # a peak that stands out less, as a share of its height, belongs to its neighbour


@compiled
def _top(regions, region):
    """The highest region of the connected group that a region belongs to."""
    while int(regions[region, 3]) != region:
        region = int(regions[region, 3])
    return region


@compiled
def watershed(image, thresholds, box, base, noise, labels, regions):
    """Split the pixels of a box above the seed ``thresholds`` (blocks, w) into regions, one for every prominent peak.

    ``labels`` (cells,) int32 is filled with region numbers (-1 outside); ``regions`` (capacity, 4) float64 with
    peak, the level at which it meets a higher one (its saddle; -1 if it never does), the region it was joined to
    (itself if it stands alone), and a higher region of the connected group it belongs to (itself if it is the
    highest; see `_top`). Returns the number of regions, joined ones included.
    """
    x0, y0 = box.x0, box.y0
    width, height = box.x1 - x0, box.y1 - y0
    cells = width * height
    counts = np.zeros(257, np.int32)
    for y in range(height):
        limit = thresholds[(y + y0) // 8]
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
        limit = thresholds[(y + y0) // 8]
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
        best = -1
        best_value = -1.0
        # First the brightest neighbour's region, then judge every other region that meets it here.
        for ny in range(max(cy - 1, 0), min(cy + 2, height)):
            for nx in range(max(cx - 1, 0), min(cx + 2, width)):
                label = labels[ny * width + nx]
                if label >= 0 and image[ny + y0, nx + x0] > best_value:
                    best = label
                    best_value = float(image[ny + y0, nx + x0])
        if best < 0:
            if count == regions.shape[0]:
                continue
            regions[count, 0], regions[count, 1] = value, -1.0
            regions[count, 2] = regions[count, 3] = count
            labels[cell] = count
            count += 1
            continue
        mine = best
        while int(regions[mine, 2]) != mine:
            mine = int(regions[mine, 2])
        for ny in range(max(cy - 1, 0), min(cy + 2, height)):
            for nx in range(max(cx - 1, 0), min(cx + 2, width)):
                other = labels[ny * width + nx]
                if other < 0:
                    continue
                while int(regions[other, 2]) != other:
                    other = int(regions[other, 2])
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
        label = labels[cell]
        if label >= 0:
            while int(regions[label, 2]) != label:
                label = int(regions[label, 2])
            labels[cell] = label
    return count


@compiled
def keep_group(labels, regions, component):
    """Mark (-2) the pixels of other components that reach into the window; they are measured on their own."""
    n_regions = regions.shape[0]
    sizes = np.zeros(n_regions, np.int64)
    for label in labels:
        if label >= 0:
            sizes[_top(regions, label)] += 1
    mine = -1
    for region in range(n_regions):
        if sizes[region] == component[AREA] and regions[region, 0] == component[PEAK]:
            mine = region
            break
    for cell in range(labels.shape[0]):
        if labels[cell] >= 0 and _top(regions, labels[cell]) != mine:
            labels[cell] = -2
