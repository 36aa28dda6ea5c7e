"""Where robots touched what they stand on: a point of each in every frame, how sure it is, and what is wrong in all."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """n touches, in the world. ``ids`` (r,) are the robots, ``names`` (r,) the point by which each stands.

    ``points`` (n, 3) m and ``covariances`` (n, 3, 3) m^2 of what is new in every touch; ``axes`` (n, 3) unit, what is
    to be along the normal, and ``axis_covariances`` (n, 3, 3) rad^2; ``rotations`` (n, 3, 3) T_world_robot's;
    ``other_points`` and ``other_axes`` (n, 3) by the pose's other tilt, nan where there is no doubt. ``robots`` (n,) by
    their place in ``ids``; ``times_s`` (n,); ``frames`` (n,) how many frames one touch stands for.

    ``shared`` (n, 3, k) m: how the point moves for one sigma of each of k causes that its robot's touches share, and no
    other robot's (where its LEDs are).
    """

    ids: tuple[str, ...]
    names: tuple[str, ...]
    robots: NDArray[np.int64]
    times_s: Floats
    frames: NDArray[np.int64]
    points: Floats
    covariances: Floats
    axes: Floats
    axis_covariances: Floats
    rotations: Floats
    other_points: Floats
    other_axes: Floats
    shared: Floats

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, rows: "NDArray[np.bool_] | NDArray[np.int64]") -> "Contacts":
        parts = [each.name for each in fields(self) if each.name not in ("ids", "names")]
        return replace(self, **{name: getattr(self, name)[rows] for name in parts})

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """Which have two tilts (n,)."""
        return np.isfinite(self.other_points[:, 0])

    def by_other_tilt(self, rows: NDArray[np.bool_]) -> "Contacts":
        """With the other tilt in those rows (n,)."""
        which = rows[:, None]
        return replace(
            self,
            points=np.where(which, self.other_points, self.points),
            axes=np.where(which, self.other_axes, self.axes),
            other_points=np.where(which, self.points, self.other_points),
            other_axes=np.where(which, self.axes, self.other_axes),
        )
