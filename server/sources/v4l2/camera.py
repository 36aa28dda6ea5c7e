"""V4L2 cameras: opened by any name, set as the rig wants, and found again under another number."""

import errno
import time
from collections.abc import Callable
from contextlib import suppress
from os.path import realpath

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.capture import Capture
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.messages import Clock
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.server.sources.camera import Camera, Taken, Waiting
from asterism.server.sources.source import Expected, Say
from asterism.server.sources.v4l2 import abi
from asterism.server.sources.v4l2.node import KERNEL, Node, System
from asterism.server.sources.v4l2.pixels import Damaged, to_grey
from asterism.server.sources.v4l2.place import NODE, Identity, find_again, identity_here, name_of
from asterism.server.sources.v4l2.settings import InForce, apply_settings, refuse_what_v4l2_lacks
from asterism.server.sources.v4l2.stamps import mid_exposure_ns, no_stamp
from asterism.server.sources.v4l2.stream import Stream

WAIT_S = 0.2  # at most, before whoever reads may think of something else
FIRST_S = 5.0  # cameras need so long for their first image
SILENT_S = 0.8  # without an image a camera is gone, ...
SILENT_PERIODS = 3.0  # ... or a slow one without so many
MOST_LOST = 10_000  # a larger step of the sequence numbers is none


class Counter:
    """Counts what goes wrong, and says it: the first time, and whenever it has become twice as much."""

    def __init__(self, what: str, say: Say) -> None:
        self.count = 0
        self._what = what
        self._next = 1
        self._say = say

    def add(self, count: int, why: str = "") -> None:
        """So many more."""
        self.count += count
        if self.count >= self._next:
            self._next = 2 * self.count
            self._say(f"{self._what}: {self.count} so far{why and f'; the last {why}'}")


