"""Threads around the chain: the newest frame of a camera, the next frames of a file, the newest value for a viewer."""

import logging
import os
import queue
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from asterism.server.chain.frame import Frame

_LOG = logging.getLogger(__name__)
T = TypeVar("T")

LOW = 15  # niceness
AHEAD = 3  # frames of a file that are decoded before they are needed


class Feed:
    """Runs a source's iterator in a thread of its own and hands its frames on.

    ``live``: the newest frame wins, what it replaces is counted in ``dropped``. Otherwise the thread waits, and no
    frame is lost. An exception of the source is raised where the frames are taken.
    """

    def __init__(self, frames: Iterator[Frame], live: bool) -> None:
        self._frames = frames
        self._live = live
        self.dropped = 0
        self._ready = threading.Condition()
        self._newest: Frame | None = None
        self._queue: queue.Queue[Frame | None] = queue.Queue(AHEAD)
        self._error: BaseException | None = None
        self._done = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="source", daemon=True)
        self._thread.start()

    def next(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there is none within that time; `finished` tells whether more may come."""
        if self._live:
            with self._ready:
                self._ready.wait_for(lambda: self._newest is not None or self._done, timeout_s)
                frame, self._newest = self._newest, None
        else:
            try:
                frame = self._queue.get(timeout=timeout_s)
            except queue.Empty:
                frame = None
        if frame is None and self._error is not None and self.finished:
            error, self._error = self._error, None
            raise error
        return frame

    @property
    def finished(self) -> bool:
        """Whether the source has ended and every frame was taken."""
        with self._ready:
            return self._done and self._newest is None and self._queue.empty()

    def close(self) -> None:
        """Stop taking frames from the source; a source that blocks is left behind."""
        self._stop.set()
        while not self._queue.empty():
            self._queue.get_nowait()
        self._thread.join(timeout=1.0)

    def _run(self) -> None:
        try:
            for frame in self._frames:
                if self._live:
                    with self._ready:
                        self.dropped += self._newest is not None
                        self._newest = frame
                        self._ready.notify()
                else:
                    while not self._stop.is_set():
                        try:
                            self._queue.put(frame, timeout=0.1)
                            break
                        except queue.Full:
                            continue
                if self._stop.is_set():
                    break
        except BaseException as error:  # handed on to whoever takes the frames
            self._error = error
        with self._ready:
            self._done = True
            self._ready.notify()


class Ticker:
    """Calls a function at a steady interval, from a thread of its own, until it is closed, also where it fails."""

    def __init__(self, call: Callable[[], None], every_s: float) -> None:
        self._call = call
        self._every_s = every_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ticker", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop calling."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(self._every_s):
            try:
                self._call()
            except Exception:  # a fault of the program must not end what others take for a sign of life
                _LOG.exception("what is done every %g s failed; it is tried again", self._every_s)


class Newest(Generic[T]):
    """Calls a function with what it was given last, from a thread of its own: who is slow misses values, and holds up
    nobody. ``waiting`` values may wait, in order; then the oldest goes, and is counted in ``dropped``. ``low``: on
    Linux its thread comes after all others, for work that lets go of Python's lock, such as compressing.
    """

    def __init__(self, call: Callable[[T], None], name: str, waiting: int = 1, low: bool = False) -> None:
        self._call = call
        self._name = name
        self._low = low
        self.dropped = 0
        self._ready = threading.Condition()
        self._values: deque[T] = deque(maxlen=waiting)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def give(self, value: T) -> None:
        """To be handed on when the function is done with those before, unless so many newer ones come until then."""
        with self._ready:
            self.dropped += len(self._values) == self._values.maxlen
            self._values.append(value)
            self._ready.notify()

    @property
    def busy(self) -> bool:
        """Whether its thread has not ended: of one that is closed, that a call does not return."""
        return self._thread.is_alive()

    def close(self, timeout_s: float = 5.0, rest: bool = False) -> None:
        """Hand nothing on any more, but for the ``rest`` that waits, if that is wanted; a call that does not return
        within that time is left behind.
        """
        with self._ready:
            self._closed = True
            if not rest:
                self._values.clear()
            self._ready.notify()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        if self._low and sys.platform == "linux":
            os.nice(LOW)  # of this thread; elsewhere it would be of the process
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._values or self._closed)
                if not self._values:
                    return
                value = self._values.popleft()
            try:
                self._call(value)
            except Exception:  # a viewer's fault must not end what shows the next frame
                _LOG.exception("%s failed; it goes on with the next", self._name)
