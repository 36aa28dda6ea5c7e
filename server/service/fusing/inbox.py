"""What was heard and waits for the loop: bounded, so that who tells too much loses its own, and nobody else's."""

import queue
import threading
from collections import Counter

from asterism.server.service.fusing.ears import Answers, Heard

MOST_FRAMES = 64  # of a camera: a second of them
MOST_OTHERS = 64  # of a camera's tokens and events
MOST = 4096  # of all
MOST_AT_ONCE = 256  # that are taken before what is due is joined


class Inbox:
    """Safe to use from any thread. ``lost`` is how many there was no room for."""

    def __init__(self) -> None:
        self.lost = 0
        self._lock = threading.Lock()
        self._queue: queue.SimpleQueue[Heard | Answers] = queue.SimpleQueue()
        self._waiting: Counter[tuple[str, bool]] = Counter()

    def put(self, heard: Heard | Answers) -> bool:
        """Something came; returns whether there was room. Answers were asked for: for them there always is."""
        if isinstance(heard, Heard):
            key = _key(heard)
            with self._lock:
                most = MOST_FRAMES if key[1] else MOST_OTHERS
                if self._waiting[key] >= most or self._queue.qsize() >= MOST:
                    self.lost += 1
                    if not self._waiting[key]:
                        del self._waiting[key]
                    return False
                self._waiting[key] += 1
        self._queue.put(heard)
        return True

    def taken(self, wait_s: float) -> "list[Heard | Answers]":
        """What has come, in order, after at most that long; not more than `MOST_AT_ONCE`."""
        some: list[Heard | Answers] = []
        try:
            some.append(self._queue.get(timeout=max(wait_s, 0.0)))
            while len(some) < MOST_AT_ONCE:
                some.append(self._queue.get_nowait())
        except queue.Empty:
            pass
        with self._lock:
            for heard in some:
                if isinstance(heard, Heard):
                    self._waiting[_key(heard)] -= 1
                    if self._waiting[_key(heard)] <= 0:
                        del self._waiting[_key(heard)]
        return some


def _key(heard: Heard) -> tuple[str, bool]:
    return heard.camera, heard.word == "frame"
