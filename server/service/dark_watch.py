"""Whether an LED of one robot has gone dark: not seen at place after place, and was seen before.

Something may stand before an LED as long as its robot stands still, so that is said only of one that moves about, or of
a constellation that is a reference and is to be seen whole.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.pose.fit import LEDS
from asterism.server.service.alarm import Finding

BLOCKS = 45  # seconds in which the robot was seen, and an LED of it was not
SPREAD_PX = 60.0  # over so much of the image, along both ways together
SEEN = 0.02  # share of frames up to which an LED is not
OTHERS = 0.7  # share of frames in which the others are, on average
BEFORE = 0.5  # and it was, before


class DarkWatch:
    """One robot's LEDs; ``fixed``: it never moves."""

    def __init__(self, robot: str, fixed: bool) -> None:
        self._robot = robot
        self._fixed = fixed
        self._blocks: deque[tuple[int, Floats, Floats]] = deque(maxlen=BLOCKS)
        self._seen, self._count = np.zeros(LEDS), np.zeros(LEDS)  # before those blocks
        self._last_ns = np.zeros(LEDS, np.int64)  # when each was seen last

    def add(self, time_ns: int, lit: NDArray[np.bool_], middle: Floats) -> None:
        """One more second: the LEDs ``lit`` (n, 6) in its frames; ``middle`` (2,) px of the robot."""
        if len(self._blocks) == BLOCKS:
            # Being dark does not make it usual.
            counted = ~self._missing()
            self._seen += counted * self._blocks[0][1]
            self._count += counted
        share = lit.mean(axis=0)
        self._last_ns[share > SEEN] = time_ns
        self._blocks.append((time_ns, share, middle))

    def finding(self) -> Finding | None:
        """The LED that is dark, if one is."""
        if len(self._blocks) < BLOCKS:
            return None
        missing = self._missing()
        shares = np.array([share for _, share, _ in self._blocks])
        if not missing.any() or missing.all() or shares[:, ~missing].mean() < OTHERS:
            return None
        spread = np.ptp(np.array([middle for _, _, middle in self._blocks]), axis=0).sum()
        if not self._fixed and spread < SPREAD_PX:
            return None
        led, last_ns = int(np.flatnonzero(missing)[0]), 0
        if self._last_ns[led]:
            last_ns = int(self._last_ns[led])
            if self._seen[led] < BEFORE * self._count[led]:
                return None  # something hides it often
        return Finding(
            f"dark {led}",
            f"{self._robot}: LED {led} is not seen",
            "is it dark" + (", or is something in front of it?" if self._fixed else "?"),
            last_ns or self._blocks[0][0],
        )

    def _missing(self) -> NDArray[np.bool_]:
        """Which LEDs (6,) are seen in none of the blocks."""
        missing: NDArray[np.bool_] = np.array([share for _, share, _ in self._blocks]).max(axis=0) <= SEEN
        return missing
