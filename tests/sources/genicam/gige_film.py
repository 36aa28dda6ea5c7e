"""What tests of the emulated camera share: a film that tells its frames apart, a rig, its frames."""

import itertools

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.capture import Capture
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.source import Source
from tests.rigs import make_camera, make_rig
from tests.sources.genicam.fake_camera import ADDRESS

WIDTH, HEIGHT = 64, 48
BY_ADDRESS = f"genicam:{ADDRESS}"
_PLAIN = make_rig(1, camera=make_camera(WIDTH, HEIGHT, 80.0))
FILM = np.random.default_rng(3).integers(0, 256, (200, HEIGHT, WIDTH)).astype(np.uint8)
FILM[:, 1, 0] = np.arange(len(FILM))


def rig_with(**capture: object) -> Rig:
    """A rig of that size, 100 Hz and 400 us."""
    return Rig(_PLAIN.camera, _PLAIN.robots, capture=Capture(**{"rate_hz": 100.0, "exposure_us": 400.0} | capture))


def frames(source: Source, count: int) -> list[Frame]:
    """So many; then the camera is let go."""
    stream = source.frames()
    taken = list(itertools.islice(stream, count))
    stream.close()
    return taken


def number_of(image: NDArray[np.uint8]) -> int:
    """Which one of the film it is."""
    return int(image[1, 0])


def assert_is_of_the_film(image: NDArray[np.uint8]) -> None:
    """Whole; the first row holds when it was sent."""
    np.testing.assert_array_equal(image[1:], FILM[number_of(image), 1:])


def silent(text: str) -> None:
    """Nobody listens."""
