"""The server's health: what the status message tells once a second."""

import threading
from collections import Counter, deque
from collections.abc import Iterable

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import STATUS, Fate, Message
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.service.tally import Tally

WINDOW_NS = 1_000_000_000


class Health:
    """Counts and times of the frames, written by the chain and read by the status thread; the lock keeps them whole.

    ``robots`` are the ids of the rig's.
    """

    def __init__(self, camera: str, source: str, robots: Iterable[str]) -> None:
        self._camera = camera
        self._source = source
        self._lock = threading.Lock()
        self._recent: deque[tuple[int, float, float, Counter[str]]] = deque()
        self._sequence = 0
        self.tally = Tally(robots)
        self.frames_dropped = 0
        self.frames_unreadable = 0
        self.frames_not_recorded = 0
        self.messages_not_recorded = 0
        self.problem = ""

    def add(self, frame: Frame, result: FrameResult, solved_ns: int, published_ns: int) -> None:
        """Count one frame."""
        fates = Counter(result.blobs.fates.tolist())
        rejected: Counter[str] = Counter()
        for fate, count in fates.items():
            if fate not in (Fate.LED, Fate.UNEXPLAINED):
                rejected[Fate.Name(fate)] = count
        entry = (
            published_ns,
            (solved_ns - frame.arrived_ns) * 1e-9,
            (published_ns - result.exposed_ns) * 1e-9,
            rejected,
        )
        self.tally.add(frame, result)
        with self._lock:
            self._recent.append(entry)

    def message(self, now_ns: int, session: int = 0) -> Message:
        """The status message for the last second."""
        with self._lock:
            while self._recent and self._recent[0][0] < now_ns - WINDOW_NS:
                self._recent.popleft()
            recent = list(self._recent)
            self._sequence += 1
            sequence = self._sequence
        rejected: Counter[str] = Counter()
        for entry in recent:
            rejected.update(entry[3])
        solve = np.array([entry[1] for entry in recent] or [0.0])
        latency = np.array([entry[2] for entry in recent] or [0.0])
        status = pb.Status(
            time_ns=now_ns,
            source=self._source,
            frames=self.tally.frames,
            frames_dropped=self.frames_dropped,
            frames_unreadable=self.frames_unreadable,
            frames_not_recorded=self.frames_not_recorded,
            rate_hz=len(recent) * 1e9 / WINDOW_NS,
            solve_p50_s=float(np.median(solve)),
            solve_p99_s=float(np.percentile(solve, 99)),
            latency_p50_s=float(np.median(latency)),
            latency_p99_s=float(np.percentile(latency, 99)),
            rejected=dict(rejected),
            robots=Counter(self.tally.newest().values()) if recent else {},
            problem=self.problem,
            messages_not_recorded=self.messages_not_recorded,
            session=session,
        )
        return Message(keys.status(self._camera), STATUS, to_bytes(status), now_ns, now_ns, sequence)
