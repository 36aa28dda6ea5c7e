"""Whether cameras' times agree, from the ways of robots that two of them see: along them a wrong time is a wrong place.

It needs robots on the move, and tells what the network cannot: also of hosts whose clocks agree, exposures may be
stamped wrongly (a camera's delay that its rig does not have).
"""

import math
import threading
from collections import deque
from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.two_digits import two_digits
from asterism.server.fusing.clocks import ClockFit, Way, clock_between

KEPT_S = 8.0  # the newest of every way
APART_NS = 30_000_000  # between positions that are kept
FEWEST = 60  # positions of a robot by both cameras
MOST_ROBOTS = 3  # of a pair of cameras
WITHIN_S = 0.1  # shifts that are tried
CLEARLY = 5.0  # standard deviations
VALID_NS = 20_000_000_000  # an estimate holds so long
POSITION = (0, 1, 2, 6, 7, 8, 12, 13, 14)  # of a covariance of six by six, row by row

_Place = tuple[int, tuple[float, float, float], list[float]]  # exposure, ns; m; covariance, nine numbers


class TimeApart(NamedTuple):
    """The times of ``second`` are ``offset_s`` more than those of ``first``; ``moved_m`` is what a robot makes of that
    on its way, ``sigma_m`` how well a camera knows where it is.
    """

    first: str
    second: str
    offset_s: float
    sigma_s: float
    moved_m: float
    sigma_m: float

    def matters(self, period_s: float) -> bool:
        """Whether it is sure, and poses suffer: from half a frame on, or as far as robots make a way of it."""
        off = abs(self.offset_s)
        return off > CLEARLY * self.sigma_s and (off > 0.5 * period_s or self.moved_m > self.sigma_m)


class Ways:
    """Safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._places: dict[tuple[str, str], deque[_Place]] = {}  # by camera and robot
        self._found: dict[tuple[str, str], tuple[int, TimeApart]] = {}
        self._turn = 0

    def add(self, camera: str, report: "pb.FrameReport") -> None:
        """What a camera says of where robots are."""
        exposed_ns = report.exposed_ns
        for robot in report.robots:
            if robot.state != pb.TRACKED:
                continue
            with self._lock:
                places = self._places.setdefault((camera, robot.id), deque(maxlen=int(KEPT_S * 1e9 / APART_NS)))
                if not places or exposed_ns - places[-1][0] >= APART_NS:
                    p, covariance = robot.pose.position, robot.covariance
                    places.append((exposed_ns, (p.x, p.y, p.z), [covariance[k] for k in POSITION]))

    def forget(self, camera: str) -> None:
        """Its times are of another session, or its rig is another one."""
        with self._lock:
            for key in [key for key in self._places if key[0] == camera]:
                del self._places[key]
            for pair in [pair for pair in self._found if camera in pair]:
                del self._found[pair]

    def look(self, now_ns: int) -> None:
        """Estimate for the next pair of cameras; now and then, it takes some 10 ms."""
        with self._lock:
            cameras = sorted({camera for camera, _ in self._places})
            pairs = list(combinations(cameras, 2))
            if not pairs:
                return
            self._turn = (self._turn + 1) % len(pairs)
            pair = pairs[self._turn]
            ways = list(self._ways(*pair))[:MOST_ROBOTS]
        fit = clock_between(ways, WITHIN_S) if ways else None
        found = None if fit is None else _apart(*pair, fit, ways)
        with self._lock:
            self._found = {one: told for one, told in self._found.items() if now_ns - told[0] < VALID_NS}
            if found is not None:
                self._found[pair] = now_ns, found

    def found(self) -> list[TimeApart]:
        """What is known of pairs of cameras."""
        with self._lock:
            return [told for _, told in self._found.values()]

    def _ways(self, first: str, second: str) -> Iterator[tuple[Way, Way]]:
        """Of robots that both cameras see, those with the longest ways first."""
        both = [
            (places, self._places[second, robot])
            for (camera, robot), places in self._places.items()
            if camera == first and (second, robot) in self._places
        ]
        for a, b in sorted(both, key=lambda pair: -min(map(len, pair))):
            if min(len(a), len(b)) >= FEWEST:
                start_ns = min(a[0][0], b[0][0])
                yield _way(a, start_ns), _way(b, start_ns)


def _way(places: deque[_Place], start_ns: int) -> Way:
    times, positions, covariances = zip(*places, strict=True)
    return Way(
        np.array([(time - start_ns) * 1e-9 for time in times]),
        np.array(positions),
        np.array(covariances).reshape(-1, 3, 3),
    )


def _apart(first: str, second: str, fit: ClockFit, ways: list[tuple[Way, Way]]) -> TimeApart:
    longest = max(ways, key=lambda pair: _length(pair[0]))[0]
    speed = _length(longest) / max(longest.times_s[-1] - longest.times_s[0], 1e-9)
    sigma_m = math.sqrt(float(np.median(np.trace(longest.covariances, axis1=1, axis2=2))) / 3.0)
    return TimeApart(first, second, fit.offset_s, fit.offset_sigma_s, abs(fit.offset_s) * speed, sigma_m)


def _length(way: Way) -> float:
    """Between its ends by every tenth position: noise makes no way."""
    return float(np.linalg.norm(np.diff(way.places[::10], axis=0), axis=1).sum())


def told_of_times(ways: Ways, period_s: float) -> list[str]:
    """What is wrong with the cameras' times, in sentences."""
    return [
        f"robots on the move show that the times of {one.first} and {one.second} differ by "
        f"{1e3 * abs(one.offset_s):.1f} ms ({two_digits(1e3 * one.moved_m)} mm of way): is chrony or PTP running on "
        "both hosts, is capture.delay_us right in both rigs? docs/many.md"
        for one in ways.found()
        if one.matters(period_s)
    ]
