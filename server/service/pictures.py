"""What passes between the server and the process that draws for its live view."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Picture(NamedTuple):
    """A frame to be drawn: its (h, w) image, and the encoded frame report."""

    image: NDArray[np.uint8]
    exposed_ns: int
    sequence: int
    report: bytes


class Opened(NamedTuple):
    """What the drawing process says first: where the viewer is to be found, or why there is none."""

    where: str = ""
    wrong_input: str = ""
    problem: str = ""
