"""Whether several rigs' cameras show one world."""

from collections.abc import Sequence

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, Robot
from asterism.protocol.surface import Heights, Quadric, Surface
from asterism.server.simulation.table import drives, table_of


def check_shared(paths: Sequence[str], rigs: Sequence[Rig]) -> None:
    """Raise InputError where the cameras of several rigs, read from ``paths``, do not show the same robots on the same
    surface.
    """
    names: dict[str, str] = {}
    for path, rig in zip(paths, rigs, strict=True):
        name = rig.camera.name
        if name in names:
            raise InputError(f"{path}: its camera is called {name!r} as that of {names[name]}, expected another name")
        names[name] = path
        if rig.T_world_camera is None:
            raise InputError(f"{path}: has no `world`, expected where its camera stands among the others")
        if not _same_surface(rigs[0].surface, rig.surface):
            raise InputError(f"{path}: its `surface` is not that of {paths[0]}, expected the same one")
        if not table_of(rig).common:
            where = "floor about the world's origin" if rig.surface is None else "part of its `surface`"
            raise InputError(
                f"{path}: its camera does not look at the {where}, where simulated robots drive, expected `world` of "
                "one that does"
            )
        _check_robots(paths[0], rigs[0], path, rig)


def _check_robots(first_path: str, first: Rig, path: str, rig: Rig) -> None:
    ours, theirs = ({robot.id: robot for robot in each.robots} for each in (first, rig))
    for name in sorted(ours.keys() & theirs.keys()):
        if not _same(ours[name], theirs[name]):
            raise InputError(f"{path}: its robot {name} is not that of {first_path}, expected the same one")
    driving = [sorted(robot.id for robot in each.robots if drives(each, robot)) for each in (first, rig)]
    if driving[0] != driving[1]:
        raise InputError(
            f"{path}: robots that drive: {', '.join(driving[1]) or 'none'}; expected those of {first_path}: "
            f"{', '.join(driving[0]) or 'none'}"
        )


def _same_surface(one: Surface | None, other: Surface | None) -> bool:
    if one is None or other is None:
        return one is other
    pairs = [
        (one.T_world_surface.position, other.T_world_surface.position),
        (one.T_world_surface.orientation, other.T_world_surface.orientation),
        (one.edge, other.edge),
    ]
    if isinstance(one.shape, Quadric) and isinstance(other.shape, Quadric):
        pairs += [(one.shape.terms, other.shape.terms), (one.shape.about, other.shape.about)]
    elif isinstance(one.shape, Heights) and isinstance(other.shape, Heights):
        pairs += [(one.shape.origin, other.shape.origin), (one.shape.step, other.shape.step)]
        if not np.array_equal(one.shape.values, other.shape.values, equal_nan=True):
            return False
    else:
        return False
    return all(np.array_equal(a, b) for a, b in pairs)


def _same(one: Robot, other: Robot) -> bool:
    pairs = [(one.leds, other.leds), (one.axis, other.axis)]
    if (one.stands is None) != (other.stands is None):
        return False
    if one.stands is not None and other.stands is not None:
        points = one.points[one.stands.point], other.points[other.stands.point]
        pairs += [points, (one.stands.axis, other.stands.axis)]
    if one.T_world_fixed is not None and other.T_world_fixed is not None:
        pairs.append((one.T_world_fixed.position, other.T_world_fixed.position))
        pairs.append((one.T_world_fixed.orientation, other.T_world_fixed.orientation))
    return all(np.array_equal(a, b) for a, b in pairs)
