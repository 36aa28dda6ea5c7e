"""Where tools have been, told once a second while it serves: the chain hands its reports over, the rest happens beside
it.
"""

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import COVERAGE, FRAME_REPORT, Message
from asterism.protocol.rig import Rig
from asterism.server.coverage.accumulate import Coverage
from asterism.server.coverage.grid import pitch_for
from asterism.server.coverage.message import told
from asterism.server.coverage.told import by_robot, told_in
from asterism.server.coverage.visits import CoverageMap
from asterism.server.coverage.working import Working, same_surface, working

FINEST, MOST_PATCHES = 4.0, 20_000  # coarser than out of recordings: all patches of all robots go out every ten seconds
WHOLE_EVERY = 10  # messages
_MOST_WAITING = 2000  # reports: of whoever does not look


class Covering:
    """What a server knows of where tools have been since it began, or since its rig had another surface."""

    def __init__(self, rig: Rig) -> None:
        self._camera = rig.camera.name
        self._lock = threading.Lock()
        self._waiting: list[Message] = []
        self._working: Working | None = None
        self._coverage: Coverage | None = None
        self._told: CoverageMap | None = None
        self._messages = 0
        self._period_s = 0.0
        self.take_rig(rig)

    def take_rig(self, rig: Rig) -> None:
        """Another rig is in force: the map goes on where surface and tools are the same, else it begins anew."""
        found = working(rig)
        with self._lock:
            before, self._working = self._working, found
            if before is None or found is None or not _goes_on(before, found):
                self._coverage, self._told, self._waiting = None, None, []

    def add(self, messages: list[Message]) -> None:
        """From the chain: what was published of a frame. It is only kept."""
        if self._working is not None:
            with self._lock:
                if len(self._waiting) < _MOST_WAITING:
                    self._waiting += [message for message in messages if message.kind is FRAME_REPORT]

    def look(self, session: int, breathe: Callable[[], None]) -> list[Message]:
        """Once a second: the message of what has come since, none before the first; ``breathe`` lets frames go by."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
            works, coverage, before = self._working, self._coverage, self._told
        if works is None or (not waiting and coverage is None):
            return []
        coverage = coverage or _nothing(works)
        if waiting:
            coverage = self._added(coverage, works, waiting, breathe)
        whole = self._messages % WHOLE_EVERY == 0
        told_now = told(coverage.map, None if whole else before, session)
        with self._lock:
            if works is not self._working:
                return []
            self._coverage, self._told = coverage, coverage.map
        self._messages += 1
        at = coverage.map.until_ns
        return [Message(keys.coverage(self._camera), COVERAGE, to_bytes(told_now), at, at, 0)]

    def _added(
        self, coverage: Coverage, works: Working, waiting: list[Message], breathe: Callable[[], None]
    ) -> Coverage:
        lengths = np.cumsum([0, *(len(message.payload) for message in waiting)])
        data = np.array(np.frombuffer(b"".join(message.payload for message in waiting), np.uint8))
        spans = np.column_stack([lengths[:-1], lengths[1:]])
        columns = told_in(data, spans, works.looked, Path(keys.frame(self._camera)))
        steps = np.diff(columns.times_ns)
        if (steps > 0).any():
            self._period_s = float(np.median(steps[steps > 0])) * 1e-9
        for robot, each in by_robot(columns, works.looked).items():
            breathe()
            coverage = coverage.add({robot: each}, self._period_s)
        return coverage


def _nothing(works: Working) -> Coverage:
    pitch = pitch_for(works.surface, works.least_radius_m, FINEST, MOST_PATCHES)
    return Coverage.none(works.surface, works.tools, pitch, MOST_PATCHES)


def _goes_on(before: Working, after: Working) -> bool:
    radii = [{robot: tool.radius_m for robot, tool in each.tools.items()} for each in (before, after)]
    return same_surface(before.surface, after.surface) and radii[0] == radii[1]
