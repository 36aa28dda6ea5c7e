"""Where frames come from. Every source is an iterator of Frames with `exposed_ns`.

Files count time from 0 at their own rate and lose nothing; `paced` plays them against the clock. Cameras are live:
the newest frame wins, what it replaces is counted, and a camera that vanishes is waited for.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import check_image_size
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.rig import Capture, Rig
from asterism.server.frame import Frame
from asterism.server.images import EXTENSIONS, UnreadableImage, natural_key, read_image, to_grey8

if TYPE_CHECKING:
    from asterism.server.simulate import Look

DEFAULT_RATE_HZ = 60.0
VIDEO_EXTENSIONS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v", ".mpg", ".mpeg")

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


class _Expected:
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
        if self._camera is not None:
            check_image_size(self._camera, width, height, where)
        self._first = self._first or (width, height)
        if self._first != (width, height):
            raise InputError(
                f"{where}: the image is {width}x{height}, expected {self._first[0]}x{self._first[1]} as the first"
            )


class ImageFiles:
    """Image files in natural order. An image that cannot be read is said, counted and skipped."""

    live = False

    def __init__(self, name: str, paths: list[Path], rig: Rig | None, say: Say) -> None:
        self.name = name
        self._expected = _Expected(rig)
        self.rate_hz = self._expected.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.length: int | None = len(paths)
        self._paths = paths
        self._say = say

    def frames(self) -> Iterator[Frame]:
        """Raises InputError for an image of another size than the calibration's, or if none could be read."""
        read = 0
        for index, path in enumerate(self._paths):
            try:
                image = read_image(path, self._expected.capture.bits)
            except UnreadableImage as problem:
                self.unreadable += 1
                self._say(f"{path}: {problem}; skipped")
                continue
            self._expected.check(image, str(path))
            read += 1
            exposed_ns = round(index * 1e9 / self.rate_hz)
            yield Frame(image, exposed_ns, index, path.name, exposed_ns)
        if not read:
            raise InputError(f"{self.name}: none of its {len(self._paths)} images can be read")


class VideoFile:
    """A video file."""

    live = False

    def __init__(self, path: Path, rig: Rig | None) -> None:
        import cv2

        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self.name = str(path)
        self.unreadable = 0
        self._expected = _Expected(rig)
        self._video = cv2.VideoCapture(str(path))
        if not self._video.isOpened():
            raise InputError(f"{path}: is no video that can be read")
        rate = float(self._video.get(cv2.CAP_PROP_FPS))
        self.rate_hz = rate if 0.1 < rate < 10_000 else DEFAULT_RATE_HZ
        count = int(self._video.get(cv2.CAP_PROP_FRAME_COUNT))
        self.length: int | None = count if count > 0 else None

    def frames(self) -> Iterator[Frame]:
        """Raises InputError for frames of another size than the calibration's."""
        index = 0
        while True:
            there, image = self._video.read()
            if not there:
                break
            grey = to_grey8(image, self._expected.capture.bits, self.name)
            self._expected.check(grey, f"{self.name}, frame {index}")
            exposed_ns = round(index * 1e9 / self.rate_hz)
            yield Frame(grey, exposed_ns, index, f"{index:06d}", exposed_ns)
            index += 1
        self._video.release()


class RecordedFrames:
    """The frames of a recording, with the times they were taken at."""

    live = False

    def __init__(self, path: Path, rig: Rig | None) -> None:
        from asterism.recordings.reader import Recording

        self.name = str(path)
        self.unreadable = 0
        self._expected = _Expected(rig)
        self._recording = Recording(path)
        self.length: int | None = self._recording.count_frames()
        if not self.length:
            raise InputError(f"{path}: holds no frames; record with --record-frames all to solve them again")
        span = self._recording.frames_span_ns()
        self.rate_hz = (self.length - 1) * 1e9 / span if span > 0 else DEFAULT_RATE_HZ

    def frames(self) -> Iterator[Frame]:
        """Raises InputError for frames of another size than the calibration's."""
        for image, exposed_ns, index in self._recording.frames():
            self._expected.check(image, f"{self.name}, frame {index}")
            yield Frame(image, exposed_ns, index, f"{index:06d}", exposed_ns)


class Simulated:
    """The simulated camera; ``count`` frames, or no end."""

    live = False

    def __init__(self, rig: Rig, seed: int = 0, count: int | None = None, look: "Look | None" = None) -> None:
        from asterism.server.simulate import Scene

        self.name = "sim"
        self.rate_hz = rig.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.length = count
        self._scene = Scene(rig, seed, look)

    def frames(self) -> Iterator[Frame]:
        """Frame after frame, rendered when asked for."""
        index = 0
        while self.length is None or index < self.length:
            exposed_ns = round(index * 1e9 / self.rate_hz)
            image = self._scene.render(index, self._scene.truth(index, index / self.rate_hz))
            yield Frame(image, exposed_ns, index, f"{index:06d}", exposed_ns)
            index += 1


