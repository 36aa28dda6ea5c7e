"""How one camera's reports come: its period, and how long after the exposure they usually arrive."""

from collections import deque
from collections.abc import Sequence

INTERVALS = 15  # the newest, whose middle one is the period
DELAYS = 61  # the newest, whose middle one is usual
FEWEST = 3  # intervals, before anything is expected
UNEVEN = 3  # times the usual unevenness of the exposures: by so much a next one may be early
LEAST_UNEVEN_NS = 100_000
MOST_UNEVEN = 4  # part of a period
MOST_AHEAD = 8  # periods: after so many without a report nothing is expected any more


class Pace:
    """Of one session: all times are ns, exposures by the camera's clock, arrivals by this machine's.

    ``period_ns`` is from one exposure to the next; ``delay_ns`` from an exposure to its report, usually, with how far
    the two clocks are apart in it.
    """

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        self.period_ns = 0
        self.delay_ns = 0
        self._uneven_ns = 0
        self._intervals: deque[int] = deque(maxlen=INTERVALS)
        self._delays: deque[int] = deque(maxlen=DELAYS)

    def add(self, exposed_ns: int, arrived_ns: int) -> None:
        """A report came, newer than all before."""
        if self.newest_ns is not None:
            self._intervals.append(exposed_ns - self.newest_ns)
            self.period_ns = _middle(self._intervals)
            off = _middle([abs(interval - self.period_ns) for interval in self._intervals])
            self._uneven_ns = min(max(UNEVEN * off, LEAST_UNEVEN_NS), self.period_ns // MOST_UNEVEN)
        self.newest_ns = exposed_ns
        self._delays.append(arrived_ns - exposed_ns)
        self.delay_ns = _middle(self._delays)

    @property
    def known(self) -> bool:
        """Whether enough have come to expect the next."""
        return len(self._intervals) >= FEWEST

    @property
    def latest_ns(self) -> int:
        """From an exposure to when its report is waited for no longer."""
        return self.delay_ns + self.period_ns // 2

    def under_way(self, exposed_ns: int) -> int | None:
        """The newest exposure up to that time, or as near to it as exposures are uneven, of which the report has not
        come; None where there is none, or nothing is expected.
        """
        if self.newest_ns is None or not self.known:
            return None
        passed = (exposed_ns + self._uneven_ns - self.newest_ns) // self.period_ns
        return self.newest_ns + passed * self.period_ns if 1 <= passed <= MOST_AHEAD else None


def _middle(numbers: Sequence[int] | deque[int]) -> int:
    return sorted(numbers)[len(numbers) // 2]
