"""A camera that is followed (`world: {follow: true}`): that it was kicked, that nothing to follow it by is in sight."""

from collections import deque
from collections.abc import Callable

import numpy as np

from asterism.server.chain.frame import FrameResult
from asterism.server.service.alarm import clock_text

QUIET_NS = 10_000_000_000  # a camera that shakes hard is not said more often
UNSEEN_NS = 5_000_000_000


class PlaceWatch:
    """`add` is for the loop, all else for one other thread."""

    def __init__(self) -> None:
        self._kicks: deque[FrameResult] = deque(maxlen=100)
        self._newest: FrameResult | None = None
        self._said_ns = 0
        self._unseen = False
        self.problem = ""

    def add(self, result: FrameResult) -> None:
        """Count one frame in."""
        self._newest = result
        if result.place is not None and result.place.kick is not None:
            self._kicks.append(result)

    def look(self, say: Callable[[str], None]) -> None:
        """Say what happened since the last look."""
        while self._kicks:
            result = self._kicks.popleft()
            if result.exposed_ns - self._said_ns < QUIET_NS or result.place is None or result.place.kick is None:
                continue
            self._said_ns, kick = result.exposed_ns, result.place.kick
            say(
                f"the camera was kicked at {clock_text(result.exposed_ns)}: by {1e3 * np.linalg.norm(kick[:3]):.2f} mm "
                f"and {np.degrees(np.linalg.norm(kick[3:])):.3f} degrees in one frame; it is followed"
            )
        self._look_for_sight(say)

    def _look_for_sight(self, say: Callable[[str], None]) -> None:
        place = self._newest.place if self._newest is not None else None
        unseen = place is not None and place.at_ns - place.seen_ns > UNSEEN_NS
        if place is None or unseen == self._unseen:
            return
        self._unseen = unseen
        if not unseen:
            self.problem = ""
            say("a constellation that stands still is in sight again: the camera is followed")
            return
        since = f"since {clock_text(place.seen_ns)}" if place.seen_ns else "since the start"
        self.problem = f"nothing that stands still is in sight, {since}: the camera cannot be followed"
        say(self.problem)
