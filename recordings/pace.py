"""How fast a recording grows, and how long its disk will last."""

import math
from collections import deque
from typing import NamedTuple

WINDOW_S = 10.0  # files grow by chunks: over that long the rate is steady
FIRST_S = 3.0  # and known after that long


class Pace(NamedTuple):
    """``bytes_per_s`` that a recording grows by, and in how many seconds the disk is full (inf: never)."""

    bytes_per_s: float
    seconds_left: float


class Growth:
    """Follows how much was written; times are of a monotonic clock, s."""

    def __init__(self) -> None:
        self._written: deque[tuple[float, int]] = deque()

    def pace(self, now_s: float, written: int, free: int) -> Pace | None:
        """The pace over the last seconds, once it is known; ``written`` bytes so far, ``free`` bytes on the disk."""
        self._written.append((now_s, written))
        while len(self._written) > 2 and self._written[1][0] <= now_s - WINDOW_S:
            self._written.popleft()
        began_s, before = self._written[0]
        if now_s - began_s < FIRST_S:
            return None
        rate = (written - before) / (now_s - began_s)
        return Pace(rate, free / rate if rate > 0 else math.inf)
