"""Maps of coverage that are made up patch by patch, so that what is found in them is known."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.surface import Quadric, Surface
from asterism.server.coverage.grid import Box, Grid
from asterism.server.coverage.visits import CoverageMap, Visits

PITCH, RADIUS = 0.005, 0.01  # m
DAY_NS = 86_400_000_000_000
SINCE_NS = 1_795_398_896_000_000_000
EDGE = np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]])
FLAT = Surface(Quadric.plane(np.zeros(3), np.array([0.0, 0.0, 1.0])), edge=EDGE)


def made(surface: Surface = FLAT, robots: tuple[str, ...] = ("alpha", "bravo"), box: Box | None = None) -> CoverageMap:
    """Nothing visited yet."""
    return CoverageMap.none(Grid.over(surface, PITCH, box), dict.fromkeys(robots, RADIUS))


def between(covered: CoverageMap, x: tuple[float, float], y: tuple[float, float]) -> NDArray[np.bool_]:
    """Patches (rows, columns) on the surface whose middles are between those, m of the frame."""
    middles = covered.grid.middles
    inside = (middles[..., 0] > x[0]) & (middles[..., 0] < x[1]) & (middles[..., 1] > y[0]) & (middles[..., 1] < y[1])
    found: NDArray[np.bool_] = inside & covered.grid.inside
    return found


def visited(
    covered: CoverageMap, robot: str, where: NDArray[np.bool_], seconds: float, at_s: float = 0.0, turn: float = 0.0
) -> CoverageMap:
    """With a robot over the patches for so long, at 0.1 m/s in one direction, once, until ``at_s`` after the first."""
    old = covered.robots[robot]
    path = np.where(where, 0.1 * seconds, 0.0)
    new = replace(
        old,
        dwell_s=old.dwell_s + np.where(where, seconds, 0.0),
        passes=old.passes + where,
        path_m=old.path_m + path,
        shift_m=old.shift_m + path[..., None] * [np.cos(turn), np.sin(turn)],
        last_ns=np.where(where, SINCE_NS + int(at_s * 1e9), old.last_ns),
        counted=old.counted + 60,
        counted_s=old.counted_s + 1.0,
    )
    until = max(covered.until_ns, SINCE_NS + int(at_s * 1e9))
    return replace(covered, robots={**covered.robots, robot: new}, since_ns=SINCE_NS, until_ns=until)


def nothing_but(covered: CoverageMap, robot: str, left_out: dict[str, int]) -> CoverageMap:
    """With poses of a robot that were left out."""
    new: Visits = replace(covered.robots[robot], left_out=left_out)
    return replace(covered, robots={**covered.robots, robot: new})
