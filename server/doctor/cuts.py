"""Pixels of some LEDs' spots, kept for measuring the lens's blur: a few of each robot, spread over the frames."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import Fate
from asterism.protocol.rig import Rig
from asterism.server.centres.blobs import Blobs
from asterism.server.pose.solve import PoseEstimate
from asterism.server.segmentation.spot_table import NOISE, SEMI_A, SEMI_B, TOUCHING, WX0, WX1, WY0, WY1, X, Y

MOST = 6  # sightings of a robot
UNKNOWN = -1  # the robot of spots that are nobody's
MOST_UNKNOWN, ROUND = 12, 2.0  # spots that are nobody's, and how long they may be for their width
MARGIN = 3  # px around a spot's own window: the foot of a wide blur
WIDEST = 96  # px of a window: wider ones are no spots
NOBODYS = (Fate.UNEXPLAINED, Fate.TOO_LARGE, Fate.MISSHAPEN, Fate.TOO_FAINT, Fate.ELONGATED)


class Cut(NamedTuple):
    """One spot. ``distances`` (n,) px of its pixels from its centre, in a circle's coordinates, and their ``values``
    (n,) grey levels; ``px_per_m`` of the LED's radius (of unknown spots: px a unit of ``size``); ``noise`` grey levels.
    """

    robot: int
    distances: Floats
    values: Floats
    px_per_m: float
    noise: float


class Cutter:
    """Keeps the newest of each robot, and drops every other one where there are too many."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._kept: dict[int, list[list[Cut]]] = {}  # by robot, sighting by sighting
        self._skip: dict[int, int] = {}
        self._seen: dict[int, int] = {}

    @property
    def cuts(self) -> list[Cut]:
        """All."""
        return self.newest(0)

    def newest(self, many: int) -> list[Cut]:
        """Those of so many of the newest sightings of each robot; 0: of all."""
        return [cut for kept in self._kept.values() for sighting in kept[-many:] for cut in sighting]

    def add(self, image: NDArray[np.uint8], blobs: Blobs, robot: int, pose: Pose, answer: PoseEstimate) -> None:
        """A robot's spots; ``pose`` T_camera_robot."""
        if not self._takes(robot):
            return
        axes = self._rig.robots[robot].T_robot_plane.rotation[:, :2]
        for led, row in zip(answer.leds, answer.spots, strict=True):
            spot = blobs.table[row]
            if spot[TOUCHING] == 0.0:
                centre = pose.map(self._rig.robots[robot].leds[led])
                by_plane = pixels_by_plane(self._rig, centre, pose.rotation @ axes)
                self._cut(image, spot, blobs.centres_px[row], robot, by_plane)

    def add_unknown(self, image: NDArray[np.uint8], blobs: Blobs) -> None:
        """The brightest spots of a frame in which nobody was found, as round as they look."""
        if not self._takes(UNKNOWN):
            return
        rows = [k for k in np.argsort(-blobs.heights)[: 2 * MOST_UNKNOWN].tolist() if blobs.fates[k] in NOBODYS]
        for spot in blobs.table[rows[:MOST_UNKNOWN]]:
            if spot[SEMI_A] < ROUND * spot[SEMI_B]:
                self._cut(image, spot, spot[[X, Y]], UNKNOWN, np.eye(2) * math.sqrt(spot[SEMI_A] * spot[SEMI_B]))

    def _takes(self, robot: int) -> bool:
        """Whether this sighting is one to keep: every so many, the farther apart the longer it goes on."""
        self._seen[robot] = self._seen.get(robot, -1) + 1
        kept, skip = self._kept.setdefault(robot, []), self._skip.get(robot, 1)
        if len(kept) > MOST:
            del kept[::2]
            skip = self._skip[robot] = 2 * skip
        if self._seen[robot] % skip == 0:
            kept.append([])
            return True
        return False

    def _cut(self, image: NDArray[np.uint8], spot: Floats, centre: Floats, robot: int, by_plane: Floats) -> None:
        height, width = image.shape
        x0, x1 = max(int(spot[WX0]) - MARGIN, 0), min(int(spot[WX1]) + MARGIN, width)
        y0, y1 = max(int(spot[WY0]) - MARGIN, 0), min(int(spot[WY1]) + MARGIN, height)
        scale = math.sqrt(abs(float(np.linalg.det(by_plane))))
        if max(x1 - x0, y1 - y0) > WIDEST or scale <= 0.0:
            return
        v, u = np.mgrid[y0:y1, x0:x1]
        off = np.stack([u - centre[0], v - centre[1]], axis=-1).reshape(-1, 2)
        # A tilted disc is a circle in coordinates that undo the tilt and keep the area.
        round_off = off @ (scale * np.linalg.inv(by_plane)).T
        values = image[y0:y1, x0:x1].ravel().astype(np.float64)
        cut = Cut(robot, np.hypot(*round_off.T), values, scale, float(spot[NOISE]))
        self._kept[robot][-1].append(cut)


def pixels_by_plane(rig: Rig, point: Floats, axes: Floats) -> Floats:
    """Derivatives (2, 2), px per m, of the pixel of a point (3,) m by moves along two axes (3, 2), camera's frame."""
    step = 1e-5 * float(np.linalg.norm(point))
    ahead, behind = (rig.camera.project(point + sign * step * axes.T) for sign in (1.0, -1.0))
    by_plane: Floats = (ahead - behind).T / (2.0 * step)
    return by_plane
