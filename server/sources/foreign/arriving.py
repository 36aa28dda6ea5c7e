"""Images that arrive from the network, whatever brings them: the newest wins, where none comes that is said.

Nothing that comes in is trusted: what is no image is counted and said, and never ends a server.
"""

import queue
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.messages import Clock
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.depth import Depth
from asterism.server.sources.foreign.image_messages import Picture, picture
from asterism.server.sources.foreign.remote_stamps import RemoteStamps
from asterism.server.sources.foreign.ros_messages import BadMessage, CompressedTold, RawTold
from asterism.server.sources.images import to_grey8
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.source import DEFAULT_RATE_HZ, Expected, Say

if TYPE_CHECKING:
    import zenoh

MOST_BYTES = 1 << 27  # of a message: 64 million pixels of 16 bits
WAITING = 3  # images that are not decoded yet; then the oldest goes
SILENT_S = 1.0  # without an image it is said that none comes; cameras slower than that: ...
SLOW = 3  # ... in so many times the time between the last two
SAID_EVERY_S = 10.0  # what is wrong with images, at most


class Arrived(NamedTuple):
    """A message as it came; ``kind`` is what its key or encoding says of it."""

    kind: str
    payload: bytes | None  # None: too long
    at_ns: int  # on the monotonic clock
    number: int


class ArrivingImages(ABC):
    """Images that are published, once `join` told in which session. The newest wins; where none comes, that is said,
    and that they are back. ``missed`` counts those that were replaced before they could be decoded.
    """

    live = True

    def __init__(self, name: str, rig: Rig | None, say: Say) -> None:
        self.name = name
        self._expected = Expected(rig)
        self.rate_hz = self._expected.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.missed = 0
        self.length: int | None = None
        self.problem = ""  # what is wrong now, a sentence
        self.clock = SessionClock()
        self._say = say
        self._depth = Depth(self._expected.capture.bits, say)
        self._arrived: queue.Queue[Arrived | None] = queue.Queue(WAITING)
        self._count = 0
        self._bad = ""  # what was wrong with the newest message, where it was no image
        self._comes = False  # something that is none, while there is a problem
        self._said_s = -SAID_EVERY_S
        self._closed = False

    @abstractmethod
    def join(self, session: "zenoh.Session", listens: bool) -> None:
        """Take what is published in that session; ``listens``: publishers join its own listener.

        Raises InputError for what nobody is heard under there.
        """

    @abstractmethod
    def told(self, kind: str, payload: bytes) -> RawTold | CompressedTold:
        """What a message of that kind says of its image. Raises BadMessage for one that is none."""

    @abstractmethod
    def leave(self) -> None:
        """Take no more from the session; it may be closed by now."""

    def frames(self) -> Iterator[Frame]:
        """Frames as they arrive, stamped by their messages as the camera's clock, else when they arrived, each less the
        rig's `delay_us`. An index that is left out was lost or no image.
        """
        stamps = RemoteStamps(self._expected.capture)
        # By when images arrived, not by when somebody has time for them.
        patience_ns, since_ns, last_ns = round(SILENT_S * 1e9), time.monotonic_ns(), None
        while not self._closed:
            try:
                arrived = self._arrived.get(timeout=max(since_ns + patience_ns - time.monotonic_ns(), 0) * 1e-9)
            except queue.Empty:
                self._miss(patience_ns)
                patience_ns, since_ns, last_ns = round(SILENT_S * 1e9), time.monotonic_ns(), None
                stamps = RemoteStamps(self._expected.capture)
                continue
            if arrived is None:  # of `close`
                continue
            found = self._read(arrived)
            if found is None:
                if arrived.at_ns > since_ns + patience_ns:
                    self._miss(patience_ns)
                    since_ns = arrived.at_ns
                continue
            if self.problem:
                self.problem = ""
                self._say(f"{self.name}: images come")
            usual_ns, last_ns = (0 if last_ns is None else arrived.at_ns - last_ns), arrived.at_ns
            patience_ns, since_ns = max(round(SILENT_S * 1e9), SLOW * usual_ns), arrived.at_ns
            yield self._frame(*found, arrived, stamps)

    def close(self) -> None:
        """Take no more, and end `frames`, also where a message that was on its way takes the place of what wakes it."""
        self._closed = True
        self.leave()
        self._put(None)

    def receive(self, kind: str, sample: "zenoh.Sample") -> None:
        """In zenoh's thread: only what must be done at once."""
        at_ns = self.clock.monotonic_ns()
        payload = sample.payload.to_bytes() if len(sample.payload) <= MOST_BYTES else None
        self._put(Arrived(kind, payload, at_ns, self._count))
        self._count += 1

    def _put(self, arrived: Arrived | None) -> None:
        while True:
            try:
                self._arrived.put_nowait(arrived)
                return
            except queue.Full:
                try:
                    self._arrived.get_nowait()
                    self.missed += 1
                except queue.Empty:
                    continue

    def _read(self, arrived: Arrived) -> tuple[NDArray[np.uint8], int] | None:
        """Grey image and stamp, or None for what is no image of this camera, which is counted and said."""
        where = f"{self.name}, message {arrived.number}"
        try:
            if arrived.payload is None:
                raise BadMessage(f"is longer than {MOST_BYTES >> 20} MB")
            told = self.told(arrived.kind, arrived.payload)
            found: Picture = picture(told, partial(self._expected.check_size, where=where))
            return to_grey8(found.image, self._depth.bits_of(found.image, where), where), found.stamp_ns
        except BadMessage as problem:
            self._bad = f"{where}: {problem}"
        except InputError as problem:
            self._bad = str(problem)
        self.unreadable += 1
        now_s = time.monotonic()
        if now_s - self._said_s >= SAID_EVERY_S:
            self._said_s = now_s
            self._say(f"{self._bad}; skipped, {self.unreadable} so far")
        return None

    def _frame(self, grey: NDArray[np.uint8], told_ns: int, arrived: Arrived, stamps: RemoteStamps) -> Frame:
        middle_ns = stamps.middle_ns(told_ns, arrived.at_ns)
        session = self.clock.session
        arrived_ns = self.clock.at_ns(arrived.at_ns, session)
        exposed_ns = arrived_ns if middle_ns is None else self.clock.at_ns(middle_ns, session)
        exposed_ns -= round(self._expected.capture.delay_us * 1e3)
        clock = Clock.ARRIVAL if middle_ns is None else Clock.CAMERA
        return Frame(grey, exposed_ns, arrived.number, f"{arrived.number:06d}", arrived_ns, clock, session)

    def _miss(self, silent_ns: int) -> None:
        """Nothing came for so long, or nothing that is an image."""
        bad, self._bad = self._bad, ""
        why = f"what comes is none ({bad})" if bad else "waiting for them"
        problem = f"{self.name}: no images for {silent_ns * 1e-9:.1f} s; {why}"
        if not self.problem or (bad and not self._comes):
            self._say(problem)
        self.problem, self._comes = problem, bool(bad)
