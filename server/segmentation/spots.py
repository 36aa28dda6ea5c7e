"""From a connected component to the spots of light in it: split, local background, shape, verdict.

A component is split where it has several peaks of their own (a watershed in descending grey levels in which peaks
of little prominence are joined to their neighbour), so a lamp, a glint or a dim mirror image that touches an LED does
not take the LED with it. Every spot is then judged against its own surroundings: a plane through the ring around it
is its background, half its height above that its local threshold.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.background import interpolate
from asterism.server.segmentation.components import AREA, PEAK, box_of
from asterism.server.segmentation.crowds import CELL_BLOCKS, CELL_PX
from asterism.server.segmentation.glare import MOST_RISE, is_glare
from asterism.server.segmentation.pixels import (
    COUNTS,
    SPARE,
    ZERO,
    Box,
    cells_of,
    gather_box,
    grown,
    index,
    pad,
    reaches_edge,
    room_for,
    whole_of,
)
from asterism.server.segmentation.shape import judge, looks_single, shape
from asterism.server.segmentation.spot_table import (
    AT_EDGE,
    FATE,
    HEIGHT,
    LEVEL,
    MASKED,
    NOISE,
    SEMI_A,
    SEMI_B,
    SHOULDER,
    SLOPE_X,
    SLOPE_Y,
    TOO_LARGE,
    TOO_SMALL,
    TOUCHING,
    WX0,
    WX1,
    WY0,
    WY1,
    X,
    Y,
)
from asterism.server.segmentation.surroundings import ring_background, ring_quartile
from asterism.server.segmentation.thresholds import BLOCK_ROWS
from asterism.server.segmentation.watershed import keep_group, most_regions, watershed

MARGIN_PX = 3  # of the window around a spot; the ring of its outermost pixels shows the background
REGION_MARGIN_PX = 4  # the same around the upper part of a region of a split component
UPPER_PART = 0.3  # of a region's height above its surroundings
LIFTED_PART = 0.5  # the same in glare, where lower down there may be what is left of a lamp's top or of texture
LIFTED_NOISE = 2.0  # grey levels: more than shot noise leaves in smoothed pixels, whatever texture is around
SMALLEST_AREA_PX = 3
FREE = np.int32(-1)  # the label of pixels that belong to no component


class Background(NamedTuple):
    """The background's ``level`` and ``noise`` maps (tiles_y, tiles_x), grey levels."""

    level: Any
    noise: Any


class Limits(NamedTuple):
    """What makes a spot: how far it stands out, ``sigmas`` of the background's noise and the ``least`` in grey levels;
    the ``largest_radius_px``; ``masks`` (m, 4) x0, y0, x1, y1 px inclusive, in which nothing counts.
    """

    sigmas: float
    least: float
    largest_radius_px: float
    masks: Any


class Seeds(NamedTuple):
    """What components were found with: an ``image`` (h, w) uint8 and its `Thresholds`. ``lifted``: it is
    the residue of `glare`, light told above its surroundings, and not the frame.
    """

    image: Any
    thresholds: Any
    lifted: bool


class Judged(NamedTuple):
    """What the regions of a split component are judged by: the ``faintest`` that counts, grey levels; the
    ``largest_radius_px``; the ``noise`` of its surroundings, grey levels.
    """

    faintest: float
    largest_radius_px: float
    noise: float


class Regions(NamedTuple):
    """A split component: ``labels`` (cells,) of its window's pixels, and the ``table`` (n, 4), as `watershed` fills."""

    labels: Any
    table: Any


@compiled
def _window_of(spot):
    """The window of a row of the spot table."""
    return Box(int(spot[WX0]), int(spot[WX1]), int(spot[WY0]), int(spot[WY1]))


@compiled
def _set_window(spot, box):
    """Tell the window to a row of the spot table."""
    spot[WX0], spot[WX1], spot[WY0], spot[WY1] = box.x0, box.x1, box.y0, box.y1


@compiled
def _set_background(spot, plane):
    """Tell the background to a row of the spot table."""
    spot[LEVEL], spot[SLOPE_X], spot[SLOPE_Y] = plane.level, plane.slope_x, plane.slope_y


@compiled
def _gather_window(image, box, pixels):
    """The pixels of a window, row by row, told from its middle; how many, with the padding."""
    cx, cy = 0.5 * (box.x0 + box.x1 - 1), 0.5 * (box.y0 + box.y1 - 1)
    return pad(pixels, 0, gather_box(image, box, cx, cy, pixels, 0))


