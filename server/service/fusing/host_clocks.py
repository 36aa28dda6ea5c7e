"""Whether the clocks of cameras' hosts agree, from the reports themselves.

The least time from when a report went out, by its host's clock, to when it arrived, by this machine's, is the way's
least delay and how far the two clocks are apart. On a network that delay is a millisecond or few: what the least
times of two cameras differ by is how far their hosts' clocks are apart.
"""

import threading
from collections import deque
from itertools import combinations
from typing import NamedTuple

SECOND_NS = 1_000_000_000
KEPT_S = 10  # the newest seconds, of which the least counts
FEWEST = 10  # reports, before anything is said of a camera
MOST_APART_NS = 100_000_000  # frames farther apart than that are not joined
PART = 2  # of a frame period: clocks that are farther apart put frames together that are not


class Apart(NamedTuple):
    """The clock of ``ahead`` shows so much more than that of ``behind``, ns."""

    ahead: str
    behind: str
    by_ns: int


class HostClocks:
    """Safe to use from any thread; all times in ns."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._least: dict[str, deque[tuple[int, int]]] = {}  # by second, the least of it
        self._counts: dict[str, int] = {}

    def add(self, camera: str, published_ns: int, arrived_ns: int) -> None:
        """A report that went out then, by its host's clock, arrived then, by this machine's."""
        second, delay_ns = arrived_ns // SECOND_NS, arrived_ns - published_ns
        with self._lock:
            least = self._least.setdefault(camera, deque(maxlen=KEPT_S))
            self._counts[camera] = self._counts.get(camera, 0) + 1
            if least and least[-1][0] == second:
                least[-1] = (second, min(delay_ns, least[-1][1]))
            else:
                least.append((second, delay_ns))

    def forget(self, camera: str) -> None:
        """Its clock was set, or it is gone."""
        with self._lock:
            self._least.pop(camera, None)
            self._counts.pop(camera, None)

    def delays_ns(self) -> dict[str, int]:
        """The least of every camera's: below 0 its clock is ahead of this machine's."""
        with self._lock:
            return {camera: min(delay for _, delay in least) for camera, least in self._least.items()}

    def farthest(self) -> Apart | None:
        """The two cameras whose clocks are farthest apart, of those that have told enough."""
        with self._lock:
            known = {camera for camera, count in self._counts.items() if count >= FEWEST}
        delays = [(delay, camera) for camera, delay in self.delays_ns().items() if camera in known]
        if len(delays) < 2:
            return None
        (least, ahead), (most, behind) = min(delays), max(delays)
        return Apart(ahead, behind, most - least)

    def astray(self) -> dict[str, int]:
        """Cameras whose clocks are so far from most others' that their frames cannot be joined, and by how much they
        are ahead. Of two it is the one that is farther from this machine's.
        """
        delays = self.delays_ns()
        if not delays or max(delays.values()) - min(delays.values()) <= MOST_APART_NS:
            return {}
        near = dict.fromkeys(delays, 0)
        for a, b in combinations(delays, 2):
            if abs(delays[a] - delays[b]) <= MOST_APART_NS:
                near[a], near[b] = near[a] + 1, near[b] + 1
        middle = delays[min(delays, key=lambda camera: (-near[camera], abs(delays[camera])))]
        return {camera: middle - delay for camera, delay in delays.items() if abs(delay - middle) > MOST_APART_NS}


def told_apart(clocks: HostClocks, period_ns: float) -> list[str]:
    """What is wrong with the clocks, in sentences; ``period_ns`` is the least frame period of the cameras."""
    astray = clocks.astray()
    told = [
        f"the clock of {camera} shows {abs(by_ns) * 1e-9:.3g} s {'more' if by_ns > 0 else 'less'} than the others': "
        "nothing of it is joined; run chrony or PTP on all hosts; docs/many.md"
        for camera, by_ns in sorted(astray.items())
    ]
    apart = clocks.farthest()
    if not told and apart is not None and apart.by_ns > period_ns / PART:
        a, b = sorted((apart.ahead, apart.behind))
        told.append(
            f"clocks of {a} and {b} differ by {apart.by_ns * 1e-6:.0f} ms: run chrony or PTP on both; docs/many.md"
        )
    return told
