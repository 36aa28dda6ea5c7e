"""What a GenICam camera tells of time: stamps in frames' chunks, the network's clock (PTP), its clock when asked."""

import time
from ctypes import c_char_p, c_double, c_int64, c_void_p
from typing import Any, NamedTuple

from asterism.server.sources.genicam.aravis import AravisError, checked, function, unref
from asterism.server.sources.genicam.aravis_camera import ArvCamera
from asterism.server.sources.genicam.aravis_stream import Raw

_PTP = ("PtpEnable", "GevIEEE1588")
_ASK = (("TimestampLatch", "TimestampLatchValue", False), ("GevTimestampControlLatch", "GevTimestampValue", True))
_TICKS = "GevTimestampTickFrequency"
_TRIES = 8
_SLOWEST_NS = 5_000_000  # of an answer that tells the camera's time well enough


class Stamp(NamedTuple):
    """When a frame was taken, by the camera."""

    camera_ns: int
    exposure_ns: int | None = None  # where the frame itself tells


class Stamps:
    """The stamps of a camera, as good as it has them."""

    def __init__(self, camera: ArvCamera) -> None:
        self._camera = camera
        for name in _PTP:
            if camera.has(name):
                camera.set_flag(name, True)
                break
        self._ticks_per_s = camera.whole(_TICKS) if camera.has(_TICKS) else 0
        self._chunks = _chunks(camera)
        self._parser: int | None = None
        if self._chunks:
            self._parser = function("arv_camera_create_chunk_parser", c_void_p, c_void_p)(camera.pointer)

    def of(self, raw: Raw) -> Stamp:
        """A whole frame's; `camera_ns` is 0 where the camera has no clock."""
        told, exposure = raw.stamp_ns, None
        try:
            if "Timestamp" in self._chunks:
                told = self._ns(int(self._chunk(c_int64, "ChunkTimestamp", raw)), True)
            if "ExposureTime" in self._chunks:
                exposure = round(1e3 * self._chunk(c_double, "ChunkExposureTime", raw))
        except AravisError:
            self._chunks = ()  # promised, but not there
        return Stamp(told, exposure)

    def ask(self) -> tuple[int, int] | None:
        """The camera's time and the host's monotonic clock at the same moment, ns; None where it cannot be asked."""
        for command, value, ticks in _ASK:
            if self._camera.has(command) and self._camera.has(value):
                answers = [self._asked(command, value, ticks) for _ in range(_TRIES)]
                took_ns, camera_ns, host_ns = min(answers)
                return (camera_ns, host_ns) if took_ns < _SLOWEST_NS else None
        return None

    def close(self) -> None:
        """Let go of what Aravis keeps for it."""
        if self._parser is not None:
            unref(self._parser)
            self._parser = None

    def _asked(self, command: str, value: str, ticks: bool) -> tuple[int, int, int]:
        """How long the command took, and the two times in the middle of it."""
        before_ns = time.monotonic_ns()
        self._camera.run(command)
        took_ns = time.monotonic_ns() - before_ns
        return took_ns, self._ns(self._camera.whole(value), ticks), before_ns + took_ns // 2

    def _ns(self, told: int, ticks: bool) -> int:
        return told * 1_000_000_000 // self._ticks_per_s if ticks and self._ticks_per_s else told

    def _chunk(self, kind: Any, name: str, raw: Raw) -> float:
        """A chunk's value; ``kind`` is its C type."""
        word = "integer" if kind is c_int64 else "float"
        read = checked(f"arv_chunk_parser_get_{word}_value", kind, c_void_p, c_void_p, c_char_p)
        return read(self._parser, raw.pointer, name.encode())  # type: ignore[no-any-return]


def _chunks(camera: ArvCamera) -> tuple[str, ...]:
    """Turns on what of time its frames can carry; returns what."""
    found = []
    if not camera.has("ChunkModeActive"):
        return ()
    for name in ("Timestamp", "ExposureTime"):
        if camera.offers("ChunkSelector", name):
            camera.set_flag("ChunkModeActive", True)
            camera.set_text("ChunkSelector", name)
            camera.set_flag("ChunkEnable", True)
            found.append(name)
    return tuple(found)
