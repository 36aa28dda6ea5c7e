"""Frames without pixels: robots and fixed constellations under a camera, centres drawn with errors that are not white,
solved by the chain's own solver.

What is honest noise here: white noise of every centre; a part that depends on where in its pixel a centre lies, and is
the same while a robot stands still; a lens whose calibration is locally off; light that moves an LED's centre by how
it is seen; a brightness that wanders; a temperature that swings focal length and mount once in four hours; glints of
seconds; LEDs that are hidden for seconds, all of a robot gone for minutes. Robots drive, stand for minutes or an hour,
leave and come back.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.messages import Fate
from asterism.protocol.rig import Rig
from asterism.server.centres.blobs import Blobs
from asterism.server.chain.answers import answers_of
from asterism.server.chain.frame import FrameResult
from asterism.server.chain.world import Following, carried_over, place_before, place_now
from asterism.server.identity.identify import Matches
from asterism.server.identity.plan import Plan
from asterism.server.identity.rays import rays_of
from asterism.server.pose.choose import Choices, choose
from asterism.server.pose.matched import Matched, Measured
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.track import Tracks
from tests.rigs import make_camera, make_rig

HEIGHT_M = 1.3  # of the camera above the floor
DOWN = np.diag([1.0, -1.0, -1.0])
WHITE_PX, PHASE_PX, LOCAL_PX, LIGHT_PX, WANDER_PX = 0.015, 0.012, 0.03, 0.01, 0.008
TOLD_PX = 0.02  # what a centre's covariance says
SWING_F, SWING_DEG, SWING_S = 1e-4, 0.003, 4 * 3600.0
LED_M, SURVEY_M = 0.03e-3, 0.1e-3  # what the rig has wrong
SPEED = 0.12  # m/s


@dataclass
class Fault:
    """What goes wrong, at a time, s: share of the focal length; turn of the camera (3,) rad, shift (3,) m in its own
    axes; a robot's LED moved by (3,) m, or dark; a fixed constellation moved by (3,) m.
    """

    at_s: float = np.inf
    focal: float = 0.0
    turn: Floats = field(default_factory=lambda: np.zeros(3))
    shift: Floats = field(default_factory=lambda: np.zeros(3))
    led: tuple[int, int] = (0, 0)
    moved: Floats = field(default_factory=lambda: np.zeros(3))
    dark: bool = False
    fixed: int = -1
    fixed_moved: Floats = field(default_factory=lambda: np.zeros(3))


def stage_rig(robots: int, fixed: int, seed: int, fixed_height: float = 0.0) -> Rig:
    """A camera that looks down at a floor; the first ``fixed`` of its robots stand about the edge of the image."""
    T_world_camera = Pose.from_matrix(DOWN @ exp_rotation(np.array([0.05, -0.03, 0.2])), np.array([0.0, 0.0, HEIGHT_M]))
    rig = make_rig(robots + fixed, seed=seed, camera=make_camera(), T_world_camera=T_world_camera)
    rng = np.random.default_rng([seed, 31])
    corners = np.array([(-0.36, -0.26), (0.36, 0.26), (-0.36, 0.26), (0.36, -0.26)])
    placed = []
    for k, robot in enumerate(rig.robots):
        if k >= fixed:
            placed.append(robot)
            continue
        tilt = exp_rotation(np.append(rng.normal(scale=0.1, size=2), 0.0)) @ exp_rotation(
            np.array([0.0, 0.0, rng.uniform(-3, 3)])
        )
        place = np.append(corners[k], fixed_height * k + 0.01)
        placed.append(replace(robot, T_world_fixed=Pose.from_matrix(tilt, place)))
    return replace(rig, robots=tuple(placed))


# The camera's turn, rad, and shift, m, about its own axes at a time, s.
Motion = Callable[[float], tuple[Floats, Floats]]


def _swings(time_s: float) -> tuple[Floats, Floats]:
    """With the temperature."""
    swing = np.sin(2 * np.pi * time_s / SWING_S)
    return np.radians(SWING_DEG) * swing * np.array([1.0, 0.5, 0.0]), 3e-5 * swing * np.ones(3)


class Stage:
    """A true rig, the told one with its errors, and what its robots do."""

    def __init__(
        self, rig: Rig, seed: int, fault: Fault | None = None, always: str = "", motion: Motion | None = None,
        wrong: bool = True,
    ) -> None:  # fmt: skip
        """``always``: all robots drive, or stand; else they do now this, now that. ``motion``: how the camera moves.
        Not ``wrong``: the rig is true, and centres have white noise, as large as they tell, and no other.
        """
        self.motion, self.wrong = motion or _swings, float(wrong)
        self.fault = fault or Fault()
        self.rng = rng = np.random.default_rng([seed, 32])
        self.true = rig
        told = []
        for robot in rig.robots:
            leds = robot.leds + self.wrong * LED_M * rng.normal(size=(6, 3)) * [1, 1, 0]
            place = robot.T_world_fixed
            if place is not None:
                place = Pose(place.position + self.wrong * SURVEY_M * rng.normal(size=3), place.orientation)
            told.append(replace(robot, leds=leds, T_world_fixed=place))
        self.told = replace(rig, robots=tuple(told))
        self.plan = Plan(self.told)
        n = len(rig.robots)
        self.always = always
        self.tracks: Tracks = Tracks.none(n)
        self.places = np.column_stack([rng.uniform(-0.3, 0.3, n), rng.uniform(-0.2, 0.2, n)])
        self.headings, self.tilts = rng.uniform(-3, 3, n), rng.normal(scale=0.15, size=(n, 2))
        self.modes = [always or "drive"] * n
        self.until = rng.uniform(0, 120, n)
        self.light = rng.normal(scale=LIGHT_PX, size=(n, 6, 2, 2))
        self.wander, self.wander_by = 0.0, rng.normal(size=(n, 6, 2))
        self.waves = rng.normal(scale=1 / 200.0, size=(8, 2)), rng.uniform(0, 6.3, (8, 2)), rng.normal(size=(8, 2))
        self.phases = rng.uniform(0, 6.3, (n, 6, 2))
        self.glints: dict[tuple[int, int], tuple[float, Floats]] = {}
        self.hidden: dict[tuple[int, int], float] = {}
        self.frames = 0
        self.last_s = 0.0

    def frame(self, time_s: float) -> FrameResult:
        """The frame at a time; times must rise."""
        self._go_on(time_s)
        spots, whose = self._spots(time_s)
        return self._solved(spots, whose, time_s)

    def T_world_camera(self, time_s: float) -> Pose:
        """Where the camera truly is."""
        assert self.true.T_world_camera is not None
        turn, shift = self.motion(time_s)
        if time_s >= self.fault.at_s:
            turn, shift = turn + self.fault.turn, shift + self.fault.shift
        return self.true.T_world_camera @ Pose.from_matrix(exp_rotation(turn), shift)

    def _go_on(self, time_s: float) -> None:
        rng, dt = self.rng, time_s - self.last_s
        self.last_s = time_s
        self.wander += -self.wander * dt / 900.0 + WANDER_PX * np.sqrt(2 * dt / 900.0) * rng.normal()
        for k, robot in enumerate(self.true.robots):
            if robot.T_world_fixed is None:
                self._drive(k, time_s, dt)
            for led in range(6):
                if rng.random() < dt / 1800.0:
                    self.glints[k, led] = time_s + rng.uniform(1, 6), rng.normal(scale=0.1, size=2)
                if rng.random() < dt / 600.0:
                    self.hidden[k, led] = time_s + rng.exponential(3.0)

    def _drive(self, k: int, time_s: float, dt: float) -> None:
        rng = self.rng
        if time_s > self.until[k] and not self.always:
            self.modes[k] = str(rng.choice(["drive", "stand", "away"], p=[0.45, 0.45, 0.1]))
            longest = {"drive": 600.0, "stand": 3600.0, "away": 300.0}[self.modes[k]]
            self.until[k] = time_s + longest * rng.uniform(0.02, 1.0)
        if self.modes[k] != "drive":
            return
        self.headings[k] += 0.5 * dt * rng.normal() + 0.2 * dt
        step = SPEED * dt * np.array([np.cos(self.headings[k]), np.sin(self.headings[k])])
        at = self.places[k] + step
        if abs(at[0]) > 0.33 or abs(at[1]) > 0.24:
            self.headings[k] += np.pi / 2
        else:
            self.places[k] = at
        self.tilts[k] += -self.tilts[k] * dt / 5.0 + 0.15 * np.sqrt(2 * dt / 5.0) * rng.normal(size=2)

    def _spots(self, time_s: float) -> tuple[Floats, Floats]:
        """Centres (n, 2) px and whose they are (n, 2)."""
        rng, fault, camera = self.rng, self.fault, self.true.camera
        T_camera_world = self.T_world_camera(time_s).inverse()
        wrong = time_s >= fault.at_s
        focal = 1.0 + self.wrong * SWING_F * np.sin(2 * np.pi * time_s / SWING_S) + (fault.focal if wrong else 0.0)
        matrix = camera.matrix * np.array([[focal, 1, 1], [1, focal, 1], [1, 1, 1]])
        camera = replace(camera, matrix=matrix)
        spots, whose = [], []
        for k, robot in enumerate(self.true.robots):
            if self.modes[k] == "away" and robot.T_world_fixed is None:
                continue
            leds = robot.leds.copy()
            if wrong and fault.led[0] == k:
                leds[fault.led[1]] += fault.moved
            pose = T_camera_world @ self.pose(k, time_s)
            pixels = camera.project(pose.map(leds))
            facing = pose.rotation[:2, 2]
            pixels += self.wrong * self._errors(pixels, k, facing)
            for led in range(6):
                until, by = self.glints.get((k, led), (0.0, np.zeros(2)))
                pixels[led] += self.wrong * by if until > time_s else 0.0
                dark = wrong and fault.dark and fault.led == (k, led)
                if self.hidden.get((k, led), 0.0) < time_s and not dark:
                    spots.append(pixels[led] + (WHITE_PX if self.wrong else TOLD_PX) * rng.normal(size=2))
                    whose.append((k, led))
        return np.array(spots).reshape(-1, 2), np.array(whose).reshape(-1, 2)

    def pose(self, k: int, time_s: float) -> Pose:
        """T_world_robot."""
        fixed = self.true.robots[k].T_world_fixed
        if fixed is not None:
            moved = time_s >= self.fault.at_s and self.fault.fixed == k
            return Pose(fixed.position + (self.fault.fixed_moved if moved else 0.0), fixed.orientation)
        turn = exp_rotation(np.append(self.tilts[k], 0.0)) @ exp_rotation(np.array([0.0, 0.0, self.headings[k]]))
        return Pose.from_matrix(turn, np.append(self.places[k], 0.03))

    def _errors(self, pixels: Floats, k: int, facing: Floats) -> Floats:
        frequencies, phases, amplitudes = self.waves
        local = LOCAL_PX * 0.35 * np.sin(pixels @ frequencies.T * 2 + phases[:, 0]) @ amplitudes
        phase = PHASE_PX * np.sin(2 * np.pi * pixels + self.phases[k])
        errors: Floats = local + phase + self.light[k] @ facing * 3.0 + self.wander * self.wander_by[k]
        return errors

    def _solved(self, spots: Floats, whose: Floats, time_s: float) -> FrameResult:
        n, exposed_ns = len(spots), round(1e18 + 1e9 * time_s)
        covariances = np.tile([TOLD_PX**2, 0.0, TOLD_PX**2], (n, 1))
        nobody = np.full(n, -1, np.int64)
        fates = np.full(n, int(Fate.UNEXPLAINED), np.int64)
        blobs = Blobs(
            spots, covariances, np.full(n, 150.0), np.full(n, 3.0), fates, nobody.copy(), nobody.copy(),
            np.zeros((n, 1)),
        )  # fmt: skip
        plan, seen = self.plan, rays_of(blobs, self.plan)
        T_camera_world = self.T_world_camera(time_s).inverse()
        robots = [k for k in range(len(self.true.robots)) if np.count_nonzero(whose[:, 0] == k) >= 4]
        found = Matched.room(len(robots))
        for row, k in enumerate(robots):
            found.robots[row] = k
            found.assignment[row] = -1
            found.assignment[row, whose[whose[:, 0] == k, 1]] = np.flatnonzero(whose[:, 0] == k)
            start = T_camera_world @ self.pose(k, time_s) @ self.told.robots[k].T_robot_plane
            found.rotations[row], found.ts[row] = start.rotation, start.position
        learned = self.tracks.learned_at(exposed_ns)
        solutions, choices = Solutions.room(len(robots), learned[found.robots]), Choices.room(len(robots))
        measured = Measured(seen.rays, seen.covariances, blobs.centres_px)
        solve_robots(plan.lens, plan.constellations, found, measured, solutions)
        place = None
        if self.told.follows_world:
            before = place_before(self.tracks, self.told, exposed_ns)
            plan = plan.at(before.T_world_camera)
            place = place_now(before, plan, blobs, seen, found, solutions)
        self.tracks = self.tracks.copy_for(len(self.told.robots))
        choose(found, exposed_ns, solutions, seen.heights, plan.mounts, self.tracks, choices)
        if place is not None:
            carried_over(choices, before.T_world_camera, place)
            plan, self.tracks = plan.at(place.T_world_camera), Following.of(self.tracks, place)
        answers = answers_of(plan, blobs, seen, Matches(found, len(robots), {}, {}), solutions, choices)
        self.frames += 1
        return FrameResult(self.frames, exposed_ns, blobs, answers, learned, place)
