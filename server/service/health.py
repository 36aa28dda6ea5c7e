"""The server's health: what the status message tells once a second."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import STATUS, Fate, Message
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.service.tally import Tally

WINDOW_NS = 1_000_000_000


class _Entry(NamedTuple):
    """What is kept of a frame for a second: when it went out by the monotonic clock, ns, how long it took, s."""

    out_ns: int
    solve_s: float
    latency_s: float
    rejected: Counter[str]


class Recent(NamedTuple):
    """The last second: frames a second; median and 99 % of what frames took, s; rejected spots by fate."""

    rate_hz: float
    solve_p50_s: float
    solve_p99_s: float
    latency_p50_s: float
    latency_p99_s: float
    rejected: Counter[str]


class Health:
    """Counts and times of the frames, written by the chain and read by the status thread; the lock keeps them whole.

    ``robots`` are the ids of the rig's. ``monotonic``, ns, tells which frames are of the last second: the wall clock
    may be set.
    """

    def __init__(
        self, camera: str, source: str, robots: Iterable[str], monotonic: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._camera = camera
        self._source = source
        self._monotonic = monotonic
        self._lock = threading.Lock()
        self._recent: deque[_Entry] = deque()
        self._rejected: Counter[str] = Counter()
        self._sequence = 0
        self.tally = Tally(robots)
        self.frames_dropped = 0
        self.frames_unreadable = 0
        self.frames_not_recorded = 0
        self.messages_not_recorded = 0
        self.problem = ""

    def add(self, frame: Frame, result: FrameResult, solved_ns: int, published_ns: int) -> None:
        """Count one frame; the times are of the frame's session."""
        fates = Counter(result.blobs.fates.tolist())
        rejected: Counter[str] = Counter()
        for fate, count in fates.items():
            if fate not in (Fate.LED, Fate.UNEXPLAINED):
                rejected[Fate.Name(fate)] = count
        solve_s = (solved_ns - frame.arrived_ns) * 1e-9
        latency_s = (published_ns - result.exposed_ns) * 1e-9
        self.tally.add(frame, result)
        with self._lock:
            self._rejected.update(rejected)
            self._recent.append(_Entry(self._monotonic(), solve_s, latency_s, rejected))
            self._forget()

    def _forget(self) -> None:
        """What is older than a second."""
        oldest = self._monotonic() - WINDOW_NS
        while self._recent and self._recent[0].out_ns < oldest:
            self._recent.popleft()

    def rejected(self) -> Counter[str]:
        """Spots rejected since the start, by fate."""
        with self._lock:
            return self._rejected.copy()

    def recent(self) -> Recent:
        """The last second."""
        with self._lock:
            self._forget()
            entries = list(self._recent)
        rejected: Counter[str] = Counter()
        for entry in entries:
            rejected.update(entry.rejected)
        solve = np.array([entry.solve_s for entry in entries] or [0.0])
        latency = np.array([entry.latency_s for entry in entries] or [0.0])
        return Recent(
            rate_hz=len(entries) * 1e9 / WINDOW_NS,
            solve_p50_s=float(np.median(solve)),
            solve_p99_s=float(np.percentile(solve, 99)),
            latency_p50_s=float(np.median(latency)),
            latency_p99_s=float(np.percentile(latency, 99)),
            rejected=rejected,
        )

    def message(self, now_ns: int, session: int = 0) -> Message:
        """The status message for the last second."""
        recent = self.recent()
        self._sequence += 1
        status = pb.Status(
            time_ns=now_ns,
            source=self._source,
            frames=self.tally.frames,
            frames_dropped=self.frames_dropped,
            frames_unreadable=self.frames_unreadable,
            frames_not_recorded=self.frames_not_recorded,
            **recent._asdict(),
            robots=Counter(self.tally.newest().values()) if recent.rate_hz else {},
            problem=self.problem,
            messages_not_recorded=self.messages_not_recorded,
            session=session,
        )
        return Message(keys.status(self._camera), STATUS, to_bytes(status), now_ns, now_ns, self._sequence)
