"""The table that simulated robots drive on.

Cameras that a rig places in a world, and that look at its floor, share one: it lies about the world's origin, and its
size follows from the robots alone. So every such camera shows the same robots at the same places of the world, in
whatever process or on whatever host it is simulated. A camera without a world has a table of its own before it, and so
has one whose part of the floor lies beyond the common table: it would see nobody.

Where the rig has a surface the table lies in the surface's frame, and where the surface is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot
from asterism.protocol.surface import Surface
from asterism.server.simulation.drive import APART, largest, parts
from asterism.server.simulation.surface_part import Part, part_of

VIEW = 0.46  # of the image's width and height, to each side of its middle: where whole robots are in view
LEAST_HALF_M = 0.05
# The common table is what a camera of 1280 x 1024 px with f = 1400 px sees from 1.3 m straight above it, ...
COMMON_PX, COMMON_FOCAL_PX, COMMON_M = (1280, 1024), 1400.0, 1.3
LEAST_PART = 2.0  # ... or larger, so that a robot's part is that many times as wide as the largest robot
_FARTHEST_M = 20.0  # where a camera's axis is looked for on a surface
_NINE = np.linspace(-0.999, 0.999, 9)  # of half a table: its border may be the edge of a hole


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """``half`` (x, y) m: how far it reaches to both sides of its middle. ``distance``: m from the camera to the nearest
    that it sees of it. ``common``: whether it is the one that all cameras of its world share. ``middle``: where its
    middle is on the rig's surface, x, y of its frame, m.
    """

    T_camera_table: Pose
    distance: float
    half: tuple[float, float]
    common: bool = False
    middle: tuple[float, float] = (0.0, 0.0)


def drives(rig: Rig, robot: Robot) -> bool:
    """Whether a robot drives; one that the rig has `fixed` in the world stands there."""
    return rig.T_world_camera is None or robot.T_world_fixed is None


def as_driven(rig: Rig, robot: Robot) -> Robot:
    """A robot as it drives: where the rig has no surface it stands on none."""
    return robot if rig.surface is not None or robot.stands is None else replace(robot, stands=None)


def table_of(rig: Rig) -> Table:
    """The table that a rig's robots drive on. Raises InputError where the rig's surface has no room for them."""
    robots = [as_driven(rig, robot) for robot in rig.robots if drives(rig, robot)]
    place = rig.T_world_camera
    if rig.surface is not None and place is not None:
        return _on_surface(rig, rig.surface, rig.surface.T_world_surface.inverse() @ place, robots)
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


def _on_surface(rig: Rig, surface: Surface, T_surface_camera: Pose, robots: Sequence[Robot]) -> Table:
    part, look = part_of(surface, common_half(robots)), _looked_at(surface, T_surface_camera)
    common = True
    if look is not None:
        point, distance = look
        own = _in_view(rig, distance, robots)
        far = part is None or (np.abs(point - part.middle) >= np.array(part.half) + max(own)).any()
        if far and (nearer := part_of(surface, own, point)) is not None:
            part, common = nearer, False
    if part is None:
        raise InputError(
            "the rig's `surface` is nowhere about the origin of its frame, expected where robots may drive"
        )
    _check_room(part, robots)
    feet = part.middle + np.array(part.half) * [(x, y) for x in _NINE for y in _NINE]
    ground = np.column_stack([feet, surface.ground(feet).heights])
    nearest = float(np.linalg.norm(ground - T_surface_camera.position, axis=1).min())
    to_middle = Pose(np.array([*part.middle, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    return Table(T_surface_camera.inverse() @ to_middle, nearest, part.half, common, part.middle)


def _check_room(part: Part, robots: Sequence[Robot]) -> None:
    """Raise InputError where parts of a surface's part are too small for robots not to touch."""
    if not robots:
        return
    columns, rows = parts(len(robots), part.half)
    least, size = min(2 * part.half[0] / columns, 2 * part.half[1] / rows), largest(robots)
    if least < 2.0 * APART * size:
        raise InputError(
            f"the rig's `surface` has {2 * part.half[0]:.2f} x {2 * part.half[1]:.2f} m in one piece to drive on, for "
            f"{len(robots)} robots of up to {size:.2f} m, expected more, or fewer robots"
        )


def _looked_at(surface: Surface, T_surface_camera: Pose) -> tuple[Floats, float] | None:
    """Where a camera's axis meets the surface first, (2,) m, and how far away; None where it does not from above."""
    eye, view = T_surface_camera.position, T_surface_camera.rotation[:, 2]
    away = np.linspace(0.0, _FARTHEST_M, 4001)
    places = eye + away[:, None] * view
    ground = surface.ground(places[:, :2])
    over = np.where(ground.inside, places[:, 2] - ground.heights, np.nan)
    through = np.flatnonzero((over[:-1] > 0.0) & (over[1:] <= 0.0))
    if not len(through):
        return None
    k = int(through[0])
    distance = float(away[k] + (away[k + 1] - away[k]) * over[k] / (over[k] - over[k + 1]))
    return (eye + distance * view)[:2], distance


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
