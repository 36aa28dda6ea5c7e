"""Where robots were located by light, frame by frame, in the world."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose

TILTS = 2


@dataclass(frozen=True, slots=True)
class Sight:
    """One robot in one frame: ``pose`` T_world_robot by light alone, its ``covariance`` (6, 6), m and rad about the
    world's axes, and the ``other`` tilt that explains the spots, None where there is no doubt.
    """

    robot: str
    time_s: float
    pose: Pose
    covariance: Floats
    other: Pose | None


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """n poses T_world_robot, robot by robot. ``robots`` (n,) by their place in ``ids``; ``times_s`` (n,); ``rotations``
    (n, 2, 3, 3) and ``ts`` (n, 2, 3) m by both tilts, the second nan where there is no doubt; ``covariances`` (n, 6, 6)
    of the first, m and rad about the world's axes.
    """

    ids: tuple[str, ...]
    robots: NDArray[np.int64]
    times_s: Floats
    rotations: Floats
    ts: Floats
    covariances: Floats

    @staticmethod
    def of(ids: tuple[str, ...], sights: list[Sight]) -> "Located":
        """Those of the robots ``ids``, robot by robot in the order of time."""
        kept = sorted((each for each in sights if each.robot in ids), key=lambda s: (ids.index(s.robot), s.time_s))
        n = len(kept)
        rotations, ts = np.full((n, TILTS, 3, 3), np.nan), np.full((n, TILTS, 3), np.nan)
        for k, sight in enumerate(kept):
            for tilt, pose in enumerate((sight.pose, sight.other)):
                if pose is not None:
                    rotations[k, tilt], ts[k, tilt] = pose.rotation, pose.position
        return Located(
            ids,
            np.array([ids.index(sight.robot) for sight in kept], np.int64),
            np.array([sight.time_s for sight in kept], np.float64),
            rotations,
            ts,
            np.array([sight.covariance for sight in kept], np.float64).reshape(n, 6, 6),
        )
