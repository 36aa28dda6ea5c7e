"""Which of a plane's two poses it is: by what the spots say, and by what is known beforehand.

Beforehand are known the pose a moment ago, and the surface's normal if the rig tells it. Both candidates stay, with
their odds; poses that face away are out already. The chosen one is expressed in the parent frame.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.compiled import compiled
from asterism.server.pose.covariance import move_origin, turn_axes
from asterism.server.pose.fit import median_of
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.rotations import product_into, quat_into
from asterism.server.pose.solve import MISFIT, NOISE_SHARE
from asterism.server.pose.track import LastSeen, follow_track, is_fresh, tilt_cost

MOST_ODDS = 1e12
OPEN = 2.0 * math.log(50.0)  # a tilt is as good as open up to there
NORMAL_SIGMA = math.radians(2.0)  # how soft the edge of a robot's cone of normals is


class Mounts(NamedTuple):
    """How the camera is mounted in the parent frame, and the LEDs on every robot of the rig.

    ``camera_rotation`` (3, 3) and ``camera_origin`` (3,) m are T_parent_camera; ``plane_rotations`` (robots, 3, 3) and
    ``plane_origins`` (robots, 3) m are T_robot_plane; ``axes`` (robots, 3) of the LEDs in the plane's frame; where
    these point in the parent frame by the rig, ``normals`` (robots, 3), give or take ``within`` (robots,) rad, which is
    negative where the rig does not say.
    """

    camera_rotation: Floats
    camera_origin: Floats
    plane_rotations: Floats
    plane_origins: Floats
    axes: Floats
    normals: Floats
    within: Floats

    @staticmethod
    def of(rig: Rig) -> "Mounts":
        """Those of a rig; the parent frame is the camera's own where the rig places no camera."""
        T_parent_camera = rig.T_world_camera or Pose.identity()
        robots, normals = rig.robots, [robot.normal for robot in rig.robots]
        return Mounts(
            T_parent_camera.rotation,
            T_parent_camera.position.copy(),
            np.array([robot.T_robot_plane.rotation for robot in robots]),
            np.array([robot.T_robot_plane.position for robot in robots]),
            np.array([robot.T_robot_plane.rotation.T @ robot.axis for robot in robots]),
            np.array([normal.world if normal is not None else np.zeros(3) for normal in normals]),
            np.array([normal.within_rad if normal is not None else -1.0 for normal in normals]),
        )


class Choices(NamedTuple):
    """What is chosen for m robots: ``best`` (m,) of the two minima, -1 for no pose at all, and its ``odds`` (m,) over
    the other (MOST_ODDS if there is none); the chosen one first, ``positions`` (m, 2, 3) m and ``quaternions``
    (m, 2, 4) x y z w of T_parent_robot; ``covariances`` (m, 6, 6) of the chosen one.
    """

    best: NDArray[np.int64]
    odds: Floats
    positions: Floats
    quaternions: Floats
    covariances: Floats

    @staticmethod
    def room(robots: int) -> "Choices":
        """Room for so many robots."""
        m = robots
        return Choices(
            np.empty(m, np.int64), np.empty(m), np.empty((m, 2, 3)), np.empty((m, 2, 4)), np.empty((m, 6, 6))
        )


class _Work(NamedTuple):
    """Scratch of a choice: rotations (3, 3) and vectors (3,)."""

    turn: Any
    parent: Any
    inverse: Any
    axis: Any
    arm: Any


@compiled
def turn_room():
    """Room for one choice's."""
    return _Work(np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3))


@compiled
def axis_cost(axis, wanted, within):
    """Squared sigmas by which a direction (3,) leaves the cone of half angle ``within`` rad around a wanted one."""
    dot = axis[0] * wanted[0] + axis[1] * wanted[1] + axis[2] * wanted[2]
    off = math.acos(min(max(dot, -1.0), 1.0)) - within
    return (off / NORMAL_SIGMA) ** 2 if off > 0.0 else 0.0


@compiled
def _cone_cost(rotation, robot, mounts, work):
    """Squared sigmas by which a robot's rotation, T_camera_plane, leaves the cone that the rig tells."""
    turn, axis, axes = work.turn, work.axis, mounts.axes
    product_into(mounts.camera_rotation, rotation, turn)
    for i in range(3):
        axis[i] = 0.0
        for j in range(3):
            axis[i] += turn[i, j] * axes[robot, j]
    return axis_cost(axis, mounts.normals[robot], mounts.within[robot])


