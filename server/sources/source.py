"""What a source is, and what its images must be like."""

from collections.abc import Callable, Iterator
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import check_image_size
from asterism.protocol.capture import Capture
from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.session_clock import SessionClock

DEFAULT_RATE_HZ = 60.0

Say = Callable[[str], None]


class Source(Protocol):
    """What frames can be had from.

    ``name`` is what people call it; ``live`` sources run by themselves and must not be waited for; ``unreadable``
    counts images that were skipped; ``length`` is the number of frames if it is known.
    """

    name: str
    live: bool
    rate_hz: float
    unreadable: int
    length: int | None

    def frames(self) -> Iterator[Frame]:
        """The frames, each once, in order."""
        ...


@runtime_checkable
class Cuttable(Source, Protocol):
    """A source that can begin anywhere. It has ``places``, one after the other, each of which holds a frame or one that
    cannot be read; None where it cannot begin anywhere after all.
    """

    @property
    def places(self) -> int | None:
        """How many there are."""
        ...

    def part(self, first: int, end: int) -> Iterator[Frame]:
        """The frames at places from ``first`` up to ``end``, as `frames` gives them; raises what that raises."""
        ...


@runtime_checkable
class LiveSource(Source, Protocol):
    """A source that runs by itself. ``clock`` stamps its frames; ``problem`` says why there are none now, if so;
    ``missed`` counts those that it knows of but could not give.
    """

    clock: SessionClock
    problem: str
    missed: int

    def close(self) -> None:
        """End `frames`."""
        ...


class Expected:
    """What images must be like: as the rig says, or without one (calibration) all of one size."""

    def __init__(self, rig: Rig | None) -> None:
        self.capture = Capture() if rig is None else rig.capture
        self._camera = None if rig is None else rig.camera
        self._first: tuple[int, int] | None = None

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height that a camera is to deliver, if that is known."""
        return self.capture.size or (None if self._camera is None else (self._camera.width, self._camera.height))

    def check(self, image: NDArray[np.uint8], where: str) -> None:
        """Raises InputError for an image of another size."""
        height, width = image.shape
        self.check_size(width, height, where)

    def check_size(self, width: int, height: int, where: str) -> None:
        """Raises InputError for another size."""
        if self._camera is not None:
            check_image_size(self._camera, width, height, where)
        self._first = self._first or (width, height)
        if self._first != (width, height):
            raise InputError(
                f"{where}: the image is {width}x{height}, expected {self._first[0]}x{self._first[1]} as the first"
            )
