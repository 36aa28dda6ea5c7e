"""All cameras' newest frames side by side, and what a robot's spots in them may be: hypotheses, with their odds."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Robot
from asterism.server.centres.blobs import Ints
from asterism.server.fusing.arrays import body_of, pose_of, scene_of, state_of
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.look import Body, Course, Room, Scene, State, room_for
from asterism.server.fusing.near_spots import gather
from asterism.server.fusing.odds import weigh
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.fit import LEDS
from asterism.server.pose.planar import NO_SOLUTION

# How fast a robot may be of which nothing is known, one sigma, m/s and rad/s; and what may be left of it where its
# motion is foreseen.
UNKNOWN_RATES, KNOWN_RATES = (0.2, 0.7), (0.03, 0.1)


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """Where a robot should be at an exposure: T_world_robot, and its covariance (6, 6) as of a `FusedPose`."""

    pose: Pose
    covariance: Floats


# What is known of a robot before, at a time, ns: asked for the times of all sightings. None: nothing is.
Foresight = Callable[[str, int], Foreseen | None]


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """What a robot's spots may be: ``labels`` (C, 6), rows of the scene, -1 for none. They tell ``state``, of the LEDs'
    plane at the newest exposure; ``chi2`` is that of their ``count``, ``odds``, nats, speak for the robot against other
    lights. ``rays`` (C, 6, 2) say where its LEDs should be, nan where none can be seen.
    """

    whose: Robot
    labels: Ints
    state: State
    chi2: float
    count: int
    odds: float
    rays: Floats

    @property
    def robot(self) -> str:
        """Its id."""
        return self.whose.id

    @property
    def pose(self) -> Pose:
        """T_world_robot at the newest exposure."""
        return pose_of(self.state, self.whose)

    @property
    def used(self) -> frozenset[int]:
        """The scene's spots that it takes."""
        return frozenset(self.labels[self.labels >= 0].tolist())

    def labelled(self, labels: Ints) -> "Hypothesis":
        """The same with other spots."""
        return replace(self, labels=labels, count=int((labels >= 0).sum()))

    def cameras(self) -> list[int]:
        """Those that see any of its LEDs."""
        return np.flatnonzero((self.labels >= 0).any(axis=1)).tolist()


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """The newest sightings, one of each camera, as one `Scene`; ``exposed_ns`` is the newest exposure's."""

    fleet: Fleet
    sightings: tuple[Sighting, ...]
    foreseen: Foresight
    scene: Scene
    exposed_ns: int
    room: Room
    bodies: dict[str, Body] = field(default_factory=dict)
    courses: dict[str, Course] = field(default_factory=dict)

    @staticmethod
    def of(fleet: Fleet, sightings: Sequence[Sighting], foreseen: Foresight) -> "Joined":
        """Of sightings, one at least."""
        newest = max(sighting.exposed_ns for sighting in sightings)
        return Joined(fleet, tuple(sightings), foreseen, scene_of(sightings), newest, room_for(len(sightings)))

    def near(self, place: Floats, away_m: float) -> NDArray[np.bool_]:
        """Which spots (n,) stand so near to a place (3,) in the world, as their cameras see it."""
        near = np.zeros(len(self.scene.rays), np.bool_)
        for c, (a, b) in enumerate(pairwise(self.scene.first.tolist())):
            x, y, z = (self.scene.turns[c] @ (place - self.scene.origins[c])).tolist()
            if z > 0.0 and a < b:
                off = self.scene.rays[a:b] - (x / z, y / z)
                near[a:b] = (off * off).sum(axis=1) < (away_m / z) ** 2
        return near

    def no_labels(self) -> Ints:
        """Labels (C, 6) of no spot."""
        return np.full((len(self.sightings), LEDS), -1)

    def body(self, robot: Robot) -> Body:
        """The robot as these cameras see it."""
        if robot.id not in self.bodies:
            self.bodies[robot.id] = body_of(robot, self.sightings)
        return self.bodies[robot.id]

    def course(self, robot: str) -> Course:
        """How a robot moves between the exposures, as far as that is foreseen."""
        if robot not in self.courses:
            self.courses[robot] = self._course(robot)
        return self.courses[robot]

    def _course(self, robot: str) -> Course:
        c = len(self.sightings)
        course = Course(np.tile(np.eye(3), (c, 1, 1)), np.zeros((c, 3)), np.zeros((c, 2)))
        apart = [(s.exposed_ns - self.exposed_ns) * 1e-9 for s in self.sightings]
        if not any(apart):
            return course
        now = self.foreseen(robot, self.exposed_ns)
        for k, (sighting, dt) in enumerate(zip(self.sightings, apart, strict=True)):
            there = self.foreseen(robot, sighting.exposed_ns) if now is not None and dt else None
            course.drifts[k] = np.abs(dt) * np.array(UNKNOWN_RATES if there is None else KNOWN_RATES)
            if there is not None and now is not None:
                plane = self.fleet.robots[robot].T_robot_plane.position
                course.turns[k] = there.pose.rotation @ now.pose.rotation.T
                course.shifts[k] = there.pose.map(plane) - now.pose.map(plane)
        return course

    def explain(
        self, robot: Robot, start: Pose, labels: Ints, free: NDArray[np.bool_], prior: Floats | None = None
    ) -> Hypothesis | None:
        """The robot's spots from a pose on, with what is ``free`` (n,) near it: taken, and then no longer free.

        ``labels`` (C, 6) are known already; with ``prior`` (6, 6) the start counts as known so well. None: no pose.
        """
        return self.explain_with(self.body(robot), robot, state_of(start, robot, prior), labels, free)

    def explain_with(
        self, body: Body, robot: Robot, prior: State, labels: Ints, free: NDArray[np.bool_]
    ) -> Hypothesis | None:
        """As `explain`, of a body and a start that are given."""
        state = State(prior.rotation.copy(), prior.t.copy(), np.zeros((6, 6)))
        labels, course = labels.copy(), self.course(robot.id)
        chi2, count = gather(self.scene, body, course, prior, state, labels, free, self.room)
        if chi2 >= NO_SOLUTION or count == 0:
            return None
        odds = weigh(self.scene, body, robot.extent, labels, self.room, state, prior, chi2)
        rays = np.where(self.room.visible[..., None] > 0.0, self.room.rays, np.nan)
        return Hypothesis(robot, labels, state, chi2, count, odds, rays)

    def spots_of(self, labels: Ints) -> dict[str, NDArray[np.int64]]:
        """Labels by the cameras' names, rows of their sightings, without cameras that see none."""
        local = np.where(labels >= 0, labels - self.scene.first[:-1, None], -1)
        return {
            sighting.camera: rows for sighting, rows in zip(self.sightings, local, strict=True) if (rows >= 0).any()
        }


def without(free: NDArray[np.bool_], hypotheses: Iterable[Hypothesis]) -> NDArray[np.bool_]:
    """The ``free`` (n,) spots that none of these takes."""
    left = free.copy()
    for hypothesis in hypotheses:
        left[hypothesis.labels[hypothesis.labels >= 0]] = False
    return left
