"""A server whose camera shows one film again and again, forwards and backwards, so that nothing jumps:
`python -m tests.measure.looped_camera FILM.npy RATE RIG [options of asterism serve]`.

FILM.npy holds frames (n, h, w) uint8; the server's source is a camera as any other, which does not wait.
"""

import subprocess
import sys
import time
from itertools import chain, cycle
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.rig import Rig, load_rig
from asterism.server.__main__ import main
from asterism.server.command import serve
from asterism.server.simulation.simulate import Scene
from asterism.server.sources.camera import Camera, Taken
from asterism.server.sources.source import Say
from tests.helpers import REPOSITORY


class LoopedDevice:
    """In a driver's place: every image at its time, by a clock of its own; late readers find the newest."""

    def __init__(self, film: NDArray[np.uint8], rate_hz: float) -> None:
        self._film = film
        self._order = cycle(chain(range(len(film)), range(len(film) - 2, 0, -1)))
        self._step_s = 1.0 / rate_hz
        self._due_s = time.monotonic()

    def read(self) -> Taken:
        """The image that is due."""
        self._due_s += self._step_s
        while time.monotonic() - self._due_s > self._step_s:  # nobody took it
            next(self._order)
            self._due_s += self._step_s
        time.sleep(max(self._due_s - time.monotonic(), 0.0))
        return Taken(np.array(self._film[next(self._order)]))  # a driver's buffer is the reader's own

    def close(self) -> None:
        """Nothing is open."""


def write_film(rig_file: Path, rate_hz: float, frames: int, out: Path) -> None:
    """Render so many frames of a rig."""
    rig = load_rig(rig_file)
    scene = Scene(rig, 0)
    film = np.lib.format.open_memmap(out, "w+", np.uint8, (frames, rig.camera.height, rig.camera.width))
    for k in range(frames):
        film[k] = scene.render(k, scene.truth(k, k / rate_hz))
    film.flush()


def serve_film(
    rig: Path, folder: Path, rate_hz: float, *options: str | Path, frames: int = 240
) -> subprocess.Popen[bytes]:
    """Start `serve` of a rendered film of so many frames, and wait until it serves; film and log are in the folder."""
    film, log = folder / "film.npy", folder / "log.txt"
    if not film.exists():
        write_film(rig, rate_hz, frames, film)
    command = [sys.executable, "-m", "tests.measure.looped_camera", film, str(rate_hz), rig, *options]
    with log.open("w") as stream:
        server = subprocess.Popen(command, stderr=stream, cwd=REPOSITORY)
    while "serving" not in log.read_text():
        assert server.poll() is None, log.read_text()
        time.sleep(0.2)
    return server


if __name__ == "__main__":
    film, rate, rig_file, *options = sys.argv[1:]

    def open_fitting(name: str, rig: Rig, say: Say, *_: object) -> tuple[Rig, Camera]:
        return rig, Camera(name, lambda: LoopedDevice(np.load(film, mmap_mode="r"), float(rate)), rig, say)

    serve.open_fitting = open_fitting
    sys.argv[1:] = ["serve", rig_file, "looped", *options]
    sys.exit(main())