class Once:
    """Says every sentence once, however often the camera comes back."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self._said: set[str] = set()

    def __call__(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self._say(text)


class V4l2Device:
    """An open camera that streams."""

    def __init__(self, node: Node, in_force: InForce, opener: "V4l2Opener") -> None:
        self._node = node
        self._set = in_force
        self._opener = opener
        self._before: int | None = None  # sequence number
        self._was_late = False
        self._silent_s = max(SILENT_S, SILENT_PERIODS / in_force.rate_hz if in_force.rate_hz else 0.0)
        self._stream = Stream(node)
        self._newest_ns = opener.monotonic_ns()

    def read(self) -> Taken | Waiting | None:
        """The next image, or the newest where several wait; None when the camera is gone or silent."""
        late = self._before is not None and self._stream.waits()
        missed = 0
        while True:
            try:
                with self._stream.next(WAIT_S) as came:
                    if came is None:
                        return self._silence()
                    buffer, data = came
                    missed += self._missing(int(buffer.sequence), late)
                    if late and self._stream.waits():
                        self._opener.late.add(1)
                        missed += 1
                        continue
                    image = self._image(buffer, data)
            except OSError:
                return None
            if image is None:
                return Waiting(unreadable=1, missed=missed)
            return self._stamped(image, buffer)._replace(missed=missed)

    def close(self) -> None:
        """Let go of the camera."""
        self._stream.close()
        with suppress(OSError):
            self._node.close()

    def _silence(self) -> Waiting | None:
        silent_s = (self._opener.monotonic_ns() - self._newest_ns) / 1e9
        return Waiting() if silent_s < (FIRST_S if self._before is None else self._silent_s) else None

    def _missing(self, sequence: int, late: bool) -> int:
        """How many frames are missing before this one; ``late``: nobody asked for it in time."""
        step = 1 if self._before is None else (sequence - self._before) % (1 << 32)
        missing = step - 1 if 1 < step < MOST_LOST else 0
        if missing:  # a driver drops frames too while all of its buffers are full
            (self._opener.late if late or self._was_late else self._opener.lost).add(missing)
        self._before, self._was_late, self._newest_ns = sequence, late, self._opener.monotonic_ns()
        return missing

    def _image(self, buffer: abi.Buffer, data: memoryview) -> NDArray[np.uint8] | None:
        try:
            if buffer.flags & abi.BUF_ERROR:
                raise Damaged("is said to be so by the driver")
            return to_grey(data, self._set.layout, self._opener.name)
        except Damaged as problem:
            self._opener.damaged.add(1, str(problem))
            return None

    def _stamped(self, image: NDArray[np.uint8], buffer: abi.Buffer) -> Taken:
        stamp_ns = int(buffer.seconds) * 1_000_000_000 + int(buffer.microseconds) * 1000
        if why := no_stamp(stamp_ns, buffer.flags, self._opener.monotonic_ns()):
            self._opener.distrust(why)
            return Taken(image)
        return Taken(
            image,
            mid_exposure_ns(stamp_ns, buffer.flags, self._set.exposure_us, self._opener.capture),
            Clock.DRIVER,
        )


class V4l2Opener:
    """Opens a camera; call it again when it was lost.

    ``name`` is a node or a link to one, ``size`` None the camera's own.
    """

    def __init__(
        self,
        name: str,
        capture: Capture,
        size: tuple[int, int] | None,
        say: Say,
        system: System = KERNEL,
    ) -> None:
        """Raises InputError for settings that V4L2 has no word for."""
        refuse_what_v4l2_lacks(capture, name)
        self.name = name
        self.capture = capture
        self.monotonic_ns: Callable[[], int] = time.monotonic_ns
        self.lost = Counter(f"{name}: frames lost on their way (is the cable, or the hub, too slow?)", say)
        self.late = Counter(f"{name}: frames not taken in time (this machine is busy)", say)
        self.damaged = Counter(f"{name}: damaged images, skipped", say)
        self._size = size
        self._say = say
        self._once = Once(say)
        self._system = system
        self._known: Identity | None = None  # once it was open
        self.path = name  # where it was when it was open last
        self._distrusted = False

    def __call__(self) -> V4l2Device | None:
        """The open camera, set as the rig wants; None while it is away.

        Raises WorldError where it is there and does not open, or cannot be set; InputError for settings that it lacks,
        but once it was open that is the world's fault as well.
        """
        try:
            return self._opened()
        except InputError as problem:
            if self._known is None:
                raise
            raise WorldError(str(problem)) from None

    def distrust(self, why: str) -> None:
        """Say that a stamp cannot be used."""
        if not self._distrusted:
            self._distrusted = True
            self._say(f"{self.name}: the driver's time stamps {why}; such frames are stamped when they arrive")

    def _opened(self) -> V4l2Device | None:
        path = self._where()
        if path is None:
            return None
        try:
            node = Node(path, self._system)
        except OSError as error:
            if self._known is not None and _absent(error):
                return None
            raise WorldError(f"{self.name}: the camera does not open: {trouble(path, error)}") from None
        try:
            device = self._set_up(node)
        except BaseException:
            node.close()
            raise
        if self._known is not None and path != self.path:
            self._say(f"{self.name}: the camera is {path} by now")
        self._known, self.path = self._known or identity_here(node), path
        return device

    def _where(self) -> str | None:
        """A link leads to the camera wherever it is; a number does not."""
        if not NODE.fullmatch(self.name):
            return realpath(self.name)
        return self.name if self._known is None else find_again(self._known, self.path, self._system)

    def _set_up(self, node: Node) -> V4l2Device:
        if problem := node.not_a_camera():
            raise InputError(f"{self.name}: {problem}; {typed('cameras')} lists what there is")
        try:
            in_force = apply_settings(node, self.capture, self._size, self.name, self._once)
            self._size = in_force.layout.width, in_force.layout.height  # the camera may come back with another
            return V4l2Device(node, in_force, self)
        except OSError as error:
            raise WorldError(f"{self.name}: the camera cannot be set: {trouble(node.path, error)}") from None


def v4l2_camera(text: str, rig: Rig | None, say: Say, system: System = KERNEL) -> Camera:
    """The camera that a person names. Raises as `name_of` and `V4l2Opener` do."""
    expected = Expected(rig)
    opener = V4l2Opener(name_of(text), expected.capture, expected.size, say, system)
    return Camera(opener.name, opener, rig, say)


def trouble(path: str, error: OSError) -> str:
    """Why a node does not open, and what to do."""
    if _absent(error):
        return f"there is no {path}; is it plugged in? {typed('cameras')} lists what there is"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"no permission for {path}; as root: usermod -aG video USER, then log in anew"
    if error.errno == errno.EBUSY:
        return f"another program has {path} (fuser -v {path} says which)"
    if error.errno == errno.ENOTTY:
        return f"{path} is no V4L2 device"
    return f"{path}: {error.strerror or error}"


def _absent(error: OSError) -> bool:
    return error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO)
