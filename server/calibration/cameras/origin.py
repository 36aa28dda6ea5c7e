"""The world that cameras are placed in: that of constellations that do not move, of the first rig, or its camera's."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig

FEWEST_POSES = 3
CONTRADICTS_M = 0.005


class Origin(NamedTuple):
    """T_world_first, the first camera's place, and in words where that is from."""

    T_world_first: Pose
    told: str


def origin_of(rigs: Sequence[Rig], poses: Mapping[str, Sequence[Pose]]) -> Origin:
    """The world; ``poses`` are T_first_robot of every robot, as it was seen.

    Raises InputError where constellations that do not move contradict each other, or where what rigs say of the world
    would be wrong in the new one.
    """
    fixed = {robot.id: robot for rig in rigs for robot in rig.robots if robot.T_world_fixed is not None}
    there = {robot: _mean(poses[robot]) for robot in fixed if len(poses.get(robot, ())) >= FEWEST_POSES}
    if there:
        known = [fixed[robot].T_world_fixed for robot in there]
        worlds = [pose.map(fixed[robot].leds) for robot, pose in zip(there, known, strict=True) if pose is not None]
        seen = [pose.map(fixed[robot].leds) for robot, pose in there.items()]
        T = laid(np.concatenate(worlds), np.concatenate(seen))
        off = [float(np.linalg.norm(T.map(a).mean(axis=0) - b.mean(axis=0))) for a, b in zip(seen, worlds, strict=True)]
        names = ", ".join(there)
        if max(off) > CONTRADICTS_M:
            raise InputError(
                f"the constellations that the rigs have as fixed ({names}) contradict each other: the cameras see them "
                f"up to {1e3 * max(off):.1f} mm from there; one of them has moved, or its `fixed` is wrong"
            )
        apart = f", which agree to {1e3 * max(off):.2f} mm" if len(there) > 1 else ""
        return Origin(T, f"of the rigs' fixed constellations ({names}{apart})")
    first = rigs[0]
    if first.T_world_camera is not None:
        return Origin(first.T_world_camera, f"that of {first.camera.name}'s rig, whose camera stays where it is")
    for rig in rigs[1:]:
        if fixed or any(robot.normal is not None for robot in rig.robots):
            raise InputError(
                f"the rig of {first.camera.name} has no `world`, but that of {rig.camera.name} has robots whose "
                f"`normal` or `fixed` is told in one: name the rig of {rig.camera.name} first, whose world then holds"
            )
    return Origin(Pose.identity(), f"the frame of camera {first.camera.name}, since its rig has none")


def laid(world: Floats, seen: Floats) -> Pose:
    """T_world_first that lays points (n, 3) seen onto those of the world best (Kabsch 1976)."""
    a, b = world.mean(axis=0), seen.mean(axis=0)
    u, _, vt = np.linalg.svd((world - a).T @ (seen - b))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Pose.from_matrix(turn, a - turn @ b)


def _mean(poses: Sequence[Pose]) -> Pose:
    """Of a robot that stands still: the median place, the mean rotation."""
    u, _, vt = np.linalg.svd(np.sum([pose.rotation for pose in poses], axis=0))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Pose.from_matrix(turn, np.median([pose.position for pose in poses], axis=0))