@compiled
def _begin(image, component, lifted, background, limits, spot):
    """Fill a spot with what its component tells; its fate where that settles it, else 0.

    ``lifted``: it was found in glare, whose level and noise only its own surroundings tell.
    """
    height, width = image.shape
    box = box_of(component)
    cx, cy = 0.5 * (box.x0 + box.x1 - 1), 0.5 * (box.y0 + box.y1 - 1)
    window = grown(box, MARGIN_PX, whole_of(image))
    spot[:] = 0.0
    spot[X], spot[Y] = cx, cy
    spot[NOISE] = interpolate(background.noise, cy, cx, height, width)
    spot[LEVEL] = ring_quartile(image, window) if lifted else interpolate(background.level, cy, cx, height, width)
    spot[SEMI_A] = spot[SEMI_B] = math.sqrt(component[AREA] / math.pi)
    spot[HEIGHT] = component[PEAK] if lifted else component[PEAK] - spot[LEVEL]
    _set_window(spot, window)
    for mask in limits.masks:
        if mask[0] <= cx <= mask[2] and mask[1] <= cy <= mask[3]:
            return MASKED
    if component[AREA] < SMALLEST_AREA_PX:
        return TOO_SMALL
    if is_glare(box):
        return TOO_LARGE
    if reaches_edge(box, image) and max(box.x1 - box.x0, box.y1 - box.y0) <= 4.0 * limits.largest_radius_px:
        return AT_EDGE
    return 0


@compiled
def measure_spots(image, seeds, components, background, limits, spots):
    """Fill ``spots`` (capacity, SPOT_COLUMNS) from the ``components`` (n, COMPONENT_COLUMNS); how many there are.

    ``seeds`` are those the components were found with; `Background` and `Limits` as above. There is a row at least for
    each component: the capacity is no less than their number.
    """
    labels, table = np.empty(0, np.int32), np.empty((0, 4))
    pixels = room_for(1024)
    count = 0
    for k in range(components.shape[0]):
        component, spot = components[k], spots[count]
        spot[FATE] = _begin(image, component, seeds.lifted, background, limits, spot)
        if spot[FATE]:
            count += 1
            continue
        window, noise = _window_of(spot), spot[NOISE]
        faintest = max(limits.sigmas * noise, limits.least)
        cells = cells_of(window)
        if pixels.shape[1] < cells + SPARE:
            pixels = room_for(cells)
        n = _gather_window(image, window, pixels)
        level = spot[LEVEL]
        plane, spot[NOISE] = ring_background(pixels, n, window, level, noise, faintest)
        if seeds.lifted:
            faintest = _faintest_lifted(limits, spot)
        _set_background(spot, plane)
        area, share = shape(pixels, n, window, spot)
        if spot[SHOULDER] == 0.0 and looks_single(component, spot, area) and not reaches_edge(box_of(component), image):
            spot[FATE] = judge(spot, area, share, faintest, limits.largest_radius_px)
            count += 1
            continue
        if labels.shape[0] < cells:
            labels = np.empty(cells, np.int32)
        if table.shape[0] < most_regions(window):
            table = np.empty((most_regions(window), 4))
        if seeds.lifted:
            n_regions = watershed(seeds, window, 0.0, LIFTED_NOISE, labels, table)
        else:
            n_regions = watershed(seeds, window, level, noise, labels, table)
        regions = Regions(labels[:cells], table[:n_regions])
        keep_group(regions.labels, regions.table, window, component)
        # The components that are still to come keep a row each.
        room = spots[count : spots.shape[0] - (components.shape[0] - 1 - k)]
        limit = Judged(faintest, limits.largest_radius_px, noise)
        count += _measure_regions(image, seeds, regions, spot.copy(), limit, pixels, room)
    return count


@compiled
def _faintest_lifted(limits, spot):
    """How far a spot in glare must stand out, grey levels: what makes a seed there is enough on any texture."""
    return min(max(limits.sigmas * spot[NOISE], limits.least), MOST_RISE)


