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


def clock_of(source: Source) -> SessionClock:
    """What stamps a source's frames when they are served: a camera's own clock, or one that begins now."""
    return source.clock if isinstance(source, LiveSource) else SessionClock()


class Taken(NamedTuple):
    """An image, and when its light fell."""

    image: NDArray[np.generic]
    mid_ns: int | None = None  # mid-exposure on the host's monotonic clock; None: only its arrival is known
    clock: Clock = Clock.ARRIVAL  # that told


class Device(Protocol):
    """An open camera."""

    def read(self) -> Taken | None:
        """The next image, or None when the camera is gone."""
        ...

    def close(self) -> None:
        """Let go of the camera."""
        ...


class Camera:
    """A camera that runs by itself. When it vanishes, that is said and it is opened again as soon as it is back."""

    live = True
    retry_s = 1.0

    def __init__(self, name: str, open_device: Callable[[], Device | None], rig: Rig | None, say: Say) -> None:
        """Raises WorldError when the camera does not open now."""
        self.name = name
        self._expected = Expected(rig)
        self.rate_hz = self._expected.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.lost = 0
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
        index, capture = 0, self._expected.capture
        delay_ns = round(capture.delay_us * 1e3)
        while not self._closed:
            if self._device is None:
                self._device = self._open()
                if self._device is None:
                    time.sleep(self.retry_s)
                    continue
                self.problem = ""
                self._say(f"{self.name}: the camera is back")
            taken = self._device.read()
            session = self.clock.session
            arrived_ns = self.clock.now_ns(session)
            if taken is None:
                self._device.close()
                self._device = None
                if not self._closed:
                    self.problem = f"{self.name}: the camera vanished; waiting for it"
                    self._say(self.problem)
                continue
            grey = to_grey8(taken.image, capture.bits, self.name)
            self._expected.check(grey, self.name)
            stamp_ns = arrived_ns if taken.mid_ns is None else self.clock.at_ns(taken.mid_ns, session)
            yield Frame(grey, stamp_ns - delay_ns, index, f"{index:06d}", arrived_ns, taken.clock, session)
            index += 1
        if self._device is not None:
            self._device.close()

    def close(self) -> None:
        """End `frames` after the image that is being waited for."""
        self._closed = True
