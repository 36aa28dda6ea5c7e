"""Aravis' own emulated GigE Vision camera on loopback, showing our images: a real protocol over real sockets.

    python fake_camera.py FILM.npy [--lost SHARE] [--drift PPM] [--jump AFTER BY] [--xml FILE] [--truth]

FILM.npy holds frames (n, h, w) uint8, or bytes (n, size) of another pixel format; the k-th frame that is sent shows the
k-th, round and round. The camera's clock is the host's monotonic one, with an offset and a drift. It prints `ready`; to
every line on its input it answers with the number of frames sent.
"""

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import CFUNCTYPE, POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint32, c_uint64, c_void_p
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.server.sources.background import wait_for_background
from asterism.server.sources.genicam.pixel_formats import BY_NAME

ADDRESS, SERIAL = "127.0.0.1", "SN42"
_FILL = CFUNCTYPE(None, c_void_p, c_void_p, c_uint32, c_uint32, c_uint32)
_TRUTH = 8  # pixels that hold the moment at which a frame was taken


def needs_aravis() -> None:
    """Skip where the library is missing."""
    try:
        ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        pytest.skip("Aravis is not installed (apt install libaravis-0.8-0)")


class FakeCamera:
    """The emulator in a process of its own. One at a time on a machine: its port is fixed."""

    def __init__(self, folder: Path, film: NDArray[np.uint8], *options: str) -> None:
        np.save(folder / "film.npy", film)
        self._command = [sys.executable, __file__, str(folder / "film.npy"), *options]
        self.start()

    def start(self) -> None:
        """Plug it in."""
        self.process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def sent(self) -> int:
        """Frames since it was plugged in."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print("sent", file=self.process.stdin, flush=True)
        return int(self.process.stdout.readline())

    def unplug(self) -> None:
        """From one moment to the next."""
        self.process.kill()
        self.process.communicate()


@contextmanager
def fake_camera(folder: Path, film: NDArray[np.uint8], *options: str) -> Iterator[FakeCamera]:
    """A camera that is plugged in; waits for another test's to be unplugged."""
    import fcntl

    needs_aravis()
    with (Path(tempfile.gettempdir()) / f"asterism-fake-camera-{os.getuid()}").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        camera = FakeCamera(folder, film, *options)
        try:
            yield camera
            wait_for_background(2.0)  # letting go of a camera that is gone takes seconds
        finally:
            camera.unplug()


def described(folder: Path, *more: str) -> Path:
    """The description of a camera that has more than Aravis' own: pixel formats by name, or `feature=value`."""
    needs_aravis()
    library = ctypes.CDLL("libaravis-0.8.so.0")
    new, read = library.arv_fake_camera_new, library.arv_fake_camera_get_genicam_xml
    new.restype, new.argtypes = c_void_p, [c_char_p]
    read.restype, read.argtypes = c_void_p, [c_void_p, POINTER(c_size_t)]
    size = c_size_t()
    xml = ctypes.string_at(read(new(b"X"), byref(size)), size.value).decode()
    for word in more:
        name, _, value = word.partition("=")
        if value:
            before, text = '<Integer Name="SensorHeight"', f'<Integer Name="{name}"><Value>{value}</Value></Integer>'
        else:
            before, number = '<EnumEntry Name="Mono16"', BY_NAME[name].number
            text = f'<EnumEntry Name="{name}" NameSpace="Standard"><Value>{number}</Value></EnumEntry>'
        assert before in xml
        xml = xml.replace(before, text + before, 1)
    file = folder / "camera.xml"
    file.write_text(xml)
    return file


def truth_of(image: NDArray[np.uint8]) -> int:
    """When a frame of `--truth` was taken, by the host's monotonic clock."""
    return int(image[0, :_TRUTH].copy().view("<u8")[0])


def _main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("film", type=Path)
    parser.add_argument("--lost", type=float, default=0.0, help="share of packets")
    parser.add_argument("--packet", type=int, default=1400, help="bytes of a packet")
    parser.add_argument("--drift", type=float, default=0.0, help="ppm")
    parser.add_argument("--jump", type=float, nargs=2, metavar=("AFTER", "BY"), help="s")
    parser.add_argument("--truth", action="store_true", help="the first pixels hold when a frame was taken")
    parser.add_argument("--xml", type=Path, help="the camera's description, instead of Aravis' own")
    options = parser.parse_args()
    film = np.load(options.film, mmap_mode="r")
    library = ctypes.CDLL("libaravis-0.8.so.0")
    gobject = ctypes.CDLL("libgobject-2.0.so.0")

    def function(name, result, *arguments):
        found = getattr(library, name)
        found.restype, found.argtypes = result, arguments
        return found

    new = function("arv_gv_fake_camera_new_full", c_void_p, c_char_p, c_char_p, c_char_p)
    xml = None if options.xml is None else str(options.xml).encode()
    camera = new(ADDRESS.encode(), SERIAL.encode(), xml)
    if not function("arv_gv_fake_camera_is_running", c_int, c_void_p)(camera):
        sys.exit("the emulated camera does not run: is its port taken?")
    fake = function("arv_gv_fake_camera_get_fake_camera", c_void_p, c_void_p)(camera)
    gobject.g_object_set.argtypes = [c_void_p, c_char_p]
    gobject.g_object_set(c_void_p(camera), b"gvsp-lost-ratio", c_double(options.lost), c_void_p(None))
    function("arv_fake_camera_write_register", c_int, c_void_p, c_uint32, c_uint32)(fake, 0x0D04, options.packet)
    data_of = function("arv_buffer_get_data", c_void_p, c_void_p, POINTER(c_size_t))
    set_stamp = function("arv_buffer_set_timestamp", None, c_void_p, c_uint64)
    began_ns, sent = time.monotonic_ns(), 0

    def camera_ns(host_ns: int) -> int:
        run_ns = host_ns - began_ns
        offset_s = 1000.0
        if options.jump and run_ns > options.jump[0] * 1e9:
            offset_s += options.jump[1]
        return round(run_ns * (1 + options.drift * 1e-6) + 1e9 * offset_s)

    @_FILL
    def fill(buffer: int, _data: int, _exposure: int, _gain: int, _format: int) -> None:
        nonlocal sent
        size = c_size_t()
        image, data = np.ascontiguousarray(film[sent % len(film)]), data_of(buffer, byref(size))
        ctypes.memmove(data, image.ctypes.data, image.nbytes)
        now_ns = time.monotonic_ns()
        if options.truth:
            ctypes.memmove(data, now_ns.to_bytes(_TRUTH, "little"), _TRUTH)
        set_stamp(buffer, camera_ns(now_ns))
        sent += 1

    function("arv_fake_camera_set_fill_pattern", None, c_void_p, _FILL, c_void_p)(fake, fill, None)
    print("ready", flush=True)
    for _ in sys.stdin:
        print(sent, flush=True)


if __name__ == "__main__":
    _main()
