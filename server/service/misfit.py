"""Says what to calibrate where robots are found, but not where their rig has their LEDs."""

from collections import deque
from collections.abc import Iterable

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import FrameResult
from asterism.server.pose.fit import LEDS
from asterism.server.pose.solve import PoseEstimate

WORTH_PX = 0.15  # light alone, a neighbour's or a dome's, moves a spot less
BEYOND_NOISE = 4.0  # times what the spots' own noise leaves
LEAST_FRAMES = 5
MOST_FRAMES = 200  # the newest count
FEW_ROBOTS = 2  # from so many on, all of which are off, it may be the lens
SHAPED = 0.6  # correlation of residuals with what a wrong distortion leaves, from which on it is


class Misfits:
    """Residuals of robots with six LEDs. Written by `add` for every frame; ``robots`` are the ids of the rig's."""

    def __init__(self, robots: Iterable[str]) -> None:
        self._rms: dict[str, deque[float]] = {robot: deque(maxlen=MOST_FRAMES) for robot in robots}
        self._newest: dict[str, tuple[PoseEstimate, FrameResult]] = {}

    def add(self, result: FrameResult) -> None:
        """Count one frame."""
        for robot, answer in result.answers.items():
            if isinstance(answer, PoseEstimate) and len(answer.leds) == LEDS:
                self._rms[robot].append(answer.rms_px)
                self._newest[robot] = answer, result

    def off_px(self) -> dict[str, float]:
        """The robots whose LEDs are not where the rig has them, and how far off, px: the median of the frames."""
        off = {}
        for robot, (answer, result) in list(self._newest.items()):
            rms = list(self._rms[robot])
            typical = float(np.median(rms))
            own = result.blobs.covariances_px2[list(answer.spots)]
            noise = float(np.sqrt(np.mean(own[:, 0] + own[:, 2]) / 2.0))
            if len(rms) >= LEAST_FRAMES and typical > max(WORTH_PX, BEYOND_NOISE * noise):
                off[robot] = typical
        return off

    def told(self, rig: Rig, said: set[str]) -> list[str]:
        """Sentences about robots that are not among the ``said``, which they then are."""
        off = self.off_px()
        new = {robot: px for robot, px in off.items() if robot not in said}
        if not new:
            return []
        said.update(new)
        if len(off) == len(self._newest) >= FEW_ROBOTS and self._shape(rig) > SHAPED:
            said.update(self._rms)
            return [
                f"all robots' LEDs are off by {float(np.median(list(off.values()))):.2g} px, the more so the farther "
                f"from the middle of the image: run {typed('calibrate', 'camera', 'SOURCE', '-o', 'camera.yaml')}"
            ]
        return [
            f"{robot}: its LEDs are off by {px:.2g} px from where the rig has them: run "
            f"{typed('calibrate', 'leds', 'RIG', 'RECORDING', '--robot', robot, '-o', 'OUT')}"
            for robot, px in new.items()
        ]

    def _shape(self, rig: Rig) -> float:
        """Correlation of all newest residuals with what a wrong radial distortion would leave after poses are fit."""
        seen: list[Floats] = []
        expected: list[Floats] = []
        camera = rig.camera
        focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
        for answer, result in list(self._newest.values()):
            at = result.blobs.centres_px[list(answer.spots)] - camera.matrix[:2, 2]
            bent = at * (at**2).sum(axis=1, keepdims=True) / focal**2
            # A pose takes up what an affine map does.
            basis = np.column_stack([at - at.mean(axis=0), np.ones(LEDS)])
            bent = bent - basis @ np.linalg.lstsq(basis, bent, rcond=None)[0]
            seen.append(answer.residuals_px.ravel())
            expected.append(bent.ravel())
        a, b = np.concatenate(seen), np.concatenate(expected)
        return abs(float(a @ b)) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)
