"""A V4L2 device node: what it is, what it offers, how it is set. All words are the kernel's."""

import errno
import mmap
import os
import select
from collections.abc import Callable, Iterator
from contextlib import suppress
from ctypes import Structure, c_int32
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

from asterism.server.sources.v4l2 import abi

MOST_ENTRIES = 512  # of a list that a driver tells entry by entry

Argument = Structure | c_int32
Entry = TypeVar("Entry", bound=Structure)


class System(Protocol):
    """What is below: the kernel, or what stands in for it. All but the last two raise OSError."""

    def open(self, path: str) -> int:
        """A descriptor that does not block."""
        ...

    def close(self, device: int) -> None:
        """Let go of it."""

    def ioctl(self, device: int, request: int, argument: Argument) -> None:
        """A request, answered in its argument."""

    def map(self, device: int, length: int, offset: int) -> mmap.mmap:
        """A driver's buffer."""
        ...

    def wait(self, device: int, timeout_s: float) -> bool:
        """Whether a frame or an error came within that time."""
        ...

    def nodes(self) -> list[str]:
        """Paths of all nodes, in order of their numbers."""
        ...

    def hardware(self, path: str) -> tuple[str, str]:
        """The USB device behind a node, `vendor:product:serial`, and which of the device's nodes it is; or ""."""
        ...


class Kernel:
    """Linux."""

    folder = Path("/sys/class/video4linux")

    def open(self, path: str) -> int:
        """See `System`, as below."""
        return os.open(path, os.O_RDWR | getattr(os, "O_NONBLOCK", 0))  # other systems have neither it nor cameras

    def close(self, device: int) -> None:
        os.close(device)

    def ioctl(self, device: int, request: int, argument: Argument) -> None:
        import fcntl  # other systems lack it

        while True:
            with suppress(InterruptedError):
                fcntl.ioctl(device, request, argument, True)
                return

    def map(self, device: int, length: int, offset: int) -> mmap.mmap:
        return mmap.mmap(device, length, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset)

    def wait(self, device: int, timeout_s: float) -> bool:
        poll = select.poll()
        poll.register(device, select.POLLIN)
        return bool(poll.poll(timeout_s * 1e3))

    def nodes(self) -> list[str]:
        numbers = (path.name.removeprefix("video") for path in Path("/dev").glob("video*"))
        return [f"/dev/video{number}" for number in sorted(int(text) for text in numbers if text.isdecimal())]

    def hardware(self, path: str) -> tuple[str, str]:
        node = self.folder / Path(path).name
        device = (node / "device").resolve()
        for folder in (device, device.parent):  # a USB interface, and its device
            keys = [_read(folder / key) for key in ("idVendor", "idProduct", "serial")]
            if all(keys):
                return ":".join(keys), _read(node / "index")
        return "", _read(node / "index")


