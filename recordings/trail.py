"""Where a robot went of late."""

from collections import deque

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Robot

KEPT = 600  # poses
_EVERY = 5  # pose a trail is drawn anew, until it has all that is kept


class Trail:
    """Of a robot's origin; of one that stands on a surface of the point it stands on, as long as it stands there."""

    def __init__(self, robot: Robot) -> None:
        stands = robot.stands
        self._point = robot.points[stands.point] if stands else np.zeros(3)
        self._kept: deque[Floats | None] = deque(maxlen=KEPT)  # None: it stood nowhere

    def go(self, robot: "pb.RobotReport", pose: Pose) -> None:
        """Its next pose, and what is reported of it."""
        if not robot.HasField("surface"):
            self._kept.append(pose.position)
        else:
            self._kept.append(pose.map(self._point) if robot.surface.standing == pb.ON_SURFACE else None)

    @property
    def due(self) -> bool:
        """Whether it is time to draw it."""
        return len(self._kept) % _EVERY == 0 or len(self._kept) == KEPT

    def pieces(self) -> list[Floats]:
        """The lines (n, 3) that it is made of, m."""
        pieces: list[list[Floats]] = [[]]
        for point in self._kept:
            if point is not None:
                pieces[-1].append(point)
            elif pieces[-1]:
                pieces.append([])
        return [np.array(piece) for piece in pieces if piece]
