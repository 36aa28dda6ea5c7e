"""A camera's own clock on the host's: by the least delay seen, with the rate at which the two run apart.

A frame is here some time after its stamp, never before: the least of these delays is the nearest to the truth. It is
looked for in each second of the last minute; the line below all of them whose edge lies under their middle (the convex
hull of Moon, Skelly, Towsley 1999 and Zhang, Liu, Xia 2002) tells how fast the clocks run apart. What of the delay is
always there cannot be seen from frames; where the camera can be asked for its time it is told by that.
"""

from itertools import pairwise
from typing import NamedTuple

BLOCK_NS = 1_000_000_000
BLOCKS = 60
FASTEST = 3e-4  # that clocks of quartz run apart
JUMP_NS = 20_000_000  # nearer is a delay that was, or was not, there
LATE_NS = 1_000_000_000  # that no frame ever is
TRUSTED_NS = 10_000_000_000  # of this length the edge is half believed: over a short time chance tilts it
SETTLED = 5  # blocks after which it is known what of the delay is always there


class _Least(NamedTuple):
    """The least delay of a second, in which the camera's clock stood at, both since the beginning."""

    at_ns: int
    delay_ns: int


class CameraClock:
    """One for each time a camera is opened.

    ``asked`` is a pair of times of the same moment, the camera's and the host's monotonic, ns, where the camera could
    be asked for its time.
    """

    def __init__(self, asked: tuple[int, int] | None = None) -> None:
        self._asked = asked
        self._always_ns = 0.0  # of the delay
        self.begun = 0  # times: more than once where the camera's clock was set, or the camera began anew
        self._blocks: list[_Least] = []

    def host_ns(self, camera_ns: int, arrived_ns: int) -> int:
        """A stamp of the camera on the host's monotonic clock; ``arrived_ns`` is when its frame began to arrive."""
        if not self._blocks or self._was_set(camera_ns, arrived_ns):
            self._begin(camera_ns, arrived_ns)
        self._see(camera_ns, arrived_ns)
        at_ns = camera_ns - self._camera_0
        return camera_ns + self._apart_0 + round(self._line(at_ns) - self._always_ns)

    def _begin(self, camera_ns: int, arrived_ns: int) -> None:
        self.begun += 1
        self._camera_0, self._apart_0 = camera_ns, arrived_ns - camera_ns
        self._newest_ns = -1
        self._block = 0
        self._blocks = [_Least(0, 0)]
        self._level, self._slope = 0.0, 0.0
        if self.begun > 1:
            self._asked = None  # it told of the clock before

    def _was_set(self, camera_ns: int, arrived_ns: int) -> bool:
        at_ns, delay_ns = self._since(camera_ns, arrived_ns)
        above_ns = delay_ns - self._line(at_ns)
        if at_ns <= self._newest_ns or above_ns < -JUMP_NS or above_ns > LATE_NS:
            return True
        # One frame may be late; all of a second are not.
        newest = self._blocks[-1]
        over = at_ns // BLOCK_NS > self._block
        return over and len(self._blocks) > 1 and newest.delay_ns - self._line(newest.at_ns) > JUMP_NS

    def _see(self, camera_ns: int, arrived_ns: int) -> None:
        at_ns, delay_ns = self._since(camera_ns, arrived_ns)
        self._newest_ns = at_ns
        if at_ns // BLOCK_NS > self._block:
            self._block = at_ns // BLOCK_NS
            self._blocks = [*self._blocks[1 - BLOCKS :], _Least(at_ns, delay_ns)]
        elif delay_ns < self._blocks[-1].delay_ns:
            self._blocks[-1] = _Least(at_ns, delay_ns)
        else:
            return
        self._fit()

    def _since(self, camera_ns: int, arrived_ns: int) -> tuple[int, int]:
        return camera_ns - self._camera_0, arrived_ns - camera_ns - self._apart_0

    def _line(self, at_ns: int) -> float:
        return self._level + self._slope * at_ns

    def _fit(self) -> None:
        long_ns = self._blocks[-1].at_ns - self._blocks[0].at_ns
        belief = long_ns**2 / (long_ns**2 + TRUSTED_NS**2)
        self._slope = belief * min(max(_slope(self._blocks), -FASTEST), FASTEST)
        self._level = min(least.delay_ns - self._slope * least.at_ns for least in self._blocks)
        if self._asked is not None and len(self._blocks) <= SETTLED:
            asked_camera_ns, asked_host_ns = self._asked
            at_ns, delay_ns = self._since(asked_camera_ns, asked_host_ns)
            self._always_ns = max(self._line(at_ns) - delay_ns, 0.0)


def _slope(blocks: list[_Least]) -> float:
    """Of the edge of the lower convex hull that lies under the middle of the blocks' times."""
    hull: list[_Least] = []
    for point in blocks:
        while len(hull) > 1 and _is_above(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    middle = (blocks[0].at_ns + blocks[-1].at_ns) / 2
    for left, right in pairwise(hull):
        if right.at_ns >= middle and right.at_ns > left.at_ns:
            return (right.delay_ns - left.delay_ns) / (right.at_ns - left.at_ns)
    return 0.0


def _is_above(left: _Least, point: _Least, right: _Least) -> bool:
    """Whether the middle one of three lies on or above the line through its neighbours."""
    run, rise = right.at_ns - left.at_ns, right.delay_ns - left.delay_ns
    return (point.delay_ns - left.delay_ns) * run >= rise * (point.at_ns - left.at_ns)
