"""Search for constellations that stay apart: random ones first, then the weakest pairs moved until work runs out.

Compiled, and repeatable: what ends the search is counted work, never the clock. All lengths in m; LEDs in the plate's
frame, origin at its centre, on a grid of GRID, so that what is drilled by the drawing is what was judged.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.identity.separation import TABLES, strength, tabulate

GRID = 1e-5  # m
# Of the disc's radius. z accuracy goes with the rms radius, tilt accuracy with the lesser spread; six LEDs strewn
# evenly have 0.71 and 0.5. Any five must do as well: where one is hidden, LEDs near one line tell no tilt.
LEAST_RMS_RADIUS = 0.65
LEAST_SPREAD = 0.35
LEAST_SPREAD_OF_FIVE = 0.30
_DARTS = 60  # throws, after which a layout that is not complete is given up
_THROWS = 50  # layouts thrown anew in one change, until one fits
_TRY = 0.1  # work of a change that cannot be made, strengths
_SLACK = 1.3  # strengths above this times the weakest's are not told apart


@compiled
def fits(layout, radius, spacing):
    """Whether a layout (6, 2) may be made: on the disc of LED centres, spaced, and spread in both directions, also
    with any one LED hidden.
    """
    x = y = xx = xy = yy = 0.0
    for i in range(6):
        u, v = layout[i, 0], layout[i, 1]
        if u * u + v * v > radius * radius:
            return False
        for j in range(i):
            if (u - layout[j, 0]) ** 2 + (v - layout[j, 1]) ** 2 < spacing * spacing:
                return False
        x, y = x + u, y + v
        xx, xy, yy = xx + u * u, xy + u * v, yy + v * v
    around = (xx + yy) / 6.0 - (x * x + y * y) / 36.0
    if around < (LEAST_RMS_RADIUS * radius) ** 2 or _spread2(6, x, y, xx, xy, yy) < (LEAST_SPREAD * radius) ** 2:
        return False
    for hidden in range(6):
        u, v = layout[hidden, 0], layout[hidden, 1]
        if _spread2(5, x - u, y - v, xx - u * u, xy - u * v, yy - v * v) < (LEAST_SPREAD_OF_FIVE * radius) ** 2:
            return False
    return True


@compiled
def _spread2(count, x, y, xx, xy, yy):
    """The lesser variance over all directions of ``count`` points with these sums."""
    x, y = x / count, y / count
    xx, xy, yy = xx / count - x * x, xy / count - x * y, yy / count - y * y
    return 0.5 * (xx + yy) - math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)


@compiled
def _throw(rng, radius, spacing, layout):
    """A random layout (6, 2); False where the throws did not yield one."""
    count = 0
    for _ in range(_DARTS):
        r, angle = radius * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
        layout[count, 0] = round(r * math.cos(angle) / GRID) * GRID
        layout[count, 1] = round(r * math.sin(angle) / GRID) * GRID
        free = True
        for k in range(count):
            x, y = layout[count, 0] - layout[k, 0], layout[count, 1] - layout[k, 1]
            free = free and x * x + y * y >= spacing * spacing
        if free:
            count += 1
            if count == 6:
                return fits(layout, radius, spacing)
    return False


@compiled
def _shift(rng, old, radius, layout):
    """``old`` with some of its LEDs moved by anything from a thousandth of the radius to a half."""
    size = 0.5 * radius * math.exp(-6.0 * rng.random())
    share = rng.random()
    for k in range(6):
        layout[k] = old[k]
        if rng.random() < share:
            for axis in range(2):
                layout[k, axis] = round((old[k, axis] + size * (2.0 * rng.random() - 1.0)) / GRID) * GRID


@compiled
def throw_layouts(rng, radius, spacing, tries, layouts):
    """Fill ``layouts`` (n, 6, 2) with random ones; how many there are after ``tries`` a layout."""
    tables = np.empty(TABLES)
    count = 0
    for _ in range(tries * len(layouts)):
        if _throw(rng, radius, spacing, layouts[count]) and tabulate(layouts[count], tables):
            count += 1
            if count == len(layouts):
                break
    return count


@compiled
def improve(rng, layouts, radius, spacing, ratio, work, patience):
    """Make the weakest of all pairs stronger, ``layouts`` (n, 6, 2) in place; the strength it has in the end.

    One of the weakest pair is moved, or thrown anew; the change is kept where all its pairs are stronger than the
    weakest was. Ends after ``work`` strengths, or ``patience`` changes in a row to a pair that did not help.
    """
    n = len(layouts)
    tables = np.empty((n, *TABLES))
    for i in range(n):
        tabulate(layouts[i], tables[i])
    new = np.empty((6, 2))
    new_tables = np.empty(TABLES)
    row = np.empty(n)
    found = np.zeros((n, n))  # strengths near the weakest; the others count as `limit`
    limit = weakest = 0.0
    first = second = failed = 0
    while work > 0 and failed < patience:
        if failed == 0:
            weakest, first, second = _weakest(found)
            if weakest >= 0.99 * limit:
                limit = _judge(layouts, tables, ratio, found)
                work -= n * (n + 1) // 2
                weakest, first, second = _weakest(found)
        work -= _TRY
        moved = first if rng.random() < 0.5 else second
        good = False
        if rng.random() < 0.1:
            for _ in range(_THROWS):
                work -= _TRY
                if _throw(rng, radius, spacing, new):
                    good = True
                    break
        else:
            _shift(rng, layouts[moved], radius, new)
            good = fits(new, radius, spacing)
        if not (good and tabulate(new, new_tables)):
            continue
        failed += 1
        for far in range(2):  # the nearest first: most changes fail there
            for k in range(n):
                if good and (found[moved, k] >= limit) == (far == 1):
                    work -= 1
                    if k == moved:
                        row[k] = strength(new, new_tables, new, new_tables, True, ratio, limit)
                    else:
                        row[k] = strength(new, new_tables, layouts[k], tables[k], False, ratio, limit)
                    good = row[k] > weakest
        if good:
            failed = 0
            layouts[moved] = new
            tables[moved] = new_tables
            for k in range(n):
                found[moved, k] = row[k]
                found[k, moved] = row[k]
    return _weakest(found)[0]


@compiled
def _weakest(found):
    """The least entry of a symmetric matrix, and where it is."""
    n = len(found)
    weakest, first, second = np.inf, 0, 0
    for i in range(n):
        for j in range(i + 1):
            if found[i, j] < weakest:
                weakest, first, second = found[i, j], i, j
    return weakest, first, second


@compiled
def _judge(layouts, tables, ratio, found):
    """Fill the matrix of strengths up to a limit a little above the weakest, which is returned."""
    n = len(layouts)
    limit = np.inf
    for i in range(n):
        for j in range(i + 1):
            found[i, j] = strength(layouts[i], tables[i], layouts[j], tables[j], i == j, ratio, limit)
            limit = min(limit, _SLACK * found[i, j])
    for i in range(n):
        for j in range(i + 1):
            found[i, j] = min(found[i, j], limit)
            found[j, i] = found[i, j]
    return limit
