"""A mould drawn from a seed: as its drawing has it, as it is, and where it lies; with the robots that polish it.

It is what `asterism example --surface` writes down. A mould that was milled and has lain about differs from its drawing
by tenths of a millimetre: this one has sagged across, and somewhere too much was taken off it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.surface import Heights, Surface
from asterism.protocol.surface_file import Stands
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.measured_rig import HUNG_M, HUNG_RAD, drawn_camera

POLISHING = 4  # of the demonstration's robots
SIZE_M, STEP_M = (0.48, 0.36), 0.01  # of the drawing, whose corner is its origin; of its nodes
BOTTOM_M = 0.0  # z of the drawing
HEIGHT_M = 1.25  # of the camera above the table
LAID_M, LAID_RAD = 4e-3, 0.015  # where it lies on the table, per axis
SAG_M, DENT_M, DENT_WIDTH_M = 0.4e-3, 0.5e-3, 0.03
STANDS_M, UPRIGHT_RAD = 5e-5, math.radians(0.1)  # how well robots stand
TOOL_RADIUS_M = 0.015


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMould:
    """``true``: the camera, its robots, and the mould as it is; ``drawing``: the top of the mould as it was drawn, in a
    frame of its own; ``dent`` (2,) m: where too much was taken off, in that frame.
    """

    true: Rig
    drawing: Heights
    dent: Floats


def draw_mould(seed: int) -> MeasuredMould:
    """The mould of a seed; every seed has its own camera, place and dent."""
    rng = np.random.default_rng([seed, 10])
    camera, place = drawn_camera(rng), _above(rng)
    drawing, grid = _drawing()
    dent = (np.array(SIZE_M) * rng.uniform([0.25, 0.25], [0.75, 0.75])).round(3)
    across = 2.0 * grid[..., 0] / SIZE_M[0] - 1.0
    away = np.square(grid - dent).sum(axis=-1)
    values = drawing.values - SAG_M * (1.0 - across**2) - DENT_M * np.exp(-0.5 * away / DENT_WIDTH_M**2)
    laid = Pose.from_matrix(
        exp_rotation(LAID_RAD * rng.normal(size=3)),
        (np.array([-0.5 * SIZE_M[0], -0.5 * SIZE_M[1], 0.0]) + LAID_M * rng.normal(size=3)).round(6),
    )
    mould = Surface(replace(drawing, values=values.round(7)), laid)
    stands = Stands("tool", np.array([0.0, 0.0, 1.0]), STANDS_M, UPRIGHT_RAD, TOOL_RADIUS_M)
    robots = tuple(replace(robot, normal=None, stands=stands) for robot in load_rig(DEMO_RIG).robots[:POLISHING])
    return MeasuredMould(Rig(camera, robots, (0.9, 1.5), T_world_camera=place, surface=mould), drawing, dent)


def _drawing() -> tuple[Heights, Floats]:
    """The top as it was drawn, and x, y of its nodes (nx, ny, 2)."""
    axes = [np.linspace(0.0, side, round(side / STEP_M) + 1) for side in SIZE_M]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    u, v = grid[..., 0] - 0.5 * SIZE_M[0], grid[..., 1] - 0.5 * SIZE_M[1]
    values = 0.06 + 0.03 * np.cos(4.2 * u) * np.cos(3.4 * v) + 0.006 * np.sin(9.0 * u + 3.0 * v)
    return Heights(np.zeros(2), np.array([STEP_M, STEP_M]), values.round(6), np.zeros(values.shape)), grid


def _above(rng: np.random.Generator) -> Pose:
    """T_world_camera: above the table, looking down, a little askew."""
    askew = exp_rotation(HUNG_RAD * rng.normal(size=3)) @ np.diag([1.0, -1.0, -1.0])
    return Pose.from_matrix(askew, (np.array([0.0, 0.0, HEIGHT_M]) + HUNG_M * rng.normal(size=3)).round(6))