def _read(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


KERNEL = Kernel()


class Mode(NamedTuple):
    """A size, px, and the rates that are possible at it, Hz, fastest first; none: the driver does not say."""

    width: int
    height: int
    rates: tuple[float, ...] = ()
    between: bool = False  # any rate from the first to the last

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.width, self.height


class Span(NamedTuple):
    """Sizes from the least to the most, in steps: width and height of each, px."""

    least: tuple[int, int]
    most: tuple[int, int]
    step: tuple[int, int]

    def has(self, size: tuple[int, int]) -> bool:
        """Whether a size is among them."""
        return all(
            least <= value <= most and (value - least) % max(step, 1) == 0
            for value, least, most, step in zip(size, *self, strict=True)
        )


class Node:
    """An open node. Methods raise OSError as the driver has it."""

    def __init__(self, path: str, system: System = KERNEL) -> None:
        self.path = path
        self.system = system
        self.handle = system.open(path)
        self.capability = abi.Capability()
        try:
            self.ioctl(abi.QUERYCAP, self.capability)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Let go of it."""
        self.system.close(self.handle)

    def ioctl(self, request: int, argument: Argument) -> None:
        """A request, answered in its argument."""
        self.system.ioctl(self.handle, request, argument)

    @property
    def card(self) -> str:
        """The camera's name, as its maker has it."""
        return abi.text(self.capability.card)

    @property
    def bus(self) -> str:
        """Where it is plugged in."""
        return abi.text(self.capability.bus_info)

    def not_a_camera(self) -> str:
        """Why no frames can be had from this node, or ""."""
        told = self.capability
        here = told.device_caps if told.capabilities & abi.CAP_PER_NODE else told.capabilities
        if here & abi.CAP_MEM2MEM:
            return "is an encoder, decoder or scaler, no camera"
        if here & abi.CAP_CAPTURE_PLANES:
            return "has its images in planes of their own, which is not read"
        if not here & abi.CAP_CAPTURE:
            return "gives no images (a camera's node for metadata, or an output)"
        return "" if here & abi.CAP_STREAMING else "cannot stream"

    def formats(self) -> list[tuple[str, str]]:
        """Pixel formats: fourcc and description."""
        return [
            (abi.fourcc_name(entry.pixelformat), abi.text(entry.description))
            for entry in self._entries(abi.ENUM_FMT, lambda: abi.FormatDescription(type=abi.CAPTURE))
        ]

    def sizes(self, fourcc: str) -> list[tuple[int, int]] | Span:
        """Sizes, px; an empty list where the driver does not say."""
        number = abi.fourcc(fourcc)
        found = []
        for entry in self._entries(abi.ENUM_FRAMESIZES, lambda: abi.FrameSize(pixel_format=number)):
            span = entry.stepwise
            if entry.type != abi.DISCRETE:
                return Span(
                    (span.min_width, span.min_height),
                    (span.max_width, span.max_height),
                    (span.step_width, span.step_height),
                )
            found.append((span.min_width, span.max_width))  # a discrete size lies where these do
        return found

    def mode(self, fourcc: str, size: tuple[int, int]) -> Mode:
        """A size with its rates."""
        asked = {"pixel_format": abi.fourcc(fourcc), "width": size[0], "height": size[1]}
        rates = []
        for entry in self._entries(abi.ENUM_FRAMEINTERVALS, lambda: abi.FrameInterval(**asked)):
            if entry.type != abi.DISCRETE:
                least, most, _ = entry.stepwise
                return Mode(*size, (_hertz(least), _hertz(most)), between=True)
            rates.append(_hertz(entry.stepwise[0]))
        return Mode(*size, tuple(sorted(filter(None, rates), reverse=True)))

    def layout(self) -> abi.PixelLayout:
        """Size and format in force."""
        asked = abi.Format(type=abi.CAPTURE)
        self.ioctl(abi.G_FMT, asked)
        layout: abi.PixelLayout = asked.fmt.pix
        return layout

    def set_layout(self, fourcc: str, size: tuple[int, int]) -> abi.PixelLayout:
        """Set them; returns what the driver made of it."""
        asked = abi.Format(type=abi.CAPTURE)
        pix = asked.fmt.pix
        pix.width, pix.height, pix.pixelformat, pix.field = *size, abi.fourcc(fourcc), abi.ANY_FIELD
        self.ioctl(abi.S_FMT, asked)
        layout: abi.PixelLayout = asked.fmt.pix
        return layout

    def rate(self) -> float | None:
        """The rate in force, Hz; None where the driver does not say."""
        asked = abi.StreamParameters(type=abi.CAPTURE)
        try:
            self.ioctl(abi.G_PARM, asked)
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):
                return None
            raise
        return _hertz(asked.parm.capture.timeperframe) or None

    def set_rate(self, hertz: float) -> float | None:
        """Set it; returns what the driver made of it, None where it takes none."""
        asked = abi.StreamParameters(type=abi.CAPTURE)
        period = asked.parm.capture.timeperframe
        period.numerator, period.denominator = 1000, round(hertz * 1000)
        try:
            self.ioctl(abi.S_PARM, asked)
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):
                return None
            raise
        capture = asked.parm.capture
        return _hertz(capture.timeperframe) or None if capture.capability & abi.CAP_TIMEPERFRAME else None

    def control(self, number: int) -> abi.ControlQuery | None:
        """Bounds of a control; None where there is none, or none that can be set."""
        asked = abi.ControlQuery(id=number)
        try:
            self.ioctl(abi.QUERYCTRL, asked)
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):
                return None
            raise
        return None if asked.flags & (abi.CONTROL_DISABLED | abi.CONTROL_READ_ONLY) else asked

    def value(self, number: int) -> int:
        """The value of a control."""
        asked = abi.Control(id=number)
        self.ioctl(abi.G_CTRL, asked)
        return int(asked.value)

    def set_value(self, number: int, value: int) -> None:
        """Set a control."""
        self.ioctl(abi.S_CTRL, abi.Control(id=number, value=value))

    def _entries(self, request: int, ask: Callable[[], Entry]) -> Iterator[Entry]:
        """A driver's list, entry by entry; empty where it has none."""
        for index in range(MOST_ENTRIES):
            entry = ask()
            entry.index = index
            try:
                self.ioctl(request, entry)
            except OSError as error:
                if error.errno in (errno.EINVAL, errno.ENOTTY):
                    return
                raise
            yield entry


def _hertz(period: abi.Fraction) -> float:
    return period.denominator / period.numerator if period.numerator else 0.0
