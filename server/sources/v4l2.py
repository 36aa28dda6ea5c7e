"""V4L2 cameras, through OpenCV."""

from asterism.protocol.capture import Capture
from asterism.server.sources.camera import Taken


class V4l2Device:
    """A V4L2 camera through OpenCV."""

    def __init__(self, capture: object) -> None:
        self._capture = capture

    def read(self) -> Taken | None:
        """The next image; blocks until the camera delivers or gives up."""
        there, image = self._capture.read()  # type: ignore[attr-defined]
        return Taken(image) if there else None

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
