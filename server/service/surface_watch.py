"""Whether the surface is where the rig has it: by robots that agree that it is not.

One robot that is off may be lifted; that its own report says. What is wrong with the surface all robots see: how high
it is and its two tilts, three numbers, are fit to how far the newest frames have each robot off it by light alone. A
frame's noise is less in the mean of many, what else makes a robot off is not: how it stands, and what light alone gets
wrong of it in the same way each time. How much of what light alone may be wrong by is noise, its changes from one frame
to the next tell.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, matrix_from_quat
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Heights
from asterism.protocol.surface_file import Stands
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.pose.solve import PoseEstimate
from asterism.server.service.alarm import Alarm, Finding

NEWEST = 20  # frames of a robot that are judged
FEWEST = 3
FORGOTTEN_NS = 2_000_000_000  # a robot that has not been over the surface for so long has no say
SURE = 33.0  # chi squared of three numbers: as improbable as 5 sigma of one
WITHOUT = 16.3  # chi squared that is left whichever robot is not heard: once in a thousand times by chance
ODD = 22.0  # of a robot that does not agree with the others: 4 sigma
SETTLED = 10  # frames before the newest, after which a robot that is off alone may be one that was lifted
BEFORE = 4.0  # frames that believing light's own sigma counts as, beside what changes tell


class Sight(NamedTuple):
    """A robot in a frame by light alone: where on the surface's frame, ``xy`` (2,) m; ``off`` (3,): its distance from
    the surface, m, and dz/dx, dz/dy of its axis' plane against the surface's; ``light`` (3,): one sigma of that by
    light alone.
    """

    xy: Floats
    off: Floats
    light: Floats


@dataclass(slots=True)
class _Robot:
    stands: Stands
    seen: deque[Sight] = field(default_factory=lambda: deque(maxlen=NEWEST))
    seen_ns: int = 0
    before: int = 0  # frames before those
    before_off: Floats = field(default_factory=lambda: np.zeros(3))  # their mean

    def add(self, sight: Sight, now_ns: int) -> None:
        """One more."""
        if len(self.seen) == NEWEST:
            self.before += 1
            self.before_off = self.before_off + (self.seen[0].off - self.before_off) / self.before
        self.seen.append(sight)
        self.seen_ns = now_ns

    def was_elsewhere(self, off: Floats) -> bool:
        """Whether it was nearer to the surface before than to where it is now: then it is the robot that moved."""
        return self.before >= SETTLED and bool(2.0 * self.before_off[0] * off[0] < off[0] ** 2)


class Told(NamedTuple):
    """A robot's newest frames: the mean of its places and of how far it is off, with variances (3,) that do not count
    the surface's own.
    """

    robot: str
    xy: Floats
    off: Floats
    variances: Floats


class Fit(NamedTuple):
    """Robots that agree: the surface is ``off`` (3,) m at ``middle`` (2,) m, and in dz/dx and dz/dy; one ``sigma_m`` of
    the first; ``chi2`` against the surface as the rig has it.
    """

    robots: tuple[str, ...]
    off: Floats
    sigma_m: float
    chi2: float


class SurfaceWatch:
    """`add` every frame, in order; ``say`` takes sentences. For one thread; `problem` for any."""

    def __init__(self, rig: Rig, say: Callable[[str], None]) -> None:
        self._rig = rig
        self._say = say
        self._robots = {robot.id: _Robot(robot.stands) for robot in rig.robots if robot.stands is not None}
        self._alarm = Alarm()
        self._began_ns = 0

    @property
    def watches(self) -> bool:
        """Whether there is anything to watch."""
        return self._rig.surface is not None and bool(self._robots)

    @property
    def problem(self) -> str:
        """What is wrong now, as part of a sentence; empty where nothing is."""
        return self._alarm.problem

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return "" if self._alarm.raised is None else self._alarm.raised.remedy

    def watched(self, located: Iterator[tuple[Frame, FrameResult]]) -> Iterator[tuple[Frame, FrameResult]]:
        """The same frames, looked at."""
        for frame, result in located:
            self.add(result)
            yield frame, result

    def add(self, result: FrameResult) -> None:
        """One more frame: says what begins to be wrong, and what no longer is."""
        if not self.watches or not self._take(result):
            return
        fit = self._agreed(result.exposed_ns)
        if fit is None:
            self._began_ns = 0 if self._alarm.raised is None else self._began_ns
            self._alarm.look(None, self._say)
            return
        self._began_ns = self._began_ns or result.exposed_ns
        self._alarm.look(self._finding(fit), self._say)

    def _take(self, result: FrameResult) -> bool:
        """Whether a robot was seen over the surface."""
        seen = [
            (robot, answer)
            for robot, answer in result.answers.items()
            if robot in self._robots and isinstance(answer, PoseEstimate) and _tells(answer)
        ]
        for (robot, _), sight in zip(seen, self._sights(seen), strict=True):
            self._robots[robot].add(sight, result.exposed_ns)
        return bool(seen)

    def _sights(self, seen: list[tuple[str, PoseEstimate]]) -> list[Sight]:
        surface = self._rig.surface
        if surface is None or not seen:
            return []
        places, axes = [], []
        for robot, answer in seen:
            assert answer.surface is not None
            pose = answer.surface.without or answer.pose
            points = next(entry.points for entry in self._rig.robots if entry.id == robot)
            stands, turn = self._robots[robot].stands, matrix_from_quat(pose.orientation)
            places.append(pose.position + turn @ points[stands.point])
            axes.append(turn @ stands.axis)
        frame = surface.T_world_surface
        xy = ((np.array(places) - frame.position) @ frame.rotation)[:, :2]
        axis = np.array(axes) @ frame.rotation
        slopes = -axis[:, :2] / np.maximum(axis[:, 2:], 0.1) - surface.ground(xy).slopes
        return [
            self._sight(place, slope, robot, answer)
            for place, slope, (robot, answer) in zip(xy, slopes, seen, strict=True)
        ]

    def _sight(self, xy: Floats, slope: Floats, robot: str, answer: PoseEstimate) -> Sight:
        """What the sigmas of light alone are is what is left of those that count stand and surface in."""
        told, stands = answer.surface, self._robots[robot].stands
        surface = self._rig.surface
        assert told is not None
        assert surface is not None
        known = surface.ground(xy[None])
        off2 = told.off_sigma_m**2 - stands.sigma_m**2 - float(known.sigmas[0]) ** 2
        tilt2 = told.tilt_off_sigma_rad**2 - stands.tilt_sigma_rad**2 - surface.tilt_sigma_rad**2
        other = answer.alternative if told.without is None else told.without_alternative
        if other is not None or not np.isfinite(tilt2):
            tilt2 = np.pi**2
        least = np.array([1e-7, 1e-6, 1e-6]) ** 2
        return Sight(xy, np.array([told.off_m, *slope]), np.sqrt(np.maximum([off2, tilt2, tilt2], least)))

    def _agreed(self, now_ns: int) -> Fit | None:
        """What is wrong with the surface, most robots agree; None where they do not."""
        told = [
            _mean(robot, mine)
            for robot, mine in self._robots.items()
            if len(mine.seen) >= FEWEST and now_ns - mine.seen_ns < FORGOTTEN_NS
        ]
        counted = len(told)
        while told and 2 * len(told) > counted:
            fit, oddest, odd = self._fit(told)
            if odd < ODD:
                return fit if fit.chi2 >= SURE and self._stands_up(told) else None
            del told[oddest]
        return None

    def _stands_up(self, told: list[Told]) -> bool:
        """Whether it is no single robot's word that it rests on: one that is lifted."""
        if len(told) == 1:
            return not self._robots[told[0].robot].was_elsewhere(told[0].off)
        others = ([*told[:k], *told[k + 1 :]] for k in range(len(told)))
        return all(self._fit(rest)[0].chi2 >= WITHOUT for rest in others)

    def _fit(self, told: list[Told]) -> tuple[Fit, int, float]:
        """The three numbers, who agrees least with them, and by how much, chi squared."""
        own = self._own_sigmas()
        middle = np.mean([one.xy for one in told], axis=0)
        rows = [np.array([[1.0, *(one.xy - middle)], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) for one in told]
        by = np.concatenate(rows)
        off = np.concatenate([one.off for one in told])
        variances = np.concatenate([one.variances for one in told])
        inverse = np.linalg.inv((by.T / variances) @ by)
        numbers = inverse @ (by.T @ (off / variances))
        whole = inverse + np.diag(own**2)
        left = (off - by @ numbers).reshape(-1, 3) ** 2 / variances.reshape(-1, 3)
        odd = left.sum(axis=1)
        fit = Fit(
            tuple(one.robot for one in told), numbers, float(np.sqrt(inverse[0, 0])),
            float(numbers @ np.linalg.solve(whole, numbers)),
        )  # fmt: skip
        return fit, int(odd.argmax()), float(odd.max())

    def _own_sigmas(self) -> Floats:
        """(3,): how well the rig says that it knows the surface as a whole; a grid's nodes at their best."""
        surface = self._rig.surface
        assert surface is not None
        sigma = surface.sigma_m
        if isinstance(surface.shape, Heights):
            sigma = float(np.hypot(sigma, np.nanmedian(surface.shape.sigmas)))
        return np.array([sigma, surface.tilt_sigma_rad, surface.tilt_sigma_rad])

    def _finding(self, fit: Fit) -> Finding:
        height, tilt = float(fit.off[0]), float(np.hypot(*fit.off[1:]))
        whole = self._own_sigmas()
        parts = [f"{1e3 * abs(height):.2f} mm {'higher' if height > 0 else 'lower'}"]
        if tilt > 3.0 * max(whole[1], np.radians(0.05)):
            parts.append(f"turned by {np.degrees(tilt):.2f} degrees")
        who = f"{len(fit.robots)} robots agree" if len(fit.robots) > 1 else f"{fit.robots[0]} says"
        return Finding(
            "surface",
            f"the surface is not where the rig has it: {who} that it is {' and '.join(parts)}",
            f"run {typed('calibrate', 'surface', 'RIG', 'SOURCE')}, or check `surface` and `world` of the rig",
            self._began_ns,
        )


def _tells(answer: PoseEstimate) -> bool:
    """Whether light alone says how far a robot is off a surface."""
    told = answer.surface
    return told is not None and bool(np.isfinite([told.off_m, told.off_sigma_m, told.tilt_off_rad]).all())


def _mean(robot: str, mine: _Robot) -> Told:
    """A robot's newest frames as one."""
    off, light = np.array([sight.off for sight in mine.seen]), np.array([sight.light for sight in mine.seen])
    n = len(off)
    whole = np.mean(light**2, axis=0)
    changes = 0.5 * np.mean(np.diff(off, axis=0) ** 2, axis=0)
    noise = np.minimum(whole, (BEFORE * whole + (n - 1) * changes) / (BEFORE + n - 1))
    stand = np.array([mine.stands.sigma_m, *[min(mine.stands.tilt_sigma_rad, np.pi)] * 2]) ** 2
    return Told(
        robot, np.mean([sight.xy for sight in mine.seen], axis=0), off.mean(axis=0), stand + whole - noise + noise / n
    )
