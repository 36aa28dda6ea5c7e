"""What goes wrong while the server runs: a lens that was touched, a camera that moved, LEDs that bent or went dark.

The loop hands frames over, of which ten a second are kept: those between them share their errors. Once a second, in
another thread, they are looked at.
"""

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot
from asterism.server.chain.frame import FrameResult
from asterism.server.pose.fit import LEDS
from asterism.server.service.alarm import Alarm
from asterism.server.service.camera_watch import CameraWatch
from asterism.server.service.carry import same_camera, same_references, same_robots
from asterism.server.service.dark_watch import DarkWatch
from asterism.server.service.led_watch import SAME_PLACE_PX, LedWatch
from asterism.server.service.off_watch import OffWatch
from asterism.server.service.place_watch import PlaceWatch
from asterism.server.service.sightings import Moves, moves_of, sightings_of

EVERY_NS = 95_000_000
MOST_KEPT = 40  # frames, where nobody looks


def _at_once() -> None:
    """No pause."""


class _RobotWatch:
    """One robot's LEDs: bent, dark, and what is said of them."""

    def __init__(self, robot: Robot) -> None:
        self.leds = LedWatch(robot.id)
        self.dark = DarkWatch(robot.id, robot.T_world_fixed is not None)
        self.alarms = Alarm(), Alarm()

    def add(self, time_ns: int, spots: Floats, moves: Moves) -> Floats:
        """One more second: ``spots`` (n, 6, 2) px, nan where not seen; returns their mean (6, 2)."""
        lit = np.isfinite(spots[..., 0])
        whole = lit.all(axis=1)
        if whole.any():
            seen = spots[whole]
            moved = bool(np.ptp(seen, axis=0).max() > SAME_PLACE_PX)
            whole_moves = Moves(moves.normals[whole], moves.rights[whole])
            self.leds.add(time_ns, whole_moves, seen.mean(axis=0), moved)
        mean = seen.mean(axis=0) if whole.any() else _mean_seen(spots, lit)
        self.dark.add(time_ns, lit, np.nanmean(mean, axis=0))
        return mean

    def look(self, say: Callable[[str], None]) -> None:
        bent, dark = self.alarms
        bent.look(self.leds.finding(), say)
        dark.look(self.dark.finding(), say)


def _mean_seen(spots: Floats, lit: NDArray[np.bool_]) -> Floats:
    mean: Floats = np.full((LEDS, 2), np.nan)
    some = lit.any(axis=0)
    mean[some] = np.nanmean(spots[:, some], axis=0)
    return mean


class Drift:
    """Watches the frames of a rig. `add` is for the loop, all else for one other thread; ``say`` takes sentences."""

    def __init__(self, rig: Rig, say: Callable[[str], None]) -> None:
        self._say = say
        self._last_ns = 0
        self._kept: deque[FrameResult] = deque(maxlen=MOST_KEPT)
        self._rig = rig
        self._T_camera_parent = (rig.T_world_camera or Pose.identity()).inverse()
        self._robots = [_RobotWatch(robot) for robot in rig.robots]
        self._camera = CameraWatch(rig)
        self._camera_alarm = Alarm()
        self._off, self._off_alarm = OffWatch(rig), Alarm()
        self._place = PlaceWatch()

    def with_rig(self, rig: Rig) -> "Drift":
        """From now on another rig is in force: what was seen of robots goes on where they are the same before the same
        camera, and of constellations that do not move where the camera also stands where it did.
        """
        out, before = Drift(rig, self._say), self._rig
        if same_camera(before, rig):
            for old, new in same_robots(before, rig):
                out._robots[new] = self._robots[old]
            if same_references(before, rig) and before.follows_world == rig.follows_world:
                out._camera, out._camera_alarm = self._camera.renumbered(out._camera), self._camera_alarm
        return out

    def add(self, result: FrameResult) -> None:
        """Count one frame in."""
        if result.place is not None:
            self._place.add(result)
        if not 0 <= result.exposed_ns - self._last_ns < EVERY_NS:
            self._last_ns = result.exposed_ns
            self._kept.append(result)

    def look(self, pause: Callable[[], None] = _at_once) -> None:
        """Look at the second that has gone by; says what begins to be wrong, and what no longer is. ``pause`` is called
        between robots, so that who waits for this thread waits for one.
        """
        self._place.look(self._say)
        results = [self._kept.popleft() for _ in range(len(self._kept))]
        if not results:
            return
        time_ns, shown = results[-1].exposed_ns, sightings_of(self._rig, results, self._T_camera_parent)
        pause()
        moves = moves_of(self._rig, shown)
        fixed = np.full((len(self._camera.robots), LEDS, 2), np.nan)
        for number in np.unique(shown.robots).tolist():
            pause()
            mine, watch = shown.robots == number, self._robots[number]
            spots = watch.add(time_ns, shown.spots[mine], Moves(moves.normals[mine], moves.rights[mine]))
            watch.look(self._say)
            if number in self._camera.robots:
                fixed[self._camera.robots.index(number)] = spots
                self._off.add(time_ns, number, shown.positions[mine].mean(axis=0))
        if np.isfinite(fixed).any():
            pause()
            self._camera.add(time_ns, fixed)
            self._look_at_camera()

    def _look_at_camera(self) -> None:
        """Where a change was seen, that is what is said, else where things are at all; a followed camera may move."""
        self._camera_alarm.look(self._camera.finding(), self._say)
        if self._camera_alarm.raised is None and not self._rig.follows_world:
            self._off_alarm.look(self._off.finding(), self._say)

    @property
    def problem(self) -> str:
        """What is wrong now, by how much and since when; empty where nothing is."""
        alarms = [self._camera_alarm, self._off_alarm, *(alarm for watch in self._robots for alarm in watch.alarms)]
        return "; ".join(filter(None, (self._place.problem, *(alarm.problem for alarm in alarms))))
