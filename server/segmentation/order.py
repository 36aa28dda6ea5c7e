"""Sorting in kernels: numba's own np.argsort takes seconds to compile for every kind of array."""

import numpy as np

from asterism.server.compiled import compiled


@compiled
def ascending(values):
    """The order (n,) in which ``values`` (n,) ascend; equal ones stay as they stand (a merge sort from the bottom)."""
    n = values.shape[0]
    order, merged = np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        order[i] = i
    size = 1
    while size < n:
        for start in range(0, n, 2 * size):
            middle, end = min(start + size, n), min(start + 2 * size, n)
            left, right = start, middle
            for place in range(start, end):
                if left < middle and (right == end or not values[order[right]] < values[order[left]]):
                    merged[place] = order[left]
                    left += 1
                else:
                    merged[place] = order[right]
                    right += 1
        order, merged = merged, order
        size *= 2
    return order
