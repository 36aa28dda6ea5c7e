"""What one of several recordings added to a map."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from asterism.server.coverage.visits import CoverageMap


@dataclass(frozen=True, slots=True)
class Added:
    """By the recording ``name``, from its first frame to its last, ``since_ns`` to ``until_ns``: the area that no tool
    was over before, ``new_m2``, and all that tools were over, ``over_m2``; ``counted`` poses over ``counted_s`` of
    time, and how many were ``left_out``.
    """

    name: str
    since_ns: int
    until_ns: int
    new_m2: float
    over_m2: float
    counted: int
    counted_s: float
    left_out: int


def added_by(name: str, since_ns: int, until_ns: int, before: CoverageMap, after: CoverageMap) -> Added:
    """From the map ``before`` the recording and the one ``after`` it, whose grid holds the other's."""
    earlier = before.reaching(after.grid.box).together
    later, areas = after.together, after.grid.areas
    new = later.visited & ~earlier.visited
    over = later.dwell_s > earlier.dwell_s
    left_out = Counter(later.left_out)
    left_out.subtract(earlier.left_out)
    return Added(
        name,
        since_ns,
        until_ns,
        float(areas[new].sum()),
        float(np.where(over, areas, 0.0).sum()),
        later.counted - earlier.counted,
        later.counted_s - earlier.counted_s,
        sum(left_out.values()),
    )
