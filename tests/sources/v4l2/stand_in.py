"""In the kernel's place below the lowest layer: V4L2 cameras that answer requests with the header's own structures.

It behaves as videobuf2 does: buffers are lent and returned, a second one who streams is EBUSY, a camera that was pulled
out wakes who waits, and everything but closing is ENODEV then.
"""

import errno
import mmap
import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from asterism.server.sources.v4l2 import abi
from asterism.server.sources.v4l2.node import Argument

Sizes = dict[tuple[int, int], list[float]]  # with their rates, Hz
MONOTONIC_AT_START = abi.STAMP_MONOTONIC | abi.STAMP_AT_START


@dataclass
class Frame:
    """What the camera puts into a buffer."""

    data: bytes
    stamp_ns: int
    sequence: int
    flags: int = MONOTONIC_AT_START


@dataclass
class StandInCamera:
    """A camera. ``controls``: least, most, step, value by id; ``deaf``: controls that take nothing, in silence."""

    card: str = "Stand-in"
    bus: str = "usb-0000:00:14.0-1"
    hardware: tuple[str, str] = ("", "0")
    formats: dict[str, Sizes] = field(default_factory=lambda: {"GREY": {(64, 48): [60.0, 30.0]}})
    controls: dict[int, list[int]] = field(default_factory=dict)
    deaf: set[int] = field(default_factory=set)
    capabilities: int = abi.CAP_CAPTURE | abi.CAP_STREAMING
    span: tuple[int, ...] | None = None  # least, most, step of width, then of height: sizes are a range
    refuses: dict[int, int] = field(default_factory=dict)  # errno by request
    open_errno: int = 0
    stride_more: int = 0  # bytes behind every row
    ahead: bool = False  # frames wait for who comes late; else each comes when it is asked for
    frames: deque[Frame] = field(default_factory=deque)
    endless: Callable[[int], Frame] | None = None  # makes the frame of a sequence number
    there: bool = True
    streams: int | None = None  # the handle that does
    fourcc: str = "GREY"
    size: tuple[int, int] = (64, 48)
    rate: float = 30.0
    taken: int = 0
    memory: list[mmap.mmap] = field(default_factory=list)
    queued: deque[int] = field(default_factory=deque)

    def unplug(self) -> None:
        """Pull the cable."""
        self.there, self.streams = False, None

    def next_frame(self) -> Frame | None:
        if self.frames:
            return self.frames.popleft()
        if self.endless is not None and self.streams is not None:
            self.taken += 1
            return self.endless(self.taken - 1)
        return None


class StandInSystem:
    """Nodes by path. Plug a camera in elsewhere by giving it another path."""

    def __init__(self, **nodes: StandInCamera) -> None:
        self.cameras = {f"/dev/{name}": camera for name, camera in nodes.items()}
        self.opened: dict[int, StandInCamera] = {}
        self.waits: list[float] = []
        self._handles = iter(range(1000, 100_000))

    def open(self, path: str) -> int:
        camera = self.cameras.get(path)
        if camera is None or not camera.there:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        if camera.open_errno:
            raise OSError(camera.open_errno, os.strerror(camera.open_errno), path)
        handle = next(self._handles)
        self.opened[handle] = camera
        return handle

    def close(self, device: int) -> None:
        camera = self.opened.pop(device)
        if camera.streams == device:
            camera.streams = None

    def map(self, device: int, length: int, offset: int) -> mmap.mmap:
        memory = self.opened[device].memory[offset]
        assert len(memory) == length
        return memory

    def wait(self, device: int, timeout_s: float) -> bool:
        self.waits.append(timeout_s)
        camera = self.opened[device]
        if not timeout_s and not camera.ahead:
            return False
        return not camera.there or bool(camera.frames) or camera.endless is not None

    def nodes(self) -> list[str]:
        return sorted(path for path, camera in self.cameras.items() if camera.there)

    def hardware(self, path: str) -> tuple[str, str]:
        return self.cameras[path].hardware

    def ioctl(self, device: int, request: int, argument: Argument) -> None:
        camera = self.opened[device]
        if not camera.there:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        code = camera.refuses.get(request) or ANSWERS[request](camera, device, argument)
        if code:
            raise OSError(code, os.strerror(code))


def _query(camera: StandInCamera, _: int, told: Any) -> int:
    told.card[: len(camera.card)] = camera.card.encode()
    told.bus_info[: len(camera.bus)] = camera.bus.encode()
    # Of the whole device, as uvcvideo tells; this node's are in device_caps.
    told.capabilities = camera.capabilities | abi.CAP_CAPTURE | abi.CAP_PER_NODE
    told.device_caps = camera.capabilities
    return 0


def _formats(camera: StandInCamera, _: int, told: Any) -> int:
    if told.index >= len(camera.formats):
        return errno.EINVAL
    told.pixelformat = abi.fourcc(list(camera.formats)[told.index])
    return 0


def _sizes(camera: StandInCamera, _: int, told: Any) -> int:
    sizes = list(camera.formats[abi.fourcc_name(told.pixel_format)])
    span = told.stepwise
    if camera.span is not None:
        if told.index:
            return errno.EINVAL
        told.type = 3
        span.min_width, span.max_width, span.step_width, span.min_height, span.max_height, span.step_height = (
            camera.span
        )
        return 0
    if told.index >= len(sizes):
        return errno.EINVAL
    told.type = abi.DISCRETE
    span.min_width, span.max_width = sizes[told.index]
    return 0


