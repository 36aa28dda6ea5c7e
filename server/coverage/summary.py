"""What is told of a map, ready to be written and drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from asterism.server.coverage.added import Added
from asterism.server.coverage.regions import Regions, gaps_of, overworked_of
from asterism.server.coverage.visits import CoverageMap, Visits

_CLOCK_NS = 10**17  # times below are not those of a clock, but of a film that counts from 0


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """A map ``covered`` of the rig of camera ``camera``, out of recordings that ``added`` to it one after the other;
    its ``gaps``, where tools were for less than ``least_s`` in all, and what is ``overworked``; ``whole``: all robots
    together.
    """

    camera: str
    covered: CoverageMap
    added: tuple[Added, ...]
    least_s: float
    gaps: Regions
    overworked: Regions
    whole: Visits

    @staticmethod
    def of(camera: str, covered: CoverageMap, added: Sequence[Added], least_s: float = 0.0) -> "Summary":
        """Of a map."""
        gaps, overworked = gaps_of(covered, least_s), overworked_of(covered)
        return Summary(camera, covered, tuple(added), least_s, gaps, overworked, covered.together)

    @property
    def visited_m2(self) -> float:
        """Of the surface, by any tool."""
        return visited_m2(self.covered, self.whole)


def visited_m2(covered: CoverageMap, visits: Visits) -> float:
    """Area of the surface that a tool was over."""
    return float(covered.grid.areas[visits.visited].sum())


def mean_speed(visits: Visits) -> float:
    """Of a tool over all that it visited, m/s; nan where it visited nothing."""
    dwell = float(visits.dwell_s.sum())
    return float(visits.path_m.sum()) / dwell if dwell else float("nan")


def when(time_ns: int) -> str:
    """A time for people: the date and time in UTC, or seconds from a film's beginning; `never` for 0."""
    if time_ns == 0:
        return "never"
    if time_ns < _CLOCK_NS:
        return f"{time_ns * 1e-9:.2f} s"
    return f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S} UTC"


def began(time_ns: int) -> str:
    """The same of a beginning: films count from 0."""
    return when(time_ns) if time_ns else "0 s"


def area(m2: float) -> str:
    """For people."""
    return f"{m2:.3f} m²" if m2 >= 0.1 else f"{m2 * 1e4:.1f} cm²"


def time(seconds: float) -> str:
    """For people."""
    if seconds < 60.0:
        return f"{seconds:.3g} s"
    minutes = round(seconds / 60.0)
    return f"{seconds / 60.0:.1f} min" if seconds < 3600.0 else f"{minutes // 60} h {minutes % 60:02d} min"