class Device(Protocol):
    """An open camera."""

    def read(self) -> NDArray[np.generic] | None:
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
        self._expected = _Expected(rig)
        self.rate_hz = self._expected.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.length: int | None = None
        self.problem = ""  # what is wrong now, a sentence
        self._open = open_device
        self._say = say
        self._closed = False
        self._device: Device | None = open_device()
        if self._device is None:
            raise WorldError(
                f"{name}: the camera does not open (tried V4L2 device {name}); is it plugged in, is it free?"
            )

    def frames(self) -> Iterator[Frame]:
        """Frames as they arrive, stamped on arrival. Raises InputError for images of another size than calibrated."""
        index = 0
        while not self._closed:
            if self._device is None:
                self._device = self._open()
                if self._device is None:
                    time.sleep(self.retry_s)
                    continue
                self.problem = ""
                self._say(f"{self.name}: the camera is back")
            image = self._device.read()
            arrived_ns = time.time_ns()
            if image is None:
                self._device.close()
                self._device = None
                if not self._closed:
                    self.problem = f"{self.name}: the camera vanished; waiting for it"
                    self._say(self.problem)
                continue
            grey = to_grey8(image, self._expected.capture.bits, self.name)
            self._expected.check(grey, self.name)
            yield Frame(grey, arrived_ns, index, f"{index:06d}", arrived_ns)
            index += 1
        if self._device is not None:
            self._device.close()

    def close(self) -> None:
        """End `frames` after the image that is being waited for."""
        self._closed = True


class V4l2Device:
    """A V4L2 camera through OpenCV."""

    def __init__(self, capture: object) -> None:
        self._capture = capture

    def read(self) -> NDArray[np.generic] | None:
        """The next image; blocks until the camera delivers or gives up."""
        there, image = self._capture.read()  # type: ignore[attr-defined]
        return image if there else None

    def close(self) -> None:
        """Let go of the camera."""
        self._capture.release()  # type: ignore[attr-defined]


def open_v4l2(number: int, settings: Capture, size: tuple[int, int] | None) -> V4l2Device | None:
    """Open /dev/video<number> with the rig's settings, at ``size`` or its own; None if it does not open."""
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    capture = cv2.VideoCapture(number, cv2.CAP_V4L2)
    if not capture.isOpened():
        capture.release()
        return None
    if size is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    if settings.rate_hz is not None:
        capture.set(cv2.CAP_PROP_FPS, settings.rate_hz)
    if settings.exposure_us is not None:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # V4L2_EXPOSURE_MANUAL
        capture.set(cv2.CAP_PROP_EXPOSURE, settings.exposure_us / 100.0)  # V4L2 counts in 100 us
    if settings.gain is not None:
        capture.set(cv2.CAP_PROP_GAIN, settings.gain)
    return V4l2Device(capture)


def open_source(text: str, rig: Rig | None, say: Say, seed: int = 0) -> Source:
    """The source that a person names: `0`, `/dev/video0`, a folder or glob of images, a video, a recording, `sim`.

    Without a rig images may be of any size, all of the same, and there is nothing to simulate.

    Raises InputError when it is none of these, WorldError when a camera does not open.
    """
    if text == "sim" and rig is not None:
        return Simulated(rig, seed)
    if text.isdigit() or text.startswith("/dev/video"):
        number = text.removeprefix("/dev/video")
        if not number.isdigit():
            raise InputError(f"{text}: expected a V4L2 camera such as 0 or /dev/video0")
        expected = _Expected(rig)
        return Camera(f"/dev/video{number}", lambda: open_v4l2(int(number), expected.capture, expected.size), rig, say)
    path = Path(text)
    if path.is_dir():
        if any(path.glob("*.mcap")):
            return RecordedFrames(path, rig)
        return _images(text, [entry for entry in path.iterdir() if entry.is_file()], rig, say)
    if path.is_file():
        if path.suffix.lower() in EXTENSIONS:
            return ImageFiles(text, [path], rig, say)
        if path.suffix.lower() == ".mcap":
            raise InputError(f"{text}: is one file of a recording, expected the recording's folder {path.parent}")
        return VideoFile(path, rig)
    if any(char in text for char in "*?["):
        base = Path(path.anchor) if path.is_absolute() else Path()
        return _images(text, list(base.glob(str(path.relative_to(base)))), rig, say)
    raise InputError(
        f"{text}: there is no such source; expected a camera (0, /dev/video0), a folder or glob of images, a video, "
        "a recording, or sim"
    )


def refuse_endless(text: str, command: str) -> None:
    """Raise InputError for a source that never ends; ``command`` is what cannot use it."""
    if text == "sim" or text.isdigit() or text.startswith("/dev/video"):
        raise InputError(
            f"{text}: has no end; {command} takes a folder or glob of images, a video or a recording "
            "(asterism simulate makes images)"
        )


def _images(name: str, paths: list[Path], rig: Rig | None, say: Say) -> ImageFiles:
    images = sorted((path for path in paths if path.suffix.lower() in EXTENSIONS), key=natural_key)
    if not images:
        raise InputError(f"{name}: holds no images, expected files ending in {', '.join(EXTENSIONS)}")
    return ImageFiles(name, images, rig, say)


def paced(frames: Iterator[Frame], rate_hz: float | None, stop: Callable[[], bool]) -> Iterator[Frame]:
    """Play frames of a file against the clock, stamped when they are played.

    Their own spacing in time is kept, or ``rate_hz`` if it is given; a chain that is too slow delays, it drops
    nothing. Ends early when ``stop`` says so.
    """
    start = time.perf_counter()
    first: Frame | None = None
    for count, frame in enumerate(frames):
        first = first or frame
        own = (frame.exposed_ns - first.exposed_ns) * 1e-9
        due = start + (count / rate_hz if rate_hz is not None else own)
        while (left := due - time.perf_counter()) > 0 and not stop():
            time.sleep(min(left, 0.05))
        if stop():
            return
        now = time.time_ns()
        yield Frame(frame.image, now, frame.index, frame.name, now)
