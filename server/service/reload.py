"""Reading the rig again while the server runs: beside the loop, whole or not at all.

What is read is looked at before it is used, and everything that takes long is done before it is handed over: tables,
and kernels that no rig before has needed. The loop takes it between two frames.
"""

import contextlib
import logging
import queue
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.pose.track import Tracks
from asterism.server.service.systemd import Systemd

_LOG = logging.getLogger(__name__)


class Outcome(NamedTuple):
    """What came of reading the rig again: another ``rig``, or the ``problem`` with it, a sentence; asked for then."""

    rig: Rig | None
    problem: str
    asked_s: float  # by the monotonic clock


class Reloader:
    """Reads the rig at ``path`` when it is asked to. ``served`` is the one in force, ``newest`` the newest frame, for a
    trial. `ask` may be called by a signal's handler, `take` is for the loop.
    """

    def __init__(self, path: str, served: Rig, newest: Callable[[], Frame | None], systemd: Systemd) -> None:
        self._path = path
        self._served = served
        self._newest = newest
        self._systemd = systemd
        # The one way to wake a thread that a handler may use while it interrupts another of the kind.
        self._asked: queue.SimpleQueue[float | None] = queue.SimpleQueue()
        self._outcomes: deque[Outcome] = deque()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="reload", daemon=True)
        self._thread.start()

    def ask(self) -> None:
        """Read the rig again, soon."""
        self._asked.put(time.monotonic())

    def take(self) -> Outcome | None:
        """What has come of it, once for each time."""
        return self._outcomes.popleft() if self._outcomes else None

    def close(self) -> None:
        """Read no more, also where it was asked for."""
        self._closed = True
        self._asked.put(None)
        self._thread.join(timeout=1.0)

    def _run(self) -> None:
        while (asked_s := self._asked.get()) is not None and not self._closed:
            self._systemd.reloading()
            try:
                outcome = Outcome(self._prepare(), "", asked_s)
            except Exception as error:  # whatever is wrong with a file, the rig in force stays
                _LOG.debug("how it came about", exc_info=error)
                outcome = Outcome(None, f"the rig was not read again: {error}; the one before stays in force", asked_s)
            self._outcomes.append(outcome)

    def _prepare(self) -> Rig:
        rig = load_rig(self._path)
        refuse_another_camera(rig, self._served, self._path)
        warm_up(*localizing(rig))
        if (frame := self._newest()) is not None:
            localize(frame, rig, Tracks.none())
        return rig


def refuse_another_camera(rig: Rig, served: Rig, path: str) -> None:
    """Raises InputError for a rig of another camera than the one that is served, or of images of another size."""
    new, old = rig.camera, served.camera
    if new.name != old.name:
        raise InputError(
            f"{path}: its camera is '{new.name}', expected '{old.name}', which is being served; for another one stop "
            "the server and start it anew"
        )
    if (new.width, new.height) != (old.width, old.height):
        raise InputError(
            f"{path}: its camera's images are {new.width}x{new.height}, expected {old.width}x{old.height} as served; "
            "for another size stop the server and start it anew"
        )
    now, then = rig.capture, served.capture
    if (now.offset, now.binning or 1) != (then.offset, then.binning or 1):
        raise InputError(
            f"{path}: capture.offset and binning are {now.offset} and {now.binning or 1}, expected {then.offset} and "
            f"{then.binning or 1} as the camera was opened with; for others stop the server and start it anew"
        )


def settings_left(before: Rig, after: Rig) -> str:
    """What of a rig holds from the next start only, because the camera was opened with it; a sentence or nothing."""
    a, b = before.capture, after.capture
    names = [
        name
        for name, one, other in (
            ("rate", a.rate_hz, b.rate_hz),
            ("exposure_us", a.exposure_us, b.exposure_us),
            ("gain", a.gain, b.gain),
            ("size", a.size, b.size),
            ("bits", a.bits, b.bits),
            ("offset", a.offset, b.offset),
            ("pixel_format", a.pixel_format, b.pixel_format),
            ("trigger", a.trigger, b.trigger),
            ("stamp", a.stamp, b.stamp),
            ("delay_us", a.delay_us, b.delay_us),
        )
        if one != other
    ]
    return f"capture.{', capture.'.join(names)}: the camera takes that at the next start" if names else ""


@contextlib.contextmanager
def reload_on_hangup(reloader: Reloader) -> Iterator[None]:
    """Let SIGHUP have the rig read again, where there is such a signal."""
    if not hasattr(signal, "SIGHUP"):
        yield
        return
    before = signal.signal(signal.SIGHUP, lambda *_: reloader.ask())
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)
