"""Who works on a surface, by a rig: the tools, and where on the robots they are."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Heights, Surface
from asterism.server.coverage.sightings import Tool
from asterism.server.coverage.told import Looked, looked_for

RADIUS_M = 0.01  # of a tool, where nobody says it
FINEST = 8.0  # patches to a tool's radius
MOST_PATCHES = 250_000  # of a map: as many more are coarser


class Working(NamedTuple):
    """The ``surface``, the ``tools`` of the robots that stand on it by id, and how reports are read for them."""

    surface: Surface
    tools: Mapping[str, Tool]
    looked: Looked

    @property
    def least_radius_m(self) -> float:
        """Of the tools."""
        return min(tool.radius_m for tool in self.tools.values())


def working(rig: Rig, radius_m: float | None = None) -> Working | None:
    """Who works by this rig; None where it has no surface, or nobody stands on it. ``radius_m`` of all tools goes
    before what the rig says.
    """
    standing = [robot for robot in rig.robots if robot.stands is not None]
    if rig.surface is None or not standing:
        return None
    tools = {
        robot.id: Tool(robot.stands, radius_m or robot.stands.radius_m or RADIUS_M)
        for robot in standing
        if robot.stands is not None
    }
    levers = {robot.id: robot.points[tools[robot.id].stands.point] for robot in standing}
    return Working(rig.surface, tools, looked_for(levers))


def refuse_idle(rig: Rig, where: str) -> None:
    """Raises InputError for a rig by which nobody works on a surface."""
    if rig.surface is None:
        raise InputError(
            f"{where}: its rig has no `surface`, expected one that its robots work on; `asterism calibrate surface` "
            "finds it from robots that drive on it. With that rig record anew, or solve what was recorded again: "
            "`asterism locate RIG RECORDING --record DIR`"
        )
    if all(robot.stands is None for robot in rig.robots):
        raise InputError(
            f"{where}: no robot of its rig `stands` on the surface, expected for those that work there for example "
            "`stands: {point: tool, sigma: 0.00005}`"
        )


def same_surface(one: Surface, other: Surface) -> bool:
    """Whether two are the same, however well they are known: only then do their maps lie on each other."""
    frames = zip(
        (one.T_world_surface.position, one.T_world_surface.orientation, one.edge),
        (other.T_world_surface.position, other.T_world_surface.orientation, other.edge),
        strict=True,
    )
    if not all(np.array_equal(a, b) for a, b in frames):
        return False
    a, b = one.shape, other.shape
    if isinstance(a, Heights) or isinstance(b, Heights):
        if not (isinstance(a, Heights) and isinstance(b, Heights)):
            return False
        return (
            np.array_equal(a.origin, b.origin)
            and np.array_equal(a.step, b.step)
            and (np.array_equal(a.values, b.values, equal_nan=True))
        )
    return np.array_equal(a.terms, b.terms) and np.array_equal(a.about, b.about)
