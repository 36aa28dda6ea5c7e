"""Frames from a video file."""

import math
from collections.abc import Iterator
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.images import to_grey8
from asterism.server.sources.source import DEFAULT_RATE_HZ, Expected, Say

DAMAGED_IN_A_ROW = 300  # frames that do not decode, after which the rest is given up


class VideoFile:
    """A video file. Damaged frames are said, counted and skipped; every frame has the time that the file gives it."""

    live = False

    def __init__(self, path: Path, rig: Rig | None, say: Say) -> None:
        import cv2

        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self.name = str(path)
        self.unreadable = 0
        self._say = say
        self._expected = Expected(rig)
        self._video = cv2.VideoCapture(str(path))
        if not self._video.isOpened():
            raise InputError(f"{path}: is no video that can be read")
        rate = float(self._video.get(cv2.CAP_PROP_FPS))
        self.rate_hz = rate if 0.1 < rate < 10_000 else DEFAULT_RATE_HZ
        count = int(self._video.get(cv2.CAP_PROP_FRAME_COUNT))
        self.length: int | None = count if count > 0 else None

    def frames(self) -> Iterator[Frame]:
        """Raises InputError for frames of another size than the calibration's."""
        import cv2

        index, damaged, before_ns = 0, 0, -1
        while damaged < DAMAGED_IN_A_ROW:
            there, image = self._video.read()
            if not there:
                if self.length is None or index >= self.length:
                    break
                self.unreadable += 1
                damaged += 1
                index += 1
                continue
            damaged = 0
            grey = to_grey8(image, self._expected.capture.bits, self.name)
            self._expected.check(grey, f"{self.name}, frame {index}")
            exposed_ns = self._time_ns(float(self._video.get(cv2.CAP_PROP_POS_MSEC)), index, before_ns)
            before_ns = exposed_ns
            yield Frame(grey, exposed_ns, index, f"{index:06d}", exposed_ns)
            index += 1
        self._video.release()
        if self.unreadable:
            self._say(f"{self.name}: {self.unreadable} of {self.length} frames cannot be read; skipped")

    def _time_ns(self, told_ms: float, index: int, before_ns: int) -> int:
        """The frame's own time where the file has one that comes after the last, else the next by the rate."""
        told_ns = round(told_ms * 1e6) if math.isfinite(told_ms) else 0
        if told_ns > before_ns and (index == 0 or told_ns > 0):
            return told_ns
        return before_ns + round(1e9 / self.rate_hz) if index else 0
