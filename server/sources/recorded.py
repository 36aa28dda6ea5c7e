"""Frames from a recording."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.source import DEFAULT_RATE_HZ, Expected, Say


class RecordedFrames:
    """The frames of a recording, with the times they were taken at."""

    live = False

    def __init__(self, path: Path, rig: Rig | None, say: Say) -> None:
        from asterism.recordings.reader import Recording

        self.name = str(path)
        self._say = say
        self.unreadable = 0
        self._expected = Expected(rig)
        self._recording = Recording(path)
        self.length: int | None = self._recording.count_frames()
        self.places: int | None = self.length
        if not self.length:
            raise InputError(f"{path}: holds no frames; record with --record-frames all to solve them again")
        self.rate_hz = self._recording.frame_rate_hz() or DEFAULT_RATE_HZ

    def frames(self) -> Iterator[Frame]:
        """In the order in which they were taken, also where the clock was set.

        Raises InputError for frames of another size than the calibration's.
        """
        return self._checked(0)

    def part(self, first: int, end: int) -> Iterator[Frame]:
        """Some of them. Raises InputError as `frames` does for them."""
        return islice(self._checked(first), end - first)

    def _checked(self, first: int) -> Iterator[Frame]:
        before_ns = next(self._recording.frames_from(first - 1))[1] if first else 0
        for image, exposed_ns, index in self._recording.frames_from(first):
            self._expected.check(image, f"{self.name}, frame {index}")
            if exposed_ns < before_ns:
                self._say(
                    f"{self.name}, frame {index}: the clock was set back by {(before_ns - exposed_ns) * 1e-9:.3f} s"
                )
            before_ns = exposed_ns
            yield Frame(image, exposed_ns, index, f"{index:06d}", exposed_ns)
