"""How far apart constellations are: the criterion of `asterism.protocol.constellation`, fast enough to search with.

Separation of layout ``seen`` from ``taken``: over every labelling (720 with all six LEDs visible, 36 hidings times 120
orders with one hidden), the least norm, m, of what the best affine map of ``taken``'s LEDs leaves of ``seen``'s. It
depends on which of the two is seen, so both directions are asked for. Maps that mirror are a plate from behind, or
its image in a polished surface: they count where ``mirrors`` is asked for. A layout and itself: every labelling counts
but each LED in its own place.

The squared residual of the best affine map is a sum of squares along the affine dependencies of the points it maps
from, and these can be chosen so that the first rests on four of the points, the next on five, the last on all six.
So four labelled LEDs give a lower bound already, and most labellings end there. All lengths in m.
"""

import math

import numpy as np

from asterism.server.compiled import compiled

# Three sets of four LEDs (first four columns) and the two that may follow: every five LEDs occur exactly once.
_ORDERS = np.array([[0, 1, 2, 3, 4, 5], [0, 1, 4, 5, 2, 3], [2, 3, 4, 5, 0, 1]])
_FLAT = 1e-3  # LEDs whose spread in one direction is less than this of that in the other lie on one line
TABLES = (3, 4, 6)  # shape of a layout's tables: for each order the dependencies of four, five, five and six LEDs


@compiled
def _dependency(layout, leds, out):
    """The unit vector ``out`` (n,) that is orthogonal to 1, x and y of the ``leds`` (n,), and of all such vectors
    leans most on the last LED. False where the LEDs lie on one line.
    """
    n = len(leds)
    basis = np.empty((4, n))
    for k in range(n):
        basis[0, k] = 1.0
        basis[1, k] = layout[leds[k], 0]
        basis[2, k] = layout[leds[k], 1]
        basis[3, k] = 0.0
    basis[3, n - 1] = 1.0
    spread = 0.0
    for row in range(4):
        for earlier in range(row):
            dot = 0.0
            for k in range(n):
                dot += basis[row, k] * basis[earlier, k]
            for k in range(n):
                basis[row, k] -= dot * basis[earlier, k]
        square = 0.0
        for k in range(n):
            square += basis[row, k] ** 2
        length = math.sqrt(square)
        if row == 1:
            spread = length
        if row == 2 and not min(length, spread) > _FLAT * max(length, spread):
            return False
        if not length > 1e-9:
            return False
        for k in range(n):
            basis[row, k] /= length
    for k in range(n):
        out[k] = basis[3, k]
    return True


@compiled
def tabulate(layout, tables):
    """Fill the ``tables`` (TABLES) of a layout (6, 2). False where four of its LEDs that are needed lie on one line."""
    five = np.empty(5, np.int64)
    for number in range(3):
        order = _ORDERS[number]
        for k in range(4):
            five[k] = order[k]
        if not _dependency(layout, order[:4], tables[number, 0]):
            return False
        for last in range(2):
            five[4] = order[4 + last]
            if not _dependency(layout, five, tables[number, 1 + last]):
                return False
        if not _dependency(layout, order, tables[number, 3]):
            return False
    return True


@compiled
def _mirrored(seen, labels, taken, order, count):
    """Whether the best affine map of LEDs ``order`` of ``taken`` onto ``labels`` of ``seen`` mirrors."""
    x = y = 0.0
    for k in range(count):
        x += taken[order[k], 0]
        y += taken[order[k], 1]
    x /= count
    y /= count
    xx = xy = yx = yy = 0.0
    for k in range(count):
        u, v = taken[order[k], 0] - x, taken[order[k], 1] - y
        xx += seen[labels[k], 0] * u
        xy += seen[labels[k], 0] * v
        yx += seen[labels[k], 1] * u
        yy += seen[labels[k], 1] * v
    return xx * yy < xy * yx


