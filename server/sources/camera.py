"""Frames of a camera that runs by itself: the newest wins, and a camera that vanishes is waited for."""

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import WorldError
from asterism.protocol.messages import Clock
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.images import to_grey8
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.source import DEFAULT_RATE_HZ, Expected, LiveSource, Say, Source

RETRY_S = 1.0


def clock_of(source: Source) -> SessionClock:
    """What stamps a source's frames when they are served: a camera's own clock, or one that begins now."""
    return source.clock if isinstance(source, LiveSource) else SessionClock()


class Taken(NamedTuple):
    """An image, and when its light fell."""

    image: NDArray[np.generic]
    mid_ns: int | None = None  # mid-exposure on the host's monotonic clock; None: only its arrival is known
    clock: Clock = Clock.ARRIVAL  # that told
    bits: int | None = None  # of a 16-bit image's pixels, where the camera tells; the rig's `bits` goes before
    unreadable: int = 0  # frames before it that came damaged
    missed: int = 0  # frames before it that never came


class Waiting(NamedTuple):
    """The camera is there and has no image: nothing yet, or one that cannot be used."""

    why: str = ""  # what a person should know: what it waits for
    unreadable: int = 0
    missed: int = 0


class Device(Protocol):
    """An open camera."""

    def read(self) -> Taken | Waiting | None:
        """The next image, what is there in its place, or None when the camera is gone."""
        ...

    def close(self) -> None:
        """Let go of the camera."""
        ...


class Camera:
    """A camera that runs by itself. When it vanishes, that is said and it is opened again as soon as it is back."""

    live = True

    def __init__(
        self,
        name: str,
        open_device: Callable[[], Device | None],
        rig: Rig | None,
        say: Say,
        retry_s: float = RETRY_S,
    ) -> None:
        """``open_device`` gives None for a camera that is not there, or raises WorldError with a sentence of why; it is
        called again every ``retry_s`` while the camera is away.

        Raises WorldError when the camera does not open now.
        """
        self.name = name
        self.retry_s = retry_s
        self._expected = Expected(rig)
        self.rate_hz = self._expected.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.missed = 0  # frames that the camera counts and that never came
        self.length: int | None = None
        self.problem = ""  # what is wrong now, a sentence
        self.clock = SessionClock()
        self._open = open_device
        self._say = say
        self._closed = False
        self._device: Device | None = open_device()
        if self._device is None:
            raise WorldError(
                f"{name}: the camera does not open (tried V4L2 device {name}); is it plugged in, is it free?"
            )

    def frames(self) -> Iterator[Frame]:
        """Frames as they arrive, stamped by the best clock that tells, less the rig's `delay_us`.

        Raises InputError for images of another size than calibrated.
        """
        index = 0
        try:
            while not self._closed:
                taken = self._next()
                if taken is not None:
                    yield self._frame(taken, index, self.clock.session)
                    index += 1
        finally:
            self._let_go()

    def close(self) -> None:
        """End `frames` after the image that is being waited for."""
        self._closed = True

    def _next(self) -> Taken | None:
        """The next image; None where there is none, and why stands in `problem`."""
        if self._device is None and not self._reopened():
            time.sleep(self.retry_s)
            return None
        assert self._device is not None
        read = self._device.read()
        if read is None:
            self._let_go()
            if not self._closed:
                self._tell(f"{self.name}: the camera vanished; waiting for it")
            return None
        self.unreadable += read.unreadable
        self.missed += read.missed
        if isinstance(read, Waiting):
            if read.why:
                self._tell(f"{self.name}: {read.why}")
            return None
        self.problem = ""
        return read

    def _frame(self, taken: Taken, index: int, session: int) -> Frame:
        arrived_ns, capture = self.clock.now_ns(session), self._expected.capture
        grey = to_grey8(taken.image, capture.bits or taken.bits, self.name)
        self._expected.check(grey, self.name)
        stamp_ns = arrived_ns if taken.mid_ns is None else self.clock.at_ns(taken.mid_ns, session)
        exposed_ns = stamp_ns - round(capture.delay_us * 1e3)
        return Frame(grey, exposed_ns, index, f"{index:06d}", arrived_ns, taken.clock, session)

    def _reopened(self) -> bool:
        """Whether the camera is back."""
        try:
            self._device = self._open()
        except WorldError as problem:
            self._tell(f"{problem}; waiting for it")
        if self._device is None:
            return False
        self.problem = ""
        self._say(f"{self.name}: the camera is back")
        return True

    def _let_go(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _tell(self, problem: str) -> None:
        """Once for as long as it lasts."""
        if problem != self.problem:
            self.problem = problem
            self._say(problem)
