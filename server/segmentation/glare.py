"""Spots inside what is too large to be one: a lamp's reflection, a patch of sun, bright metal.

There the seeds are told anew, by what surrounds each pixel and not by the frame's background: above the opening of the
smoothed image (`opening`) by more than noise and texture make it rise. How much that is, the median rise in a tile
tells: of noise alone the highest pixel of a tile lies below three times its median, as the opening lies under all of
it. The result is an image of its own, the ``residue``, in which components are looked for as in the frame; what is
too large there as well is looked at again through a smaller square.
"""

from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.components import END, FIRST, NUMBER, ROW, box_of
from asterism.server.segmentation.opening import MOST_HALF, open_box
from asterism.server.segmentation.pixels import Box, cells_of, grown, index, whole_of

LARGEST_COMPONENT_PX = 4096  # of a component's box: beyond that it is glare, and spots are looked for inside it
FOOT_PX = 3.0  # of a spot's blur around it, on which an opening must not stand
MOST_LEVELS = 3  # of looking again
LEAST_HALF = 5  # px: through smaller squares LEDs do not look different from noise
TILE = 32  # px: where the rise of noise and texture is told
SAMPLE = 5  # px between the samples of a tile's row, in every other row
TIMES_MEDIAN = 3.0
LEAST_RISE, MOST_RISE = 8.0, 20.0  # grey levels: so much more light makes a seed, whatever the texture
NOTHING, WHOLE, NO_RISE = np.uint8(0), np.uint8(255), np.int16(0)


class Lifted(NamedTuple):
    """A ``box`` of the image: its ``smooth`` pixels and their opening, ``opened``, as from `open_box`; ``painted``
    (h, w) uint8, not 0 where there is glare.
    """

    box: Any
    smooth: Any
    opened: Any
    painted: Any


@compiled
def first_half(largest_radius_px):
    """Half the side, px, of a square wider than any LED."""
    return min(int(np.ceil(largest_radius_px + FOOT_PX)), MOST_HALF)


@compiled
def is_glare(box):
    """Whether a component of that box is too large to be one spot, or some that touch."""
    return cells_of(box) > LARGEST_COMPONENT_PX


@compiled
def glares_of(components):
    """Which of the components (n, COMPONENT_COLUMNS) are glare, (n,)."""
    glares = np.zeros(components.shape[0], np.bool_)
    for k in range(components.shape[0]):
        glares[k] = is_glare(box_of(components[k]))
    return glares


@compiled
def _paint(runs, glares, value, painted):
    """Set ``painted`` (h, w) to the ``value`` in the components that are ``glares`` (components,)."""
    for k in range(runs.shape[0]):
        if glares[runs[k, NUMBER]]:
            row = index(runs[k, ROW])
            for x in range(runs[k, FIRST], runs[k, END]):
                painted[row, index(x)] = value


@compiled
def _rise_of(lifted, tile, counts):
    """By how much, grey levels, light must rise in a ``tile`` of the box to be more than noise and texture; 255 where
    there is no glare.
    """
    counts[:] = 0
    samples = 0
    for y in range(tile.y0, tile.y1, 2):
        painted = lifted.painted[y]
        smooth, opened = lifted.smooth[y - lifted.box.y0], lifted.opened[y - lifted.box.y0]
        for x in range(tile.x0 + (y & 2), tile.x1, SAMPLE):
            if painted[x]:
                k = x - lifted.box.x0
                counts[np.int64(smooth[k]) - np.int64(opened[k])] += 1
                samples += 1
    if samples == 0:
        return 255
    rise, below = 0, counts[0]
    while 2 * below < samples:
        rise += 1
        below += counts[rise]
    return int(min(max(TIMES_MEDIAN * rise, LEAST_RISE), MOST_RISE))


@compiled
def _keep_rise(smooth, opened, painted, bars, residue):
    """Fill a row of the residue with what rises by more than ``bars`` above its surroundings where it is painted."""
    for x in range(residue.shape[0]):
        rise = np.int16(np.int16(smooth[x]) - np.int16(opened[x]) - np.int16(bars[x]))
        residue[x] = painted[x] & np.uint8(max(rise, NO_RISE))


@compiled
def _lift_box(image, box, half, scratch):
    """Fill the residue in a box with what rises above its surroundings where it is painted."""
    smooth, opened = open_box(image, box, half, scratch.opening)
    lifted = Lifted(box, smooth, opened, scratch.painted)
    width, counts = box.x1 - box.x0, np.zeros(256, np.int32)
    bars = np.empty(width, np.uint8)
    for y0 in range(box.y0, box.y1, TILE):
        y1 = min(y0 + TILE, box.y1)
        for x0 in range(box.x0, box.x1, TILE):
            x1 = min(x0 + TILE, box.x1)
            bars[x0 - box.x0 : x1 - box.x0] = _rise_of(lifted, Box(x0, x1, y0, y1), counts)
        # Whole rows at a time, for SIMD code.
        for y in range(y0, y1):
            k = y - box.y0
            painted, residue = scratch.painted[y, box.x0 : box.x1], scratch.residue[y, box.x0 : box.x1]
            _keep_rise(smooth[k, :width], opened[k, :width], painted, bars, residue)


@compiled
def lift(image, components, glares, runs, half, scratch):
    """Fill the residue of ``scratch`` with the light that stands out inside the components that are ``glares`` (n,).

    ``components`` (n, COMPONENT_COLUMNS) and the ``runs`` (m, RUN_COLUMNS) are as `connect` left them; ``half`` of the
    opening's square, px. Where boxes overlap so much that they are more than the image, all of it is opened once.
    Returns the box that was filled; ``painted`` and, outside the box, the residue are 0 before and after.
    """
    whole = whole_of(image)
    cells, reach = 0, Box(whole.x1, whole.x0, whole.y1, whole.y0)
    for k in range(components.shape[0]):
        if glares[k]:
            # What surrounds the glare counts as well, else spots on its rim would not be narrower than the window.
            box = grown(box_of(components[k]), half, whole)
            cells += cells_of(box)
            reach = Box(min(reach.x0, box.x0), max(reach.x1, box.x1), min(reach.y0, box.y0), max(reach.y1, box.y1))
    _paint(runs, glares, WHOLE, scratch.painted)
    if cells > cells_of(whole):
        reach = whole
        _lift_box(image, whole, half, scratch)
    else:
        for k in range(components.shape[0]):
            if glares[k]:
                _lift_box(image, grown(box_of(components[k]), half, whole), half, scratch)
    _paint(runs, glares, NOTHING, scratch.painted)
    return reach


@compiled
def let_fall(reach, scratch):
    """Clear the residue of ``scratch`` where `lift` filled it."""
    scratch.residue[reach.y0 : reach.y1, reach.x0 : reach.x1] = NOTHING
