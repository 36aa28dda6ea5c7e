"""The error budget over a rig's workspace: against distance, against tilt and against the place in the image."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig, Robot
from asterism.server.budget.budget import SOURCES, TILTS, Light, covariances_of, poses_at, sources_of
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.identity.plan import plan_for

ALL_TILTS = (0.0, 5.0, 10.0, *TILTS)
MOST_ROBOTS = 6  # of a rig, evenly picked
DISTANCES = 9
COLUMNS, ROWS = 13, 11  # of places in the image
MARGIN_PX = 4.0  # of the outermost LED from the edge of the image


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """Variances by source (in the order of ``sources``) and component (of COMPONENTS), m^2 and rad^2.

    ``by_distance`` (d, sources, 6) at ``distances`` (d,) m along the optical axis: means over robots, nine places,
    TILTS and their directions. ``by_tilt`` (t, sources, 6) at ALL_TILTS and ``by_place`` (rows, columns, sources, 6),
    means over TILTS, at the ``middle`` distance; ``across`` (columns,) and ``down`` (rows,) px are the places, nan
    where no ray of the lens leads. ``robots`` are those that were looked at. ``alone`` (d, 6): of all sources together
    by light alone, where the rig has a surface that robots stand on.
    """

    distances: Floats
    by_distance: Floats
    by_tilt: Floats
    middle: float
    across: Floats
    down: Floats
    by_place: Floats
    robots: tuple[str, ...]
    sources: tuple[str, ...] = SOURCES
    alone: Floats | None = None


def budget_of(rig: Rig, uncertainty: Uncertainty, light: Light) -> Budget:
    """The budget of a rig, over its range or where its robots can be seen at all."""
    near, far = (plan := plan_for(rig)).near, plan.far
    distances = np.geomspace(near, max(far, 1.01 * near), DISTANCES)
    middle = float(distances[DISTANCES // 2])
    picked = np.unique(np.linspace(0, len(rig.robots) - 1, MOST_ROBOTS).round().astype(int))
    robots = [rig.robots[k] for k in picked]

    sources = sources_of(rig)

    def variances(
        robot: Robot, distance: float, places: Floats, tilts: tuple[float, ...], rig: Rig = rig
    ) -> tuple[Floats, NDArray[np.intp]]:
        """Variances (n, sources, 6) and the place (n,) of each."""
        poses, at = poses_at(rig, robot, distance, places, tilts)
        if not len(poses):
            return np.zeros((0, len(sources_of(rig)), 6)), at
        covariances = covariances_of(rig, robot, poses, uncertainty, light)
        return np.diagonal(covariances, axis1=2, axis2=3), at

    by_distance, by_tilt, alone = [], [], []
    for distance in distances:
        places = _grid(rig, robots, distance, 3, 3)
        rows = [variances(robot, distance, _pairs(*places), TILTS)[0] for robot in robots]
        by_distance.append(np.concatenate(rows).mean(axis=0))
        if sources != SOURCES:
            light_only = replace(rig, surface=None)
            rows = [variances(robot, distance, _pairs(*places), TILTS, light_only)[0] for robot in robots]
            alone.append(np.concatenate(rows).mean(axis=0).sum(axis=0))
    for tilt in ALL_TILTS:
        rows = [variances(robot, middle, _pairs(*_grid(rig, robots, middle, 3, 3)), (tilt,))[0] for robot in robots]
        by_tilt.append(np.concatenate(rows).mean(axis=0))
    across, down = _grid(rig, robots, middle, COLUMNS, ROWS)
    by_place = np.full((ROWS * COLUMNS, len(sources), 6), np.nan)
    found = [variances(robot, middle, _pairs(across, down), TILTS) for robot in robots]
    values, at = np.concatenate([rows for rows, _ in found]), np.concatenate([places for _, places in found])
    for place in np.unique(at):
        by_place[place] = values[at == place].mean(axis=0)
    return Budget(
        distances,
        np.array(by_distance),
        np.array(by_tilt),
        middle,
        across,
        down,
        by_place.reshape(ROWS, COLUMNS, len(sources), 6),
        tuple(robot.id for robot in robots),
        sources,
        np.array(alone) if alone else None,
    )


def _grid(rig: Rig, robots: list[Robot], distance: float, columns: int, rows: int) -> tuple[Floats, Floats]:
    """Places across and down, px, at which a robot's LEDs are all in the image, for any turn of it."""
    reach = max(float(np.linalg.norm(robot.leds - robot.leds.mean(axis=0), axis=1).max()) for robot in robots)
    margin = reach * rig.camera.focal_px / distance + MARGIN_PX
    axes = []
    for size, count in ((rig.camera.width, columns), (rig.camera.height, rows)):
        middle = 0.5 * (size - 1)
        axes.append(np.linspace(-1.0, 1.0, count) * max(middle - margin, 0.0) + middle)
    return axes[0], axes[1]


def _pairs(across: Floats, down: Floats) -> Floats:
    x, y = np.meshgrid(across, down)
    return np.column_stack([x.ravel(), y.ravel()])