@compiled
def nearest(seen, taken, tables, same, hidden, mirrors, limit):
    """The separation of layout ``seen`` (6, 2) from ``taken`` (6, 2), whose ``tables`` are given, or ``limit`` if it
    is at least that; with ``hidden`` (0 or 1) LEDs not visible. ``same``: both are one layout, and every LED in its
    own place is no confusion. ``mirrors``: maps that mirror count as well. One direction only: what is seen as
    ``seen`` would be taken for ``taken``.
    """
    best = limit * limit
    labels = np.empty(6, np.int64)
    fifth = np.empty(6, np.int64)  # the order with its last two exchanged
    for number in range(3 if hidden else 1):
        order = _ORDERS[number]
        for k in range(4):
            fifth[k] = order[k]
        fifth[4], fifth[5] = order[5], order[4]
        table = tables[number]
        w0, w1, w2, w3 = table[0, 0], table[0, 1], table[0, 2], table[0, 3]
        for a in range(6):
            for b in range(6):
                if b == a:
                    continue
                ab_x = w0 * seen[a, 0] + w1 * seen[b, 0]
                ab_y = w0 * seen[a, 1] + w1 * seen[b, 1]
                for c in range(6):
                    if c in (a, b):
                        continue
                    abc_x, abc_y = ab_x + w2 * seen[c, 0], ab_y + w2 * seen[c, 1]
                    for d in range(6):
                        if d in (a, b, c):
                            continue
                        four = (abc_x + w3 * seen[d, 0]) ** 2 + (abc_y + w3 * seen[d, 1]) ** 2
                        if four >= best:
                            continue
                        labels[0], labels[1], labels[2], labels[3] = a, b, c, d
                        for e in range(6):
                            if e in (a, b, c, d):
                                continue
                            labels[4], labels[5] = e, 15 - a - b - c - d - e
                            for last in range(2 if hidden else 1):
                                leds = fifth if last else order
                                total = four + _square(seen, labels, table[1 + last], 5)
                                if total >= best:
                                    continue
                                count = 5
                                if not hidden:
                                    total += _square(seen, labels, table[3], 6)
                                    count = 6
                                if total >= best or (same and _in_place(labels, leds, count)):
                                    continue
                                if mirrors or not _mirrored(seen, labels, taken, leds, count):
                                    best = total
    return math.sqrt(best)


@compiled
def _square(seen, labels, weights, count):
    x = y = 0.0
    for k in range(count):
        x += weights[k] * seen[labels[k], 0]
        y += weights[k] * seen[labels[k], 1]
    return x * x + y * y


@compiled
def _in_place(labels, leds, count):
    kept = 0
    for k in range(count):
        kept += int(labels[k] == leds[k])
    return kept == count


@compiled
def strength(one, one_tables, other, other_tables, same, ratio, limit):
    """The lesser of the separation with one LED hidden and ``1 / ratio`` of that with all visible, in both
    directions, mirror images included; or ``limit`` if it is at least that.
    """
    best = nearest(one, other, other_tables, same, 1, True, limit)
    if not same:
        best = nearest(other, one, one_tables, same, 1, True, best)
    best = nearest(one, other, other_tables, same, 0, True, best * ratio) / ratio
    if not same:
        best = nearest(other, one, one_tables, same, 0, True, best * ratio) / ratio
    return best


@compiled
def separations(layouts, hidden, mirrors):
    """The separations (n, n) of all layouts (n, 6, 2): row what is seen, column what it would be taken for.

    Of every layout's LEDs no four may lie on one line (`tabulate` says whether they do).
    """
    n = len(layouts)
    tables = np.empty((n, *TABLES))
    found = np.empty((n, n))
    for i in range(n):
        tabulate(layouts[i], tables[i])
    for i in range(n):
        for j in range(n):
            found[i, j] = nearest(layouts[i], layouts[j], tables[j], i == j, hidden, mirrors, np.inf)
    return found
