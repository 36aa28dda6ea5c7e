"""Whether the camera was moved or its lens touched: by where it sees constellations that do not move (`fixed`).

Their spots are compared with where they were in the first minute. Several things move spots: the camera (six numbers),
the lens' focal length and its distortion (two), these and its principal point (four), a constellation that does move
(six), an LED (two). The one that leaves least, for as few numbers as it has, is named.

What can be told apart. A focal length against a camera that moved along its axis: by constellations at different
distances alone; else the two numbers of the lens are the simpler explanation. A principal point against a camera that
turned: by what turning bends in spots far from the middle, a hundredth of it at 10 degrees; else the camera is named.
One constellation alone tells six numbers, which any of them explains; the camera stands for all. And without one
nothing can be told: a robot's own residuals show a focal length that is 0.05 % off by less than 0.001 px, since its
pose takes the rest.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.server.calibration.lens.values import pixels_by_lens
from asterism.server.pose.fit import LEDS
from asterism.server.pose.place import turning
from asterism.server.service.alarm import Finding, step_of

BASELINE = 60  # seconds in which an LED was seen tell where it is
RECENT = 9  # seconds are judged, by their median
LEAST_PX, MOST_PX = 0.02, 0.1  # one sigma of a coordinate of that median: light and pixels change it over hours
FEWEST = 4  # LEDs
SURE = 50.0  # chi squared that an explanation takes off
MOVED_PX = 0.2  # RMS, by which a camera, or a constellation, that moved is worth saying: 0.008 degrees at 1400 px
FOCAL = 0.0003  # a change of the focal length that is worth saying, of it: warmth alone changes it by 0.01 %
BENT_PX = 0.1  # RMS of spots, by which a lens that was touched is worth saying
STEP = 1e-6  # m, of numeric derivatives


class Cause(NamedTuple):
    """Something that moves spots: ``by`` (6 n, 2, k), the spots' derivatives by its k numbers; ``cost`` in units of chi
    squared, of believing in it.
    """

    what: str
    by: Floats
    cost: float


class CameraWatch:
    """A rig's fixed constellations; `add` every second, then ask for a `finding`."""

    def __init__(self, rig: Rig) -> None:
        self.robots = [k for k, robot in enumerate(rig.robots) if robot.T_world_fixed is not None]
        self._names = [rig.robots[k].id for k in self.robots]
        n = LEDS * len(self.robots)
        self._early: list[list[Floats]] = [[] for _ in range(n)]
        self._usual = np.full((n, 2), np.nan)
        self._sigma_px = LEAST_PX
        self._recent: deque[tuple[int, Floats]] = deque(maxlen=4 * BASELINE)
        self._causes = _causes_of(rig) if self.robots else []
        self._follows = rig.follows_world

    def add(self, time_ns: int, spots: Floats) -> None:
        """One more second: ``spots`` (constellations, 6, 2) px, in the rig's order, nan where not seen."""
        flat = spots.reshape(-1, 2)
        self._recent.append((time_ns, flat))
        for k in np.flatnonzero(np.isnan(self._usual[:, 0]) & np.isfinite(flat[:, 0])):
            early = self._early[k]
            early.append(flat[k])
            if len(early) == BASELINE:
                self._usual[k] = np.median(early, axis=0)
                spread = 1.5 * float(np.median(np.abs(early - self._usual[k])))
                self._sigma_px = min(max(self._sigma_px, 2.0 * spread), MOST_PX)

    def renumbered(self, new: "CameraWatch") -> "CameraWatch":
        """The same watch where the constellations have other numbers in the rig, those of ``new``; ``new`` itself where
        they are in another order.
        """
        if self._names != new._names:
            return new
        self.robots = new.robots
        return self

    def finding(self) -> Finding | None:
        """What has changed since the first minute, if anything has."""
        if len(self._recent) < RECENT:
            return None
        newest = [spots for _, spots in list(self._recent)[-RECENT:]]
        seen = np.isfinite(self._usual[:, 0]) & (np.isfinite(newest)[..., 0].mean(axis=0) > 0.5)
        if seen.sum() < FEWEST:
            return None
        moved = np.nanmedian(np.array(newest)[:, seen], axis=0) - self._usual[seen]
        cause, numbers, left = self._likeliest(moved, seen)
        before = float((moved**2).sum()) / self._sigma_px**2
        if before - left < SURE:
            return None
        if self._follows and cause.what == "camera":
            self._begin_anew()
            return None
        explained = cause.by[seen] @ numbers
        size_px = float(np.sqrt((explained**2).sum() / np.any(cause.by[seen] != 0.0, axis=(1, 2)).sum()))
        text = self._text(cause.what, numbers, size_px)
        if not text:
            return None
        remedy = f"run {typed('calibrate', 'world', 'RIG', 'SOURCE', '--fixed', '-o', 'OUT')}"
        if cause.what.startswith("lens"):
            remedy = f"run {typed('calibrate', 'camera', 'SOURCE', '-o', 'camera.yaml')}"
        return Finding(cause.what, text, remedy, self._since(explained, seen))

    def _begin_anew(self) -> None:
        """The camera is elsewhere, and is followed: what is usual is found anew."""
        self._usual[:] = np.nan
        self._early = [[] for _ in self._early]
        self._recent.clear()

    def _likeliest(self, moved: Floats, seen: Floats) -> tuple[Cause, Floats, float]:
        """The cause that leaves least, its numbers, and what it leaves, chi squared."""
        best: tuple[float, Cause, Floats, float] | None = None
        for cause in self._causes:
            by = cause.by[seen].reshape(-1, cause.by.shape[2])
            scale = np.maximum(np.linalg.norm(by, axis=0), 1e-12)
            numbers = np.linalg.lstsq(by / scale, moved.ravel(), rcond=1e-6)[0] / scale
            left = float(((moved.ravel() - by @ numbers) ** 2).sum()) / self._sigma_px**2
            if best is None or left + cause.cost < best[0]:
                best = left + cause.cost, cause, numbers, left
        assert best is not None
        return best[1:]

    def _text(self, what: str, numbers: Floats, size_px: float) -> str:
        """By how much, in words; nothing where it is not worth saying."""
        if what.startswith("lens"):
            if size_px < (BENT_PX if abs(numbers[0]) > FOCAL else 2.0 * BENT_PX):
                return ""
            return f"the lens was touched: its focal length changed by {numbers[0]:+.3%}, spots by {size_px:.2g} px"
        if what.startswith("led") or size_px < MOVED_PX:
            return ""  # single LEDs have a watch of their own
        how_far = (
            f"{1e3 * np.linalg.norm(numbers[:3]):.2f} mm and {np.degrees(np.linalg.norm(numbers[3:])):.3f} degrees"
        )
        if what == "camera":
            which = f"the camera, its lens or {self._names[0]}" if len(self._names) == 1 else "the camera"
            return f"{which} was moved by {how_far}"
        return f"{what}, which the rig has as fixed, was moved by {how_far}"

    def _since(self, explained: Floats, seen: Floats) -> int:
        """When spots began to be off that way."""
        size2 = float((explained**2).sum())
        times, shares = [], []
        for time_ns, spots in self._recent:
            off = np.nan_to_num(spots[seen] - self._usual[seen])
            times.append(time_ns)
            shares.append(float((off * explained).sum()) / size2)
        return times[step_of(shares)]


