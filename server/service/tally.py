"""Who was found and who was not, and what the frames showed in which nobody was."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from asterism.protocol.messages import Fate
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.pose.solve import PoseEstimate
from asterism.server.service.misfit import Misfits

BRIGHT = 250  # grey levels: a pixel that is as good as saturated
ON_SURFACE = "ON_SURFACE"
STEP = 8  # every so many rows and columns are looked at for the share of saturated pixels


class Seen(NamedTuple):
    """What frames showed in which no robot was found, in the mean of a frame."""

    frames: int
    spots: Mapping[str, float]  # number by fate
    brightest: float  # grey levels
    saturated: float  # share of the pixels


@dataclass(slots=True)
class Blank:
    """Frames one after the other in which no robot was found; ``began_s`` of the first, by the tally's clock."""

    began_s: float
    newest: Frame
    frames: int = 0
    spots: Counter[str] = field(default_factory=Counter)
    brightest: float = 0.0
    saturated: float = 0.0

    def add(self, frame: Frame, result: FrameResult) -> None:
        """One more."""
        self.frames += 1
        self.newest = frame
        for fate, count in zip(*np.unique(result.blobs.fates, return_counts=True), strict=True):
            self.spots[Fate.Name(int(fate))] += int(count)
        self.brightest += float(frame.image.max())
        self.saturated += float((frame.image[::STEP, ::STEP] >= BRIGHT).mean())

    def seen(self) -> Seen:
        """The means."""
        n = self.frames
        return Seen(n, {name: count / n for name, count in self.spots.items()}, self.brightest / n, self.saturated / n)


@dataclass(slots=True)
class _Robot:
    states: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    standings: Counter[str] = field(default_factory=Counter)
    off: dict[str, str] = field(default_factory=dict)  # by standing, the newest reason


class Tally:
    """Counts frames and robots' states. Written by one thread, read by any. ``clock`` is monotonic, s."""

    def __init__(self, robots: Iterable[str], clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._lock = threading.Lock()
        self._robots = {robot: _Robot() for robot in robots}
        self._newest: dict[str, str] = {}
        self._times: deque[float] = deque(maxlen=2000)
        self.frames = 0
        self.blank: Blank | None = None  # the frames without a robot up to now, None where one is found
        self.frame: Frame | None = None  # the newest
        self._misfits = Misfits(self._robots)

    def add(self, frame: Frame, result: FrameResult) -> None:
        """Count one frame."""
        now = self.clock()
        found = any(isinstance(answer, PoseEstimate) for answer in result.answers.values())
        with self._lock:
            self.frames += 1
            self.frame = frame
            self._times.append(now)
            self._misfits.add(result)
            for robot, answer in result.answers.items():
                entry = self._robots[robot]
                self._newest[robot] = answer.state
                entry.states[answer.state] += 1
                if not isinstance(answer, PoseEstimate):
                    entry.reasons[answer.reason] += 1
                elif answer.surface is not None:
                    entry.standings[answer.surface.standing] += 1
                    entry.off[answer.surface.standing] = answer.surface.reason
            if found:
                self.blank = None
                return
            self.blank = self.blank or Blank(now, frame)
            self.blank.add(frame, result)

    def change_robots(self, robots: Iterable[str]) -> None:
        """From the next frame on the rig has these; what was counted of others stays."""
        ids = list(robots)
        with self._lock:
            self._robots |= {robot: _Robot() for robot in ids if robot not in self._robots}
            self._newest = {robot: state for robot, state in self._newest.items() if robot in ids}
            self._misfits = Misfits(ids)
            self.blank = None

    def rate_hz(self) -> float:
        """Frames in the last second."""
        with self._lock:
            while self._times and self._times[0] < self.clock() - 1.0:
                self._times.popleft()
            return float(len(self._times))

    def newest(self) -> dict[str, str]:
        """Every robot's state in the newest frame."""
        with self._lock:
            return dict(self._newest)

    def missing(self) -> list[str]:
        """The robots that were found in no frame."""
        with self._lock:
            return [
                robot
                for robot, entry in self._robots.items()
                if not (entry.states["TRACKED"] or entry.states["TILT_AMBIGUOUS"])
            ]

    def seen(self) -> tuple[Seen, Frame] | None:
        """What the newest frames showed, and the newest of them, if no robot was found in them."""
        with self._lock:
            return None if self.blank is None else (self.blank.seen(), self.blank.newest)

    def off(self, rig: Rig, said: set[str]) -> list[str]:
        """What to calibrate, for robots that are not among the ``said``, which they then are."""
        with self._lock:
            return self._misfits.told(rig, said)

    def lines(self) -> list[str]:
        """A line a robot: in how many frames it was in which state, and why most often it was not located."""
        with self._lock:
            width = max(map(len, self._robots))
            return [f"{robot:{width}}  {_told(entry)}" for robot, entry in self._robots.items()]


def _told(robot: _Robot) -> str:
    states = ("TRACKED", "TILT_AMBIGUOUS", "IDENTITY_AMBIGUOUS", "LOST")
    told = ", ".join(f"{robot.states[state]} {state}" for state in states if robot.states[state])
    if robot.reasons:
        told += f": {robot.reasons.most_common(1)[0][0]}"
    return told + _surface(robot)


def _surface(robot: _Robot) -> str:
    """How many poses rest on the surface, and how many not, with the newest reason of the most frequent kind."""
    if not robot.standings:
        return ""
    others = [(name, count) for name, count in robot.standings.most_common() if name != ON_SURFACE]
    told = f"; {robot.standings[ON_SURFACE]} rest on the surface"
    if not others:
        return told
    told += f", not {', '.join(f'{count} {name}' for name, count in others)}"
    reason = robot.off[others[0][0]]
    return f"{told}: {reason}" if reason else told
