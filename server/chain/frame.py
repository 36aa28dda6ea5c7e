"""What comes in and what goes out of the chain."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Clock
from asterism.server.centres.blobs import Blobs
from asterism.server.pose.place import Place
from asterism.server.pose.solve import Lost, PoseEstimate


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image.

    ``image`` (h, w) uint8, the size of the rig's camera; ``exposed_ns`` mid-exposure, ns since the Unix epoch;
    ``index`` counts the source's frames; ``name`` is the image's file name, if it has one; ``arrived_ns`` is when
    the image was in memory (`exposed_ns` where nobody measured it); ``clock`` says which clock gave ``exposed_ns``, and
    ``session`` in which of the server's sessions that was (0: in none, the times are a file's own).
    """

    image: NDArray[np.uint8]
    exposed_ns: int
    index: int
    name: str = ""
    arrived_ns: int = 0
    clock: Clock = Clock.FILE
    session: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """All that a frame told: every spot with its fate, and an answer for every robot of the rig.

    ``learned`` (robots,) m is what earlier frames had told of how far off the rig has each robot's LEDs, one sigma,
    and what the poses were solved with; 0 where they had told nothing. ``place`` is where the camera was taken to be,
    where the rig has it followed.
    """

    index: int
    exposed_ns: int
    blobs: Blobs
    answers: dict[str, PoseEstimate | Lost]
    learned: Floats
    place: Place | None = None