def _intervals(camera: StandInCamera, _: int, told: Any) -> int:
    rates = camera.formats[abi.fourcc_name(told.pixel_format)].get((told.width, told.height), [])
    if told.index >= len(rates):
        return errno.EINVAL
    told.type = abi.DISCRETE
    told.stepwise[0].numerator, told.stepwise[0].denominator = 1000, round(rates[told.index] * 1000)
    return 0


def _fill_layout(camera: StandInCamera, pix: Any) -> None:
    pix.width, pix.height = camera.size
    pix.pixelformat = abi.fourcc(camera.fourcc)
    pix.bytesperline = 0 if camera.fourcc == "MJPG" else camera.size[0] * BYTES[camera.fourcc] + camera.stride_more
    pix.sizeimage = max(pix.bytesperline, camera.size[0] * 2) * camera.size[1] * 2


def _get_layout(camera: StandInCamera, _: int, told: Any) -> int:
    _fill_layout(camera, told.fmt.pix)
    return 0


def _set_layout(camera: StandInCamera, device: int, asked: Any) -> int:
    if camera.streams not in (None, device):
        return errno.EBUSY
    pix = asked.fmt.pix
    fourcc, size = abi.fourcc_name(pix.pixelformat), (pix.width, pix.height)
    camera.fourcc = fourcc if fourcc in camera.formats else next(iter(camera.formats))
    camera.size = size if size in camera.formats[camera.fourcc] or camera.span else next(iter(camera.formats[fourcc]))
    _fill_layout(camera, pix)
    return 0


def _get_rate(camera: StandInCamera, _: int, told: Any) -> int:
    told.parm.capture.capability = abi.CAP_TIMEPERFRAME
    told.parm.capture.timeperframe.numerator = 1000
    told.parm.capture.timeperframe.denominator = round(camera.rate * 1000)
    return 0


def _set_rate(camera: StandInCamera, device: int, asked: Any) -> int:
    period = asked.parm.capture.timeperframe
    wanted = period.denominator / period.numerator
    has = camera.formats[camera.fourcc].get(camera.size) or [wanted]
    camera.rate = min(has, key=lambda rate: abs(rate - wanted))
    return _get_rate(camera, device, asked)


def _query_control(camera: StandInCamera, _: int, told: Any) -> int:
    if told.id not in camera.controls:
        return errno.EINVAL
    told.minimum, told.maximum, told.step, told.default_value = camera.controls[told.id]
    return 0


def _get_control(camera: StandInCamera, _: int, told: Any) -> int:
    if told.id not in camera.controls:
        return errno.EINVAL
    told.value = camera.controls[told.id][3]
    return 0


def _set_control(camera: StandInCamera, _: int, asked: Any) -> int:
    if asked.id not in camera.controls:
        return errno.EINVAL
    least, most, step, _value = camera.controls[asked.id]
    if asked.id not in camera.deaf:
        value = min(max(asked.value, least), most)
        camera.controls[asked.id][3] = least + (value - least) // step * step
    return 0


def _request(camera: StandInCamera, device: int, asked: Any) -> int:
    if camera.streams not in (None, device):
        return errno.EBUSY
    camera.queued.clear()
    width, height = camera.size
    size = (width * 2 + camera.stride_more) * height * 2
    camera.memory = [mmap.mmap(-1, size) for _ in range(min(asked.count, 3))]  # drivers give what they like
    asked.count = len(camera.memory)
    return 0


def _query_buffer(camera: StandInCamera, _: int, told: Any) -> int:
    told.length, told.m.offset = len(camera.memory[told.index]), told.index
    return 0


def _queue(camera: StandInCamera, _: int, given: Any) -> int:
    assert given.index not in camera.queued, "given back twice"
    camera.queued.append(given.index)
    return 0


def _dequeue(camera: StandInCamera, _: int, told: Any) -> int:
    frame = camera.next_frame()
    if frame is None:
        return errno.EAGAIN
    told.index = camera.queued.popleft()
    camera.memory[told.index][: len(frame.data)] = frame.data
    told.bytesused, told.sequence, told.flags = len(frame.data), frame.sequence, frame.flags
    told.seconds, rest = divmod(frame.stamp_ns, 1_000_000_000)
    told.microseconds = rest // 1000
    return 0


def _start(camera: StandInCamera, device: int, _: Any) -> int:
    camera.streams = device
    return 0


def _stop(camera: StandInCamera, _: int, __: Any) -> int:
    camera.streams = None
    return 0


BYTES = {"GREY": 1, "NV12": 1, "Y10": 2, "Y12": 2, "Y14": 2, "Y16": 2, "YUYV": 2, "UYVY": 2}
ANSWERS: dict[int, Callable[[StandInCamera, int, Any], int]] = {
    abi.QUERYCAP: _query,
    abi.ENUM_FMT: _formats,
    abi.ENUM_FRAMESIZES: _sizes,
    abi.ENUM_FRAMEINTERVALS: _intervals,
    abi.G_FMT: _get_layout,
    abi.S_FMT: _set_layout,
    abi.G_PARM: _get_rate,
    abi.S_PARM: _set_rate,
    abi.QUERYCTRL: _query_control,
    abi.G_CTRL: _get_control,
    abi.S_CTRL: _set_control,
    abi.REQBUFS: _request,
    abi.QUERYBUF: _query_buffer,
    abi.QBUF: _queue,
    abi.DQBUF: _dequeue,
    abi.STREAMON: _start,
    abi.STREAMOFF: _stop,
}


def grey_frame(sequence: int, size: tuple[int, int] = (64, 48)) -> Frame:
    """An image of a grey level that tells its number, of this moment."""
    return Frame(bytes([sequence % 256]) * (size[0] * size[1]), time.monotonic_ns() - 2_000_000, sequence)
