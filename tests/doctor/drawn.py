"""What the doctor gathers, drawn without pictures: robots with known poses, spots with known noise."""

from collections import Counter
from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import Clock, Fate
from asterism.protocol.rig import Rig
from asterism.server.doctor.gather import Gathered, Pictures, Sightings, Times
from asterism.server.service.tally import Tally
from tests.helpers import facing_pose

SIGMA_PX = 0.01
PERIOD_NS = 16_666_667


def sightings(told: Rig, true: Rig, poses: list[list[Pose]], rng: np.random.Generator) -> Sightings:
    """Robots of ``true`` at ``poses``, frame by frame and robot by robot, T_camera_robot; residuals are those of the
    ``told`` rig at the same poses: what poses take up has to go by itself.
    """
    frames, robots, flat, centres, residuals = [], [], [], [], []
    for frame, row in enumerate(poses):
        for number, pose in enumerate(row):
            seen = true.camera.project(pose.map(true.robots[number].leds)) + SIGMA_PX * rng.normal(size=(6, 2))
            frames.append(frame)
            robots.append(number)
            flat.append(pose)
            centres.append(seen)
            residuals.append(seen - told.camera.project(pose.map(told.robots[number].leds)))
    m = len(frames)
    covariances = np.broadcast_to([SIGMA_PX**2, 0.0, SIGMA_PX**2], (m, 6, 3)).copy()
    plain = np.ones((m, 6))
    shapes = np.broadcast_to([2.5, 2.5, 0.0], (m, 6, 3)).copy()
    whole = np.array(frames, np.int64), np.array(robots, np.int64)
    light = 150.0 * plain, 1.5 * plain, 0.0 * plain, shapes
    pixels = [np.array(part).reshape(m, 6, 2) for part in (centres, residuals)]
    return Sightings(*whole, flat, *pixels, covariances, *light)


def driving(rig: Rig, frames: int, rng: np.random.Generator) -> list[list[Pose]]:
    """Poses of all robots that turn and move a little from frame to frame."""
    still = standing_still(rig, rng)
    return [[moved_on(pose, frame) for pose in still] for frame in range(frames)]


def standing_still(rig: Rig, rng: np.random.Generator) -> list[Pose]:
    """Somewhere in view, T_camera_robot."""
    return [facing_pose(rng, (0.9, 1.5), (10.0, 40.0)) @ robot.T_robot_plane.inverse() for robot in rig.robots]


def moved_on(pose: Pose, frame: float, step_m: float = 1e-3) -> Pose:
    """Where a robot is by then."""
    turn = Pose(np.zeros(3), np.array([0.0, 0.0, np.sin(0.01 * frame), np.cos(0.01 * frame)]))
    return replace(pose, position=pose.position + np.array([step_m * frame, 0.3 * step_m * frame, 0.0])) @ turn


def pictures(frames: int, spots: list[Floats] | None = None, times_ns: Floats | None = None) -> Pictures:
    """Frames of 60 Hz by a camera's clock, with those ``spots`` (k, 4) each."""
    times = PERIOD_NS * np.arange(frames) if times_ns is None else times_ns
    spots = spots or [np.empty((0, 4))] * len(times)
    fates = [Counter(int(fate) for fate in rows[:, 3]) for rows in spots]
    return Pictures(times.astype(np.int64), np.zeros(len(times)), fates, spots)


def nobody(rig: Rig) -> Sightings:
    """No robot in any frame."""
    return sightings(rig, rig, [], np.random.default_rng(0))


def gathered(rig: Rig, seen: Sightings, told: Pictures | None = None) -> Gathered:
    """As the checks take it."""
    frames = int(seen.frames.max()) + 1 if len(seen.frames) else 0
    told = told or pictures(frames)
    n = len(told.exposed_ns)
    times = Times(told.exposed_ns, np.arange(n), np.full(n, int(Clock.CAMERA)))
    return Gathered(rig, times, told, seen, [], Tally(robot.id for robot in rig.robots))


def spot(x: float, y: float, fate: int = int(Fate.UNEXPLAINED), height: float = 150.0) -> Floats:
    """A row of a picture's spots."""
    return np.array([[x, y, height, float(fate)]])
