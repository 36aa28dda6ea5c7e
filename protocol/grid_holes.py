"""Holes in a grid of heights: where there is no surface within it."""

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.surface import Heights


def holes_of(heights: Heights) -> list[str]:
    """A sentence on the places within a grid at which nothing is, if there are any: how many, the largest and where.

    What is open to the grid's rim is no hole but its outline.
    """
    missing = np.pad(~np.isfinite(heights.values), 1, constant_values=True)
    if missing.sum() == missing.size - heights.values.size:
        return []
    low, high, count = _parts(missing)
    inner = np.arange(1, len(count))  # the first is what surrounds the grid
    if not len(inner):
        return []
    size = (high - low + 2) * heights.step
    largest = int(inner[np.argmax(size[inner].prod(axis=1))])
    x, y = heights.origin + heights.step * (0.5 * (low[largest] + high[largest]) - 1.0)
    width, depth = 1e3 * size[largest]
    some = "a hole" if len(inner) == 1 else f"{len(inner)} holes, the largest"
    return [
        f"the surface has {some} of {width:.3g} x {depth:.3g} mm about x = {x:.4g}, y = {y:.4g} of its frame (m): "
        "there is no surface in it"
    ]


def _parts(missing: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Connected parts, the one at (0, 0) first: their first and last (k, 2) nodes and number of nodes (k,).

    Runs of nodes in every row are joined with those they touch in the row before. Source: Rosenfeld and Pfaltz,
    "Sequential operations in digital picture processing", 1966.
    """
    parent: list[int] = []
    runs: list[tuple[int, int, int]] = []  # row, first, behind the last

    def root(k: int) -> int:
        while parent[k] != k:
            parent[k] = parent[parent[k]]
            k = parent[k]
        return k

    before: list[int] = []
    for row, line in enumerate(missing):
        turns = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(np.int8), [0]])))
        now, at = [], 0
        for first, behind in zip(turns[::2].tolist(), turns[1::2].tolist(), strict=True):
            mine = len(runs)
            runs.append((row, first, behind))
            parent.append(mine)
            now.append(mine)
            while at < len(before) and runs[before[at]][2] <= first:
                at += 1
            k = at
            while k < len(before) and runs[before[k]][1] < behind:
                one, other = root(before[k]), root(mine)
                parent[max(one, other)] = min(one, other)
                k += 1
        before = now
    roots = np.array([root(k) for k in range(len(runs))])
    _, part = np.unique(roots, return_inverse=True)  # run 0 holds (0, 0)
    table = np.array(runs)
    count = int(part.max()) + 1
    low, high = np.full((count, 2), missing.size), np.full((count, 2), -1)
    np.minimum.at(low, part, table[:, :2])
    np.maximum.at(high, part, np.column_stack([table[:, 0], table[:, 2] - 1]))
    return low, high, np.bincount(part, table[:, 2] - table[:, 1]).astype(np.int64)