def _causes_of(rig: Rig) -> list[Cause]:
    """What may move the spots of the rig's fixed constellations."""
    assert rig.T_world_camera is not None
    T_camera_world = rig.T_world_camera.inverse()
    poses = [(robot, T_camera_world @ robot.T_world_fixed) for robot in rig.robots if robot.T_world_fixed is not None]
    points = np.concatenate([pose.map(robot.leds) for robot, pose in poses])
    by_point = _by_point(rig, points)
    by_lens = pixels_by_lens(rig.camera, points)
    focal = by_lens[:, :, :2] @ np.diag(rig.camera.matrix)[:2]
    lens = np.stack([focal, by_lens[:, :, 4], by_lens[:, :, 2], by_lens[:, :, 3]], axis=-1)
    lenses = [Cause("lens", lens[..., :2], 4.0), Cause("lens and its middle", lens, 30.0)]
    causes = [
        *(lenses if len(poses) > 1 else []),
        Cause("camera", -np.concatenate([by_point, by_point @ turning(points)], axis=-1), 22.0),
    ]
    for k, (robot, _) in enumerate(poses):
        mine = slice(LEDS * k, LEDS * (k + 1))
        arms = points[mine] - points[mine].mean(axis=0)
        by = np.zeros((len(points), 2, 6))
        by[mine] = np.concatenate([by_point[mine], by_point[mine] @ turning(arms)], axis=-1)
        causes.append(Cause(robot.id, by, 26.0))
        for led in range(LEDS):
            by = np.zeros((len(points), 2, 2))
            by[mine.start + led] = np.eye(2)
            causes.append(Cause(f"led {robot.id} {led}", by, 14.0))
    return causes


def _by_point(rig: Rig, points: Floats) -> Floats:
    """Derivatives (n, 2, 3), px / m, of the pixels of points (n, 3) m in the camera's frame."""
    shifts = STEP * np.eye(3)[:, None]
    by_axis = (rig.camera.project(points + shifts) - rig.camera.project(points - shifts)) / (2.0 * STEP)
    return np.moveaxis(by_axis, 0, -1)
