"""Where robots were located by light, frame by frame, in the world."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats

TILTS = 2


class Located(NamedTuple):
    """n poses T_world_robot. ``robots`` (n,) by their place among the rig's; ``times_s`` (n,) of one axis, not always
    in order; ``rotations`` (n, 2, 3, 3) and ``ts`` (n, 2, 3) m by both tilts, the second nan where there is no doubt;
    ``covariances`` (n, 6, 6) of the first, m and rad about the world's axes.
    """

    robots: NDArray[np.int64]
    times_s: Floats
    rotations: Floats
    ts: Floats
    covariances: Floats

    def __getitem__(self, rows: object) -> "Located":  # type: ignore[override]
        return Located(*(part[rows] for part in (self.robots, self.times_s, self.rotations, self.ts, self.covariances)))
