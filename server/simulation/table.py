"""The table that simulated robots drive on.

Cameras that a rig places in a world, and that look at its floor, share one: it lies about the world's origin, and its
size follows from the robots alone. So every such camera shows the same robots at the same places of the world, in
whatever process or on whatever host it is simulated. A camera without a world has a table of its own before it, and so
has one whose part of the floor lies beyond the common table: it would see nobody.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot
from asterism.server.simulation.drive import largest, parts

VIEW = 0.46  # of the image's width and height, to each side of its middle: where whole robots are in view
LEAST_HALF_M = 0.05
# The common table is what a camera of 1280 x 1024 px with f = 1400 px sees from 1.3 m straight above it, ...
COMMON_PX, COMMON_FOCAL_PX, COMMON_M = (1280, 1024), 1400.0, 1.3
LEAST_PART = 2.0  # ... or larger, so that a robot's part is that many times as wide as the largest robot


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """``half`` (x, y) m: how far it reaches to both sides of its middle. ``distance``: m from the camera to the nearest
    that it sees of it. ``common``: whether it is the one about the world's origin.
    """

    T_camera_table: Pose
    distance: float
    half: tuple[float, float]
    common: bool = False


def drives(rig: Rig, robot: Robot) -> bool:
    """Whether a robot drives; one that the rig has `fixed` in the world stands there."""
    return rig.T_world_camera is None or robot.T_world_fixed is None


def table_of(rig: Rig) -> Table:
    """The table that a rig's robots drive on."""
    robots = [robot for robot in rig.robots if drives(rig, robot)]
    place = rig.T_world_camera
    floor = None if place is None else _floor(place)
    if place is None or floor is None:
        near, far = rig.range_m or (1.0, 1.5)
        middle = 0.5 * (near + far)
        T_camera_table = Pose(np.array([0.0, 0.0, middle]), np.array([1.0, 0.0, 0.0, 0.0]))
        return Table(T_camera_table, middle, _in_view(rig, middle, robots))
    point, distance = floor
    half, own = common_half(robots), _in_view(rig, distance, robots)
    if (np.abs(point[:2]) < np.array(half) + max(own)).all():
        eye = place.position
        nearest = np.append(np.clip(eye[:2], -np.array(half), half), 0.0)
        return Table(place.inverse(), float(np.linalg.norm(eye - nearest)), half, True)
    T_world_table = Pose(point, np.array([0.0, 0.0, 0.0, 1.0]))
    return Table(place.inverse() @ T_world_table, distance, own)


def common_half(robots: Sequence[Robot]) -> tuple[float, float]:
    """How far the common table reaches, m; a function of the robots alone."""
    half = _half(COMMON_PX, (COMMON_FOCAL_PX, COMMON_FOCAL_PX), COMMON_M, robots)
    if not robots:
        return half
    columns, rows = parts(len(robots), half)
    part = min(2 * half[0] / columns, 2 * half[1] / rows)
    larger = max(1.0, LEAST_PART * largest(robots) / part)
    return larger * half[0], larger * half[1]


def _floor(T_world_camera: Pose) -> tuple[Floats, float] | None:
    """Where a camera looks at the world's floor, (3,) m, and from how far; None for one that does not look down."""
    view, eye = T_world_camera.rotation[:, 2], T_world_camera.position
    if view[2] >= -0.3 or eye[2] <= 0.05:
        return None
    distance = float(eye[2] / -view[2])
    return eye + distance * view, distance


def _in_view(rig: Rig, distance: float, robots: Sequence[Robot]) -> tuple[float, float]:
    camera = rig.camera
    focal = float(camera.matrix[0, 0]), float(camera.matrix[1, 1])
    return _half((camera.width, camera.height), focal, distance, robots)


def _half(
    size: tuple[int, int], focal: tuple[float, float], distance: float, robots: Sequence[Robot]
) -> tuple[float, float]:
    """What an image shows of a table at a distance, shrunk so that whole robots stay in it."""
    half_x, half_y = (
        max(VIEW * pixels / f * distance - 0.6 * largest(robots), LEAST_HALF_M)
        for pixels, f in zip(size, focal, strict=True)
    )
    return half_x, half_y
