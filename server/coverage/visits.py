"""What is known of where tools have been: sums over time, patch by patch; of each robot, and of all together."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.coverage.grid import Box, Grid

# Why a pose does not say where a tool was.
NOT_TRACKED = "not tracked"
UNSURE = "not sure enough"
LIFTED, SUNK, TILTED = "lifted", "sunk", "tilted"
BEYOND = "beyond the edge"
OFF_MAP = "off the map"  # of a surface without an edge: the grid would have too many patches
GAP = "gap"  # of time between two poses: counts gaps
REASONS = (NOT_TRACKED, UNSURE, LIFTED, SUNK, TILTED, BEYOND, OFF_MAP, GAP)


@dataclass(frozen=True, slots=True, eq=False)
class Visits:
    """How a tool went over the patches of a grid; all arrays (rows, columns) but ``shift_m`` (rows, columns, 2).

    ``dwell_s``: how long it was over the patch's middle; ``passes``: how often it came over it; ``path_m``: how far it
    went while it was over it, and ``shift_m``, the sum of those ways as vectors along x and y of the frame;
    ``last_ns``: when it was over it last, ns since the Unix epoch, 0: never. ``radius_m`` of the tool. ``counted``
    poses were used, over ``counted_s`` of time; ``left_out`` says how many were not, by the reason (`REASONS`).
    """

    radius_m: float
    dwell_s: Floats
    passes: NDArray[np.int64]
    path_m: Floats
    shift_m: Floats
    last_ns: NDArray[np.int64]
    counted: int = 0
    counted_s: float = 0.0
    left_out: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def none(grid: Grid, radius_m: float) -> "Visits":
        """Nowhere yet."""
        shape = grid.box.shape
        dwell, path, shift = np.zeros(shape), np.zeros(shape), np.zeros((*shape, 2))
        return Visits(radius_m, dwell, np.zeros(shape, np.int64), path, shift, np.zeros(shape, np.int64))

    @property
    def visited(self) -> NDArray[np.bool_]:
        """(rows, columns): whether the tool was ever there."""
        return self.dwell_s > 0.0

    @property
    def speed(self) -> Floats:
        """(rows, columns) m/s, mean over the time that the tool was there; nan where it never was."""
        with np.errstate(invalid="ignore"):
            speed: Floats = self.path_m / self.dwell_s
        return speed

    @property
    def direction(self) -> Floats:
        """(rows, columns) rad from x to y of the frame: where the tool went on the whole; nan where it never was."""
        direction: Floats = np.where(self.visited, np.arctan2(self.shift_m[..., 1], self.shift_m[..., 0]), np.nan)
        return direction

    def on(self, old: Box, new: Box) -> "Visits":
        """The same on a grid whose box is a larger one."""
        rows, columns = old.within(new)

        def moved(array: NDArray[Any]) -> NDArray[Any]:
            out = np.zeros((*new.shape, *array.shape[2:]), array.dtype)
            out[rows, columns] = array
            return out

        return replace(
            self,
            dwell_s=moved(self.dwell_s),
            passes=moved(self.passes),
            path_m=moved(self.path_m),
            shift_m=moved(self.shift_m),
            last_ns=moved(self.last_ns),
        )


def together(visits: Iterable[Visits]) -> Visits:
    """Of several on one grid, one at least: as if one tool had been everywhere, of the least of their radii."""
    every = list(visits)
    left_out: Counter[str] = Counter()
    for each in every:
        left_out.update(each.left_out)
    return Visits(
        min(each.radius_m for each in every),
        np.sum([each.dwell_s for each in every], axis=0),
        np.sum([each.passes for each in every], axis=0),
        np.sum([each.path_m for each in every], axis=0),
        np.sum([each.shift_m for each in every], axis=0),
        np.max([each.last_ns for each in every], axis=0),
        sum(each.counted for each in every),
        sum(each.counted_s for each in every),
        left_out,
    )


@dataclass(frozen=True, slots=True, eq=False)
class CoverageMap:
    """Where tools have been: on the patches of ``grid``, of every robot that stands on the surface, ``robots`` by id.

    ``since_ns``, ``until_ns``: exposure of the first frame that was looked at, and of the newest; 0 where none was.
    """

    grid: Grid
    robots: Mapping[str, Visits]
    since_ns: int = 0
    until_ns: int = 0

    @staticmethod
    def none(grid: Grid, radii_m: Mapping[str, float]) -> "CoverageMap":
        """Nothing yet, of robots whose tools have those radii, m."""
        return CoverageMap(grid, {robot: Visits.none(grid, radius) for robot, radius in radii_m.items()})

    @property
    def together(self) -> Visits:
        """Of all robots as one."""
        return together(self.robots.values())

    def reaching(self, box: Box) -> "CoverageMap":
        """The same on a grid that holds the box as well; a surface that ends has all of its patches already."""
        old, new = self.grid.box, self.grid.box.with_(box)
        if self.grid.ends or new == old:
            return self
        grid = Grid.over(self.grid.surface, self.grid.pitch_m, new)
        return replace(self, grid=grid, robots={robot: visits.on(old, new) for robot, visits in self.robots.items()})