@compiled
def remembered(before, now, noise_share):
    """What earlier frames add to what this one tells against a tilt, both in units of chi squared.

    Errors of the spots' own noise are new in every frame, and evidence adds up. What the rig has wrong is the same in
    all of them: frames that agree then tell no more than the one that tells most, and a frame that leaves the tilt open
    stays open, whatever one before it said.
    """
    same = min(before, OPEN)
    if now > 0.0:
        same = max(same - now, 0.0)
    return noise_share * before + (1.0 - noise_share) * same


@compiled
def to_parent(rotation, t, robot, mounts, work, position, quaternion):
    """Fill a robot's ``position`` (3,) and ``quaternion`` (4,), T_parent_robot, from its T_camera_plane.

    Leaves in ``work.arm`` the robot's origin as seen from the plane's, in the camera's axes.
    """
    view, eye, planes, origins = (
        mounts.camera_rotation,
        mounts.camera_origin,
        mounts.plane_rotations,
        mounts.plane_origins,
    )
    arm, turn, inverse = work.arm, work.turn, work.inverse
    for i in range(3):
        for j in range(3):
            inverse[i, j] = planes[robot, j, i]
    product_into(rotation, inverse, turn)  # R_camera_robot
    for i in range(3):
        arm[i] = 0.0
        for j in range(3):
            arm[i] -= turn[i, j] * origins[robot, j]
    for i in range(3):
        position[i] = eye[i]
        for j in range(3):
            position[i] += view[i, j] * (t[j] + arm[j])
    product_into(view, turn, work.parent)
    quat_into(work.parent, quaternion)


@compiled
def carry(covariance, view, arm, out):
    """Fill ``out`` (6, 6) with a pose's covariance moved by ``arm`` and about the parent's axes."""
    out[:, :] = covariance
    move_origin(out, arm)
    turn_axes(view, out)
    for i in range(6):
        for j in range(i):
            out[i, j] = out[j, i] = 0.5 * (out[i, j] + out[j, i])


@compiled
def choose(matched, exposed_ns, solutions, heights, mounts, tracks, choices):
    """Choose for every solved robot: fill the `Choices` from `Matched`, `Solutions` and `Mounts`, and write its track.

    ``heights`` (n,) are those of the spots.
    """
    totals = np.empty(2)
    work = turn_room()
    for k in range(matched.robots.shape[0]):
        robot, costs = matched.robots[k], solutions.costs[k]
        rotations, ts, covariances = solutions.rotations[k], solutions.ts[k], solutions.covariances[k]
        fresh = is_fresh(tracks.seen_ns[robot], exposed_ns)
        for which in range(2):
            totals[which] = costs[which]
            if costs[which] < NO_SOLUTION and mounts.within[robot] >= 0.0:
                totals[which] += _cone_cost(rotations[which], robot, mounts, work)
        if fresh and costs[0] < NO_SOLUTION and costs[1] < NO_SOLUTION:
            first = tilt_cost(tracks, robot, exposed_ns, rotations[0])
            second = tilt_cost(tracks, robot, exposed_ns, rotations[1])
            favoured = 0 if first <= second else 1
            told = totals[1 - favoured] - totals[favoured]
            totals[1 - favoured] += remembered(abs(first - second), told, solutions.misfits[k, NOISE_SHARE])
        chosen = 0 if totals[0] <= totals[1] else 1
        other = 1 - chosen
        if totals[chosen] >= NO_SOLUTION:
            choices.best[k] = -1
            continue
        evidence = 0.5 * (min(totals[other], NO_SOLUTION) - totals[chosen])
        choices.best[k], choices.odds[k] = chosen, math.exp(min(evidence, math.log(MOST_ODDS)))
        positions, quaternions = choices.positions[k], choices.quaternions[k]
        to_parent(rotations[chosen], ts[chosen], robot, mounts, work, positions[0], quaternions[0])
        carry(covariances[chosen], mounts.camera_rotation, work.arm, choices.covariances[k])
        has_other = costs[other] < NO_SOLUTION
        if has_other:
            to_parent(rotations[other], ts[other], robot, mounts, work, positions[1], quaternions[1])
        height = median_of(heights, matched.assignment[k])
        seen = LastSeen(
            rotations[chosen], ts[chosen], covariances[chosen], height, rotations[other], has_other, evidence,
            solutions.misfits[k, MISFIT], solutions.misfits[k, NOISE_SHARE],
        )  # fmt: skip
        follow_track(tracks, robot, exposed_ns, seen)