@compiled
def _region_boxes(seeds, regions, whole, boxes, cut):
    """Boxes (n, 4) x0, x1, y0, y1 (exclusive ends) of the upper part of every region, above what surrounds it.

    Lower down a region's pixels are shared out between neighbours by chance. ``cut`` (n,) is set where a region
    reaches the edge of the image. Returns how many regions have any pixel.
    """
    labels, table, window = regions.labels, regions.table, _window_of(whole)
    width = window.x1 - window.x0
    base, part = (0.0, LIFTED_PART) if seeds.lifted else (whole[LEVEL], UPPER_PART)
    boxes[:, 0], boxes[:, 1], boxes[:, 2], boxes[:, 3] = window.x1, window.x0, window.y1, window.y0
    cut[:] = False
    may_be_cut = reaches_edge(window, seeds.image)
    bars = np.empty(table.shape[0])
    for region in range(table.shape[0]):
        foot = max(table[region, 1], base)
        bars[region] = foot + part * (table[region, 0] - foot)
    for y in range(window.y0, window.y1):
        for x in range(window.x0, window.x1):
            region = labels[(y - window.y0) * width + x - window.x0]
            if region < 0:
                continue
            if may_be_cut:
                cut[region] |= reaches_edge(Box(x, x + 1, y, y + 1), seeds.image)
            if seeds.image[y, x] > bars[region]:
                box = boxes[region]
                box[0], box[1] = min(box[0], x), max(box[1], x + 1)
                box[2], box[3] = min(box[2], y), max(box[3], y + 1)
    count = 0
    for region in range(table.shape[0]):
        count += boxes[region, 0] < boxes[region, 1]
    return count


@compiled
def _leave_to_others(regions, region, window, box, pixels):
    """Let the pixels of a box that belong to another region, or component, not count; the free surroundings do."""
    labels, counts, mine = regions.labels, pixels[COUNTS], np.int32(region)
    width, columns = window.x1 - window.x0, box.x1 - box.x0
    for y in range(box.y0, box.y1):
        first, place = (y - window.y0) * width + box.x0 - window.x0, (y - box.y0) * columns
        for x in range(columns):
            label = labels[index(first + x)]
            counts[index(place + x)] = counts[index(place + x)] if label in (mine, FREE) else ZERO


@compiled
def _measure_regions(image, seeds, regions, whole, limit, pixels, spots):
    """Measure every region of a split component as a spot of its own, into ``spots`` (capacity, SPOT_COLUMNS); return
    how many there are. ``whole`` is the component's row. Where there are more than the capacity it is told as one.
    """
    window, n_regions = _window_of(whole), regions.table.shape[0]
    boxes, cut = np.empty((max(n_regions, 1), 4), np.int64), np.empty(max(n_regions, 1), np.bool_)
    alone = _region_boxes(seeds, regions, whole, boxes, cut)
    if alone > spots.shape[0]:
        spots[0] = whole
        spots[0, FATE] = TOO_LARGE
        return 1
    count = 0
    for region in range(n_regions):
        if boxes[region, 0] >= boxes[region, 1]:
            continue
        upper = Box(boxes[region, 0], boxes[region, 1], boxes[region, 2], boxes[region, 3])
        box = grown(upper, REGION_MARGIN_PX, window)
        spot = spots[count]
        spot[:] = whole
        _set_window(spot, box)
        spot[TOUCHING] = alone > 1
        around = ring_quartile(image, box)
        n = _gather_window(image, box, pixels)
        if seeds.lifted:
            _leave_to_others(regions, region, window, box, pixels)
        plane, spot[NOISE] = ring_background(pixels, n, box, around, limit.noise, limit.faintest)
        _set_background(spot, plane)
        _leave_to_others(regions, region, window, box, pixels)
        area, share = shape(pixels, n, box, spot)
        spot[FATE] = AT_EDGE if cut[region] else judge(spot, area, share, limit.faintest, limit.largest_radius_px)
        count += 1
    return count


@compiled
def tell_crowds(image, crowded, background, spots):
    """Fill a row of ``spots`` for every ``crowded`` cell of the image; return how many there are."""
    height, width = image.shape
    rows = CELL_BLOCKS * BLOCK_ROWS
    count = 0
    for cell_y in range(crowded.shape[0]):
        for cell_x in range(crowded.shape[1]):
            if not crowded[cell_y, cell_x]:
                continue
            spot = spots[count]
            spot[:] = 0.0
            box = Box(
                CELL_PX * cell_x, min(CELL_PX * (cell_x + 1), width), rows * cell_y, min(rows * (cell_y + 1), height)
            )
            _set_window(spot, box)
            spot[X], spot[Y] = 0.5 * (box.x0 + box.x1 - 1), 0.5 * (box.y0 + box.y1 - 1)
            spot[LEVEL] = interpolate(background.level, spot[Y], spot[X], height, width)
            spot[NOISE] = interpolate(background.noise, spot[Y], spot[X], height, width)
            spot[SEMI_A] = spot[SEMI_B] = math.sqrt(cells_of(box) / math.pi)
            spot[FATE] = TOO_LARGE
            count += 1
    return count
