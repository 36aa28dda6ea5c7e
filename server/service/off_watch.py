"""Whether constellations that do not move are seen where the rig has them, from the start on: a camera that was moved
while nobody served, or a wrong `fixed`. A survey is off by a little, so only much is said.
"""

from collections import deque

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.server.service.alarm import Finding

SECONDS = 30  # are judged, by their median
OFF_SHARE = 0.003  # of the distance, that is worth saying


class OffWatch:
    """The rig's fixed constellations; `add` every second for each that was seen, then ask for a `finding`."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._seen: dict[int, deque[Floats]] = {}
        self._began_ns = 0

    def add(self, time_ns: int, robot: int, position: Floats) -> None:
        """One more second: ``position`` (3,) m of a robot of the rig in the camera's frame."""
        self._began_ns = self._began_ns or time_ns
        self._seen.setdefault(robot, deque(maxlen=SECONDS)).append(position)

    def finding(self) -> Finding | None:
        """Who is seen elsewhere."""
        T, off = self._rig.T_world_camera, {}
        for number, positions in self._seen.items():
            robot = self._rig.robots[number]
            if T is None or robot.T_world_fixed is None or len(positions) < SECONDS:
                continue
            seen = np.median(positions, axis=0)
            away = float(np.linalg.norm(T.map(seen[None])[0] - robot.T_world_fixed.position))
            if away > OFF_SHARE * np.linalg.norm(seen):
                off[robot.id] = away
        if not off:
            return None
        told = ", ".join(f"{name} {1e3 * away:.1f} mm" for name, away in off.items())
        return Finding(
            "off",
            f"what is fixed is seen elsewhere than the rig has it: {told} away",
            f"run {typed('calibrate', 'world', 'RIG', 'SOURCE', '--fixed', '-o', 'OUT')}",
            self._began_ns,
        )
