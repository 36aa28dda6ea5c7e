"""Places so full of bright texture that their components overflow the tables: their seed thresholds are raised.

Everywhere else a frame keeps its thresholds, so that no LED is lost for what glitters elsewhere. The tables have room
for a share of runs and components in every cell of the image; only cells that have more are raised, by steps that
double, so that after a few rounds each has no more than its share, or nothing.
"""

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.components import connect
from asterism.server.segmentation.pixels import whole_of
from asterism.server.segmentation.thresholds import BLOCK_ROWS, WORD, tell_box

CELL_PX, CELL_BLOCKS = WORD, 8  # columns, and blocks of rows
MOST_RUNS, MOST_COMPONENTS = 200, 25  # of a cell, on average: many more than a robot's LEDs have
FIRST_STEP = 8  # grey levels


def cells_for(height: int, width: int) -> tuple[int, int]:
    """Rows and columns of cells of an image of that size, px."""
    return -(-height // (CELL_BLOCKS * BLOCK_ROWS)), -(-width // CELL_PX)


@compiled
def _count(image, thresholds, runs, tops):
    """Count, for every cell, the ``runs`` and those with nothing above them, ``tops``: no fewer than components."""
    height, width = image.shape
    runs[:] = 0
    tops[:] = 0
    lit, before = np.zeros(width + 2, np.bool_), np.zeros(width + 2, np.bool_)
    for y in range(height):
        row, limit = image[y], thresholds[y // BLOCK_ROWS]
        cell_y = y // (CELL_BLOCKS * BLOCK_ROWS)
        for x in range(width):
            lit[x + 1] = row[x] > limit[x]
        start, joined = -1, False
        for x in range(1, width + 2):
            if lit[x]:
                if start < 0:
                    start, joined = x, before[x - 1]
                joined |= before[x]
            elif start >= 0:
                runs[cell_y, (start - 1) // CELL_PX] += 1
                tops[cell_y, (start - 1) // CELL_PX] += not (joined or before[x])
                start = -1
        lit, before = before, lit


@compiled
def _raise_crowded(thresholds, runs, tops, step, crowded):
    """Raise the `Thresholds` of cells that have more than their share by ``step`` grey levels, and mark them."""
    rows, least = thresholds.rows, thresholds.least
    for cell_y in range(crowded.shape[0]):
        for cell_x in range(crowded.shape[1]):
            if runs[cell_y, cell_x] <= MOST_RUNS and tops[cell_y, cell_x] <= MOST_COMPONENTS:
                continue
            crowded[cell_y, cell_x] = 1
            for block in range(CELL_BLOCKS * cell_y, min(CELL_BLOCKS * (cell_y + 1), rows.shape[0])):
                least[block, cell_x] = min(least[block, cell_x] + step, 255)
                for x in range(CELL_PX * cell_x, min(CELL_PX * (cell_x + 1), rows.shape[1])):
                    rows[block, x] = min(rows[block, x] + step, 255)


@compiled
def connect_all(image, thresholds, within, scratch):
    """Components and runs of the image in the tables of ``scratch``, however many there would be: how many there are.

    Outside the rows of the box ``within`` the image is dark. Where there are too many the `Thresholds` are raised and
    the cell is marked as ``crowded``.
    """
    tables = scratch.runs, scratch.parent, scratch.components
    components, runs = connect(image, thresholds, within, *tables)
    step = FIRST_STEP
    cell_runs, cell_tops = np.zeros(scratch.crowded.shape, np.int64), np.zeros(scratch.crowded.shape, np.int64)
    while components < 0:
        tell_box(thresholds, image.shape[0], whole_of(image))
        _count(image, thresholds.rows, cell_runs, cell_tops)
        _raise_crowded(thresholds, cell_runs, cell_tops, step, scratch.crowded)
        step *= 2
        components, runs = connect(image, thresholds, within, *tables)
    return components, runs
