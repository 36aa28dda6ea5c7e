"""What a second of frames shows of the robots: where their LEDs' spots are off, and by which moves of single LEDs.

A pose takes up six of the twelve numbers that six spots are, so that an LED which is not where the rig has it shows in
all six residuals. What is left is the residuals' part that no pose explains, P r with P = I - J (J'J)^-1 J', J their
derivatives by the pose; an LED that moved by d in its plate leaves P A d, A the derivatives of its spot. So d is found
by A'PA d = A'Pr. Residuals of any pose near by have the same part: how the solver weighs spots does not matter, nor
whether it left one out.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose, matrix_from_quat
from asterism.protocol.messages import Fate
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import FrameResult
from asterism.server.pose.fit import LEDS
from asterism.server.pose.place import turning
from asterism.server.pose.solve import PoseEstimate

NEAR_M = 3e-3  # of where an LED should be: a spot there that was left out is that LED's
STEADY = 1e-9  # of the derivatives' squares, so that what says nothing can be divided by


class Sightings(NamedTuple):
    """n robots in frames: ``robots`` (n,) of the rig; ``rotations`` (n, 3, 3), ``positions`` (n, 3) m, T_camera_robot;
    ``spots`` (n, 6, 2) px and ``off`` (n, 6, 2) px, observed minus predicted, nan where an LED is not seen.
    """

    robots: NDArray[np.int64]
    rotations: Floats
    positions: Floats
    spots: Floats
    off: Floats


class Moves(NamedTuple):
    """What n sightings say of single LEDs that moved in their plate: the equations ``normals`` (n, 6, 2, 2) d =
    ``rights`` (n, 6, 2), in px^2 / m^2 and px^2 / m.
    """

    normals: Floats
    rights: Floats


def sightings_of(rig: Rig, results: Sequence[FrameResult], T_camera_parent: Pose) -> Sightings:
    """The robots located in frames, those of one frame after those of another; ``T_camera_parent`` where the camera is
    not followed.
    """
    numbers = {robot.id: k for k, robot in enumerate(rig.robots)}
    seen = [
        (numbers[name], result, answer)
        for result in results
        for name, answer in result.answers.items()
        if name in numbers and isinstance(answer, PoseEstimate)
    ]
    n = len(seen)
    turns = np.array([matrix_from_quat(answer.orientation) for _, _, answer in seen]).reshape(n, 3, 3)
    views = [_view(result, T_camera_parent) for _, result, _ in seen]
    rotations = np.array([view.rotation for view in views]).reshape(n, 3, 3)
    positions = np.array([answer.position for _, _, answer in seen]).reshape(n, 3, 1)
    nothing = np.full((2, n, LEDS, 2), np.nan)
    shown = Sightings(
        np.array([robot for robot, _, _ in seen], np.int64),
        rotations @ turns,
        (rotations @ positions)[..., 0] + np.array([view.position for view in views]).reshape(n, 3),
        nothing[0],
        nothing[1],
    )
    for k, (_, result, answer) in enumerate(seen):
        leds = list(answer.leds)
        shown.off[k, leds] = answer.residuals_px
        shown.spots[k, leds] = result.blobs.centres_px[list(answer.spots)]
        if len(leds) < LEDS:
            _take_left_out(rig, result, k, shown)
    return shown


def _view(result: FrameResult, T_camera_parent: Pose) -> Pose:
    return T_camera_parent if result.place is None else result.place.T_world_camera.inverse()


def _take_left_out(rig: Rig, result: FrameResult, k: int, shown: Sightings) -> None:
    """Spots that nobody claimed, near where the robot's LEDs should be, are theirs."""
    blobs, camera = result.blobs, rig.camera
    free = blobs.centres_px[blobs.fates == Fate.UNEXPLAINED]
    if not len(free):
        return
    points = rig.robots[shown.robots[k]].leds @ shown.rotations[k].T + shown.positions[k]
    places = camera.project(points)
    # What shifts spots (`pose.spot_shift`) does so to all of a robot alike.
    places += np.nanmean(shown.spots[k] - shown.off[k] - places, axis=0)
    for led in np.flatnonzero(np.isnan(shown.off[k, :, 0])):
        away = np.linalg.norm(free - places[led], axis=1)
        nearest = int(away.argmin())
        if away[nearest] < NEAR_M * camera.focal_px / points[led, 2]:
            shown.spots[k, led] = free[nearest]
            shown.off[k, led] = free[nearest] - places[led]


def moves_of(rig: Rig, shown: Sightings) -> Moves:
    """What the sightings say of single LEDs that moved, as far as all six are seen: fewer are off otherwise."""
    n = len(shown.positions)
    leds = np.array([robot.leds for robot in rig.robots])[shown.robots]
    axes = np.array([robot.T_robot_plane.rotation[:, :2] for robot in rig.robots])[shown.robots]
    points = leds @ np.swapaxes(shown.rotations, 1, 2)
    arms = points - points.mean(axis=1, keepdims=True)
    by_point = projection_by_point(points + shown.positions[:, None], rig.camera.focal_px)
    by_pose = np.concatenate([by_point, by_point @ turning(arms)], axis=-1)
    stacked = by_pose.reshape(n, 2 * LEDS, 6)
    off = np.nan_to_num(shown.off)
    squares = np.swapaxes(stacked, 1, 2) @ stacked
    squares[:, np.arange(6), np.arange(6)] *= 1.0 + STEADY
    inverse = np.linalg.inv(squares)
    taken = stacked @ (inverse @ (np.swapaxes(stacked, 1, 2) @ off.reshape(n, 2 * LEDS, 1)))
    left = off - taken.reshape(n, LEDS, 2)
    own = np.eye(2) - by_pose @ inverse[:, None] @ np.swapaxes(by_pose, 2, 3)
    in_plate = by_point @ (shown.rotations @ axes)[:, None]
    across = np.swapaxes(in_plate, 2, 3)
    return Moves(across @ own @ in_plate, (across @ left[..., None])[..., 0])


def projection_by_point(points: Floats, focal_px: float) -> Floats:
    """Derivatives (..., 2, 3), px / m, of the pixels of points (..., 3) m in the camera's frame, without distortion."""
    x, y, z = np.moveaxis(points, -1, 0)
    by_point = np.zeros((*points.shape[:-1], 2, 3))
    by_point[..., 0, 0] = by_point[..., 1, 1] = focal_px / z
    by_point[..., 0, 2], by_point[..., 1, 2] = -focal_px * x / z**2, -focal_px * y / z**2
    return by_point
