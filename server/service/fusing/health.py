"""How fusing does: rates, latencies, robots' states, who contradicts whom. Written by the loop, read by the status."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import STATUS, Message
from asterism.server.fusing.fused import Fused, FusedPose

WINDOW_NS = 1_000_000_000
FEW = 4  # robots that are named in a sentence
SHARE = 0.2  # of the exposures of a robot in the last second: who is left out of more contradicts


class _Entry(NamedTuple):
    out_ns: int
    solve_s: float
    latency_s: float
    located: tuple[str, ...]
    left_out: tuple[tuple[str, str, str], ...]  # camera, robot, why


class FusedHealth:
    """Counts; ``monotonic``, ns, tells which exposures are of the last second."""

    def __init__(self, monotonic: Callable[[], int] = time.monotonic_ns) -> None:
        self._monotonic = monotonic
        self._lock = threading.Lock()
        self._recent: deque[_Entry] = deque()
        self._newest: dict[str, str] = {}
        self._states: dict[str, Counter[str]] = {}
        self._reasons: dict[str, Counter[str]] = {}
        self._sequence = 0
        self.exposures = 0
        self.behind = 0  # exposures that were passed over, because newer ones were there already
        self.late = 0  # reports that came after later ones had been joined
        self.problem = ""

    def add(self, fused: Fused, solve_s: float, latency_s: float) -> None:
        """An exposure went out: so long after its last report came, and after it was exposed."""
        poses = [(robot, answer) for robot, answer in fused.answers.items() if isinstance(answer, FusedPose)]
        left_out = tuple((camera, robot, why) for robot, pose in poses for camera, why in pose.left_out.items())
        entry = _Entry(self._monotonic(), solve_s, latency_s, tuple(robot for robot, _ in poses), left_out)
        with self._lock:
            self.exposures += 1
            self._recent.append(entry)
            self._forget()
            self._newest = {robot: answer.state for robot, answer in fused.answers.items()}
            for robot, answer in fused.answers.items():
                self._states.setdefault(robot, Counter())[answer.state] += 1
                if not isinstance(answer, FusedPose):
                    self._reasons.setdefault(robot, Counter())[answer.reason] += 1

    def newest(self) -> Mapping[str, str]:
        """Every robot's state in the newest exposure."""
        with self._lock:
            return dict(self._newest)

    def rate_hz(self) -> float:
        """Exposures of the last second."""
        with self._lock:
            self._forget()
            return float(len(self._recent))

    def contradictions(self) -> list[str]:
        """Cameras that were left out in the last second, of which robots, and how far they were off."""
        with self._lock:
            self._forget()
            entries = list(self._recent)
        located = Counter(robot for entry in entries for robot in entry.located)
        counts = Counter((camera, robot) for entry in entries for camera, robot, _ in entry.left_out)
        newest = {(camera, robot): why for entry in entries for camera, robot, why in entry.left_out}
        told: dict[str, list[str]] = {}
        for (camera, robot), count in sorted(counts.items()):
            if count > SHARE * located[robot]:
                told.setdefault(camera, []).append(robot)
        return [
            f"camera '{camera}' contradicts the others and is left out for {_few(robots)}: {robots[0]}: "
            f"{newest[camera, robots[0]]}"
            for camera, robots in told.items()
        ]

    def lines(self) -> list[str]:
        """A line a robot: in how many exposures it was in which state, and why most often it was not located."""
        with self._lock:
            width = max(map(len, self._states), default=0)
            return [f"{robot:{width}}  {self._line(robot)}" for robot in sorted(self._states)]

    def _line(self, robot: str) -> str:
        states, reasons = self._states[robot], self._reasons.get(robot)
        told = ", ".join(f"{count} {state}" for state, count in states.most_common())
        return told if not reasons else f"{told}: {reasons.most_common(1)[0][0]}"

    def message(self, source: str, now_ns: int, session: int) -> Message:
        """The status of the last second; ``source`` names the cameras."""
        with self._lock:
            self._forget()
            entries, newest = list(self._recent), Counter(self._newest.values())
            self._sequence += 1
        solve = np.array([entry.solve_s for entry in entries] or [0.0])
        latency = np.array([entry.latency_s for entry in entries] or [0.0])
        status = pb.Status(
            time_ns=now_ns,
            source=source,
            frames=self.exposures,
            frames_dropped=self.late + self.behind,
            rate_hz=len(entries) * 1e9 / WINDOW_NS,
            solve_p50_s=float(np.median(solve)),
            solve_p99_s=float(np.percentile(solve, 99)),
            latency_p50_s=float(np.median(latency)),
            latency_p99_s=float(np.percentile(latency, 99)),
            robots=newest if entries else {},
            problem=self.problem,
            session=session,
        )
        return Message(keys.status(keys.FUSED), STATUS, to_bytes(status), now_ns, now_ns, self._sequence)

    def _forget(self) -> None:
        oldest = self._monotonic() - WINDOW_NS
        while self._recent and self._recent[0].out_ns < oldest:
            self._recent.popleft()


def _few(robots: list[str]) -> str:
    """The first of them by name, how many the others are."""
    more = len(robots) - FEW
    return ", ".join(robots[:FEW]) + (f" and {more} more" if more > 0 else "")
