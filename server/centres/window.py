"""The pixels that a spot's centre is estimated from: its window's, without those of its neighbours."""

import math

from asterism.server.compiled import compiled
from asterism.server.segmentation.pixels import COUNTS, PX, PY, ZERO, Box, f32, gather_box, pad
from asterism.server.segmentation.spot_table import SEMI_A, WX0, WX1, WY0, WY1, X, Y

NEAR_PX = 3.0  # outside the edge, within which pixels tell of the spot's shape
SQUARE = 0.5 * math.sqrt(math.pi)  # half the side of the square as large as the unit disc
NEIGHBOUR_MARGIN_PX = 1.0  # pixels nearer than this to another spot are left out


@compiled
def leave_out(pixels, count, neighbours, middle_x, middle_y):
    """Let the first ``count`` pixels on or near ``neighbours`` (k, 3) x, y, radius px not count.

    Pixels are told from (``middle_x``, ``middle_y``) px.
    """
    for k in range(neighbours.shape[0]):
        x, y = f32(neighbours[k, 0] - middle_x), f32(neighbours[k, 1] - middle_y)
        reach2 = f32((neighbours[k, 2] + NEIGHBOUR_MARGIN_PX) ** 2)
        for i in range(count):
            if (pixels[PX, i] - x) ** 2 + (pixels[PY, i] - y) ** 2 < reach2:
                pixels[COUNTS, i] = ZERO


@compiled
def gather_pixels(image, spot, neighbours, pixels):
    """The pixels of the spot's window, told from its middle: how many.

    ``pixels`` is room for the window (see `pixels.room_for`). They are padded with pixels that do not count, nor do
    those of ``neighbours`` (k, 3) x, y, radius px.
    """
    return _gather(image, spot, Box(int(spot[WX0]), int(spot[WX1]), int(spot[WY0]), int(spot[WY1])), neighbours, pixels)


@compiled
def gather_near(image, spot, neighbours, pixels):
    """Those pixels of the spot's window that are near its edge or inside it; as `gather_pixels`."""
    reach = SQUARE * (spot[SEMI_A] + NEAR_PX)
    x0, x1 = max(int(spot[WX0]), math.ceil(spot[X] - reach)), min(int(spot[WX1]), math.floor(spot[X] + reach) + 1)
    y0, y1 = max(int(spot[WY0]), math.ceil(spot[Y] - reach)), min(int(spot[WY1]), math.floor(spot[Y] + reach) + 1)
    return _gather(image, spot, Box(x0, x1, y0, y1), neighbours, pixels)


@compiled
def _gather(image, spot, box, neighbours, pixels):
    """The pixels of a box, told from the middle of the spot's window."""
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    count = pad(pixels, 0, gather_box(image, box, middle_x, middle_y, pixels, 0))
    leave_out(pixels, count, neighbours, middle_x, middle_y)
    return count
