"""The frames of a camera as Aravis delivers them, without a copy where that is safe.

A frame's memory goes back to Aravis when nobody has the image any more: feed, recorder, live view, whoever. Where they
hold so many that Aravis would soon have no memory for the next frame, the image is copied instead.
"""

import threading
import time
from ctypes import POINTER, byref, c_char_p, c_int, c_size_t, c_uint16, c_uint32, c_uint64, c_void_p
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.server.sources.genicam.aravis import checked, function, set_property, unref
from asterism.server.sources.genicam.aravis_camera import ArvCamera

BUFFERS = 16
SPARE = 4  # with so few left to Aravis images are copied
SUCCESS = 0
_SOCKET_BUFFER = 1 << 25  # bytes; the kernel gives what net.core.rmem_max allows, or a frame
_FIXED = 0
_STEP_NS = (
    100_000  # by which clocks may seem to run apart between two frames, beside a thousandth that one is slewed by
)


class Raw(NamedTuple):
    """A frame as it came; its ``data`` (n,) uint8 are Aravis' memory for as long as anything refers to them."""

    status: int  # SUCCESS, or why it is incomplete
    frame_id: int
    stamp_ns: int  # the camera's clock; 0 where it has none
    began_ns: int  # when the first of it was here, on the host's monotonic clock
    width: int
    height: int
    padding: int  # bytes behind every row
    format: int  # GenICam's number
    data: NDArray[np.uint8]
    pointer: int


class _Memory:
    """A frame's memory for numpy. When the last array on it is gone, so is this, and Aravis gets it back."""

    def __init__(self, stream: "ArvStream", pointer: int, address: int, size: int) -> None:
        self.__array_interface__ = {"shape": (size,), "typestr": "|u1", "data": (address, False), "version": 3}
        self._stream = stream
        self._pointer = pointer

    def __del__(self) -> None:
        self._stream.take_back(self._pointer)


class ArvStream:
    """Where a camera's frames arrive. ``buffers`` of ``payload`` bytes are Aravis'."""

    def __init__(self, camera: ArvCamera, payload: int, buffers: int = BUFFERS) -> None:
        """Raises AravisError."""
        create = checked("arv_camera_create_stream", c_void_p, c_void_p, c_void_p, c_void_p)
        self._lock = threading.Lock()
        if camera.is_gige():
            camera.use_plain_sockets()
        self._pointer: int | None = create(camera.pointer, None, None)
        self._read_pointer = self._pointer
        self.port = 0  # of a GigE Vision camera's frames
        if camera.is_gige():
            set_property(self._pointer, "socket-buffer", c_int, _FIXED)
            set_property(self._pointer, "socket-buffer-size", c_int, max(_SOCKET_BUFFER, payload))
            self.port = int(function("arv_gv_stream_get_port", c_uint16, c_void_p)(self._pointer))
        self._clocks = (time.monotonic_ns(), time.time_ns())  # monotonic and wall clock at the frame before
        self._pop = function("arv_stream_timeout_pop_buffer", c_void_p, c_void_p, c_uint64)
        self._push = function("arv_stream_push_buffer", None, c_void_p, c_void_p)
        self._unref = unref  # images may outlive this module as Python ends
        new = function("arv_buffer_new_allocate", c_void_p, c_size_t)
        for _ in range(buffers):
            self._push(self._pointer, new(payload))

    def next(self, timeout_s: float) -> Raw | None:
        """The next frame, whole or not; None where there is none within that time. For one thread."""
        pointer = self._pop(self._read_pointer, round(timeout_s * 1e6))
        if pointer is None:
            return None
        # Close to each other; what is between them is an error of the time.
        monotonic_ns, wall_ns = time.monotonic_ns(), time.time_ns()
        noted_ns, stamp_ns = _told("system_timestamp", c_uint64, pointer), _told("timestamp", c_uint64, pointer)
        began_ns = self._began_ns(noted_ns, monotonic_ns, wall_ns)
        whole = (status := _told("status", c_int, pointer)) == SUCCESS
        size = c_size_t()
        address = function("arv_buffer_get_data", c_void_p, c_void_p, POINTER(c_size_t))(pointer, byref(size))
        memory = _Memory(self, pointer, address or 0, size.value if address else 0)
        data = np.asarray(memory) if whole else np.empty(0, np.uint8)
        return Raw(
            status,
            _told("frame_id", c_uint64, pointer),
            0 if stamp_ns == noted_ns else stamp_ns,  # Aravis takes the host's where the camera has none
            began_ns,
            _told("image_width", c_int, pointer) if whole else 0,
            _told("image_height", c_int, pointer) if whole else 0,
            _padding(pointer) if whole else 0,
            _told("image_pixel_format", c_uint32, pointer) if whole else 0,
            data,
            pointer,
        )

    def is_short(self) -> bool:
        """Whether so many frames' memory is held that Aravis has little left."""
        left, done = c_int(), c_int()
        count = function("arv_stream_get_n_buffers", None, c_void_p, POINTER(c_int), POINTER(c_int))
        count(self._read_pointer, byref(left), byref(done))
        return left.value < SPARE

    def take_back(self, pointer: int) -> None:
        """A frame's memory that nobody refers to any more."""
        with self._lock:
            if self._pointer is not None:
                self._push(self._pointer, pointer)
                return
        self._unref(pointer)

    def missing_packets(self) -> int:
        """Packets that never came, since the stream was opened."""
        told = function("arv_stream_get_info_uint64_by_name", c_uint64, c_void_p, c_char_p)
        return int(told(self._read_pointer, b"n_missing_packets"))

    def close(self) -> None:
        """No more frames; images that are still referred to stay. Takes seconds where the camera does not answer."""
        with self._lock:
            pointer, self._pointer = self._pointer, None
        if pointer is not None:
            unref(pointer)

    def _began_ns(self, told_ns: int, monotonic_ns: int, wall_ns: int) -> int:
        """Aravis notes by the wall clock when a frame began to arrive."""
        before, self._clocks = self._clocks, (monotonic_ns, wall_ns)
        run_ns = monotonic_ns - before[0]
        was_set = abs(wall_ns - before[1] - run_ns) > _STEP_NS + run_ns // 1000
        ago_ns = wall_ns - told_ns
        return monotonic_ns - ago_ns if not was_set and 0 <= ago_ns < 1_000_000_000 else monotonic_ns


def _told(what: str, result: Any, pointer: int) -> int:
    return int(function(f"arv_buffer_get_{what}", result, c_void_p)(pointer))


def _padding(pointer: int) -> int:
    behind_row, behind_image = c_int(), c_int()
    told = function("arv_buffer_get_image_padding", None, c_void_p, POINTER(c_int), POINTER(c_int))
    told(pointer, byref(behind_row), byref(behind_image))
    return behind_row.value
