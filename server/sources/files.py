"""Frames from image files, with the times of their folder's `times.csv`; else they count from 0 at their own rate."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.depth import Depth
from asterism.server.sources.frame_times import FrameTimes
from asterism.server.sources.image_headers import is_tiff
from asterism.server.sources.images import EXTENSIONS, UnreadableImage, natural_key, read_pages, to_grey8
from asterism.server.sources.source import DEFAULT_RATE_HZ, Expected, Say


class ImageFiles:
    """Image files in natural order, each of a TIFF's pages a frame. An image that cannot be read is said, counted and
    skipped.
    """

    live = False

    def __init__(self, name: str, paths: list[Path], rig: Rig | None, say: Say) -> None:
        self.name = name
        self._expected = Expected(rig)
        self._times = FrameTimes({path.parent for path in paths})
        self.rate_hz = self._times.rate_hz or self._expected.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.length: int | None = len(paths)
        self._paths = paths
        self._say = say
        self._depth = Depth(self._expected.capture.bits, say)

    @property
    def places(self) -> int | None:
        """How many images there are; None where one may be a stack of many, which shows once it is read."""
        return None if any(map(is_tiff, self._paths)) else len(self._paths)

    def frames(self) -> Iterator[Frame]:
        """Raises InputError for an image of another size than the calibration's, one whose time is missing from its
        folder's `times.csv` or is not later than the one before, or if none could be read.
        """
        read = 0
        for frame in self._frames(self._paths, 0):
            read += 1
            yield frame
        if not read:
            self._refuse()

    def part(self, first: int, end: int) -> Iterator[Frame]:
        """Those of some images, where each file holds one. Raises InputError as `frames` does for them."""
        self._look_at_first(first)
        yield from self._frames(self._paths[first:end], first)

    def _refuse(self) -> NoReturn:
        raise InputError(f"{self.name}: none of its {len(self._paths)} images can be read")

    def _look_at_first(self, first: int) -> None:
        """Know what images before tell of this one: the first how deep its pixels are, the last when it was taken."""
        if not first:
            return
        said, unreadable = self._say, self.unreadable
        self._say = lambda _: None
        for path, _, image in self._readable(self._paths):
            self._depth.bits_of(image, str(path))
            break
        else:
            self._refuse()
        for path, name, _ in self._readable(self._paths[first - 1 :: -1]):
            self._times.of(path, name)
            break
        self._say, self.unreadable = said, unreadable

    def _readable(self, paths: list[Path]) -> Iterator[tuple[Path, str, NDArray[Any]]]:
        return ((path, *page) for path, page in self._pages(paths) if page is not None)

    def _frames(self, paths: list[Path], first: int) -> Iterator[Frame]:
        for index, (path, page) in enumerate(self._pages(paths), first):
            if page is None:
                continue
            name, image = page
            grey = to_grey8(image, self._depth.bits_of(image, str(path)), str(path))
            told_ns = self._times.of(path, name)
            exposed_ns = round(index * 1e9 / self.rate_hz) if told_ns is None else told_ns
            yield Frame(grey, exposed_ns, index, name, exposed_ns)

    def _pages(self, paths: list[Path]) -> Iterator[tuple[Path, tuple[str, NDArray[Any]] | None]]:
        """Every page of every file with its name; None for what cannot be read."""
        for path in paths:
            try:
                for page in read_pages(path, partial(self._expected.check_size, where=str(path))):
                    yield path, page
            except UnreadableImage as problem:
                self.unreadable += 1
                self._say(f"{path}: {problem}; skipped")
                yield path, None


def image_files(name: str, paths: list[Path], rig: Rig | None, say: Say) -> ImageFiles:
    """The images among ``paths``, in natural order. Raises InputError where there are none."""
    images = sorted((path for path in paths if path.suffix.lower() in EXTENSIONS), key=natural_key)
    if not images:
        raise InputError(f"{name}: holds no images, expected files ending in {', '.join(EXTENSIONS)}")
    return ImageFiles(name, images, rig, say)
