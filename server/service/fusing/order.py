"""Reports of several cameras in the order of their exposures: which are joined now, and which wait for what.

A report waits only for cameras that have one of the same or an earlier time under way, by their own pace, and no longer
than half a frame after it usually comes. Who is missed then is not waited for again before it is back.
"""

from collections import Counter, deque
from typing import Generic, NamedTuple, TypeVar

from asterism.server.service.fusing.pace import Pace

T = TypeVar("T")

MOST_WAIT_NS = 100_000_000  # who usually comes later than that after another is not waited for by it


class Waiting(NamedTuple, Generic[T]):
    """A report that has come; times in ns, the exposure's by the camera's clock, the arrival's by this machine's."""

    exposed_ns: int
    arrived_ns: int
    report: T


class Order(Generic[T]):
    """One thread feeds it with reports, each with its camera's name, and asks it what is due."""

    def __init__(self) -> None:
        self.late: Counter[str] = Counter()  # reports of exposures that had been passed already, by camera
        self.missed: Counter[str] = Counter()  # times that a camera was waited for in vain
        self.absent: set[str] = set()  # not waited for
        self._paces: dict[str, Pace] = {}
        self._pending: dict[str, deque[Waiting[T]]] = {}
        self._passed: dict[str, int] = {}  # the newest exposures that were handed out, by camera

    def add(self, camera: str, waiting: Waiting[T]) -> bool:
        """A report came; returns whether it is still of use: it is not where a later exposure is through."""
        pace = self._paces.setdefault(camera, Pace())
        exposed_ns = waiting.exposed_ns
        if pace.newest_ns is not None and exposed_ns <= pace.newest_ns:
            return False
        pace.add(exposed_ns, waiting.arrived_ns)
        self.absent.discard(camera)
        if exposed_ns <= max(self._passed.values(), default=0):
            self.late[camera] += 1
            return False
        self._pending.setdefault(camera, deque()).append(waiting)
        return True

    def forget(self, camera: str) -> None:
        """It has left, or begins anew: its times tell nothing of what comes."""
        self._paces.pop(camera, None)
        self._pending.pop(camera, None)
        self._passed.pop(camera, None)
        self.absent.discard(camera)

    def begin_anew(self) -> None:
        """Forget all times, as where stamps were gone by that were wrong; what was counted stays."""
        self._paces, self._pending, self._passed, self.absent = {}, {}, {}, set()

    def pace(self, camera: str) -> Pace | None:
        """How that camera's reports come."""
        return self._paces.get(camera)

    def due(self, now_ns: int) -> tuple[list[list[Waiting[T]]], int | None]:
        """The exposures to be joined now, in order, each with its reports; and when to look again, None where nothing
        waits.
        """
        ready: list[list[Waiting[T]]] = []
        while any(self._pending.values()):
            exposed_ns = min(reports[0].exposed_ns for reports in self._pending.values() if reports)
            until_ns = self._waits_until(exposed_ns, now_ns)
            if until_ns is not None:
                return ready, until_ns
            ready.append(self._taken(exposed_ns))
        return ready, None

    def _waits_until(self, exposed_ns: int, now_ns: int) -> int | None:
        """Until when reports of that exposure have to wait, None where they need not; who is overdue is missed."""
        came_ns = max(
            reports[0].arrived_ns
            for reports in self._pending.values()
            if reports and reports[0].exposed_ns == exposed_ns
        )
        until = []
        for camera, pace in self._paces.items():
            if camera in self.absent or self._pending.get(camera):
                continue
            expected = pace.under_way(exposed_ns)
            if expected is None or expected + pace.delay_ns - came_ns > MOST_WAIT_NS:
                continue
            latest = expected + pace.latest_ns
            if now_ns < latest:
                until.append(latest)
            else:
                self.absent.add(camera)
                self.missed[camera] += 1
        return min(until, default=None)

    def _taken(self, exposed_ns: int) -> list[Waiting[T]]:
        """All reports of an exposure, which is through with that."""
        cameras = [name for name, some in sorted(self._pending.items()) if some and some[0].exposed_ns == exposed_ns]
        self._passed |= dict.fromkeys(cameras, exposed_ns)
        return [self._pending[camera].popleft() for camera in cameras]
