"""Frames from a video file."""

from collections.abc import Iterator
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.images import to_grey8
from asterism.server.sources.source import DEFAULT_RATE_HZ, Expected


class VideoFile:
    """A video file."""

    live = False

    def __init__(self, path: Path, rig: Rig | None) -> None:
        import cv2

        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self.name = str(path)
        self.unreadable = 0
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
