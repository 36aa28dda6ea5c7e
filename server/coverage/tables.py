"""A map as tables that other programs read: a row for every patch, the list of regions, and arrays."""

import io
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.coverage.regions import Region, Regions
from asterism.server.coverage.summary import Summary
from asterism.server.coverage.visits import Visits

Column = NDArray[np.float64] | NDArray[np.int64]
PATCH_COLUMNS = ("column", "row", "x_m", "y_m", "z_m", "area_m2")
VISIT_COLUMNS = ("dwell_s", "passes", "speed_m_s", "direction_rad", "last_ns")
_VISIT, _NEVER = "%.6g,%d,%.5g,%.4f,%d", "," * 4
REGION_COLUMNS = (
    "number", "area_m2", "x_m", "y_m", "z_m", "length_m", "width_m", "mean_dwell_s", "most_dwell_s", "last_ns",
    "robots",
)  # fmt: skip


def patches_csv(told: Summary) -> Iterator[str]:
    """A line for every patch of the surface: its place in the grid and in the world, of all robots together, and of
    each one; empty where nobody was. Row by row of the grid: all of it at once may be long.
    """
    names = [*PATCH_COLUMNS, *VISIT_COLUMNS]
    names += [f"{robot}_{name}" for robot in told.covered.robots for name in VISIT_COLUMNS]
    yield f"{','.join(names)}\n"
    middles = middles_in_world(told)
    every = [_columns(visits) for visits in (told.whole, *told.covered.robots.values())]
    for row in np.flatnonzero(told.covered.grid.inside.any(axis=1)).tolist():
        yield from _lines(told, row, middles[row], every)


def _lines(told: Summary, row: int, middles: Floats, every: list[list[Column]]) -> Iterator[str]:
    grid = told.covered.grid
    inside = np.flatnonzero(grid.inside[row])
    own = zip(inside.tolist(), middles[inside].tolist(), grid.areas[row, inside].tolist(), strict=True)
    places = [
        f"{grid.box.column + column},{grid.box.row + row},{x:.6f},{y:.6f},{z:.6f},{area:.6g}"
        for column, (x, y, z), area in own
    ]
    values = [_visits(columns, row, inside) for columns in every]
    for cells in zip(places, *values, strict=True):
        yield f"{','.join(cells)}\n"


def _columns(visits: Visits) -> list[Column]:
    return [visits.dwell_s, visits.passes, visits.speed, visits.direction, visits.last_ns]


def _visits(columns: list[Column], row: int, inside: NDArray[np.intp]) -> list[str]:
    values = zip(*(column[row, inside].tolist() for column in columns), strict=True)
    return [_VISIT % each if each[0] > 0.0 else _NEVER for each in values]


def middles_in_world(told: Summary) -> Floats:
    """(rows, columns, 3) m; nan where there is no surface."""
    grid = told.covered.grid
    xy = grid.middles.reshape(-1, 2)
    heights = np.where(grid.inside.ravel(), grid.surface.ground(xy).heights, np.nan)
    points = grid.surface.T_world_surface.map(np.column_stack([xy, heights]))
    return points.reshape(*grid.box.shape, 3)


def regions_csv(regions: Regions) -> str:
    """A row for every gap, or overworked patch, the largest first."""
    return _csv(REGION_COLUMNS, (_region(each) for each in regions.found))


def _region(region: Region) -> list[str]:
    robots = " ".join(f"{robot}:{share:.3f}" for robot, share in region.robots)
    place = [f"{value:.6f}" for value in region.place.tolist()]
    size = [f"{region.length_m:.4f}", f"{region.width_m:.4f}", f"{region.mean_s:.6g}", f"{region.most_s:.6g}"]
    return [str(region.number), f"{region.area_m2:.6g}", *place, *size, str(region.last_ns or ""), robots]


def _csv(names: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    return "".join(f"{','.join(map(str, row))}\n" for row in (names, *rows))


def grid_npz(told: Summary) -> bytes:
    """The same as arrays: `x_m` (columns,) and `y_m` (rows,) of the surface's frame; (rows, columns) of all together;
    `robots`, and (robots, rows, columns) of each, behind `robot_`; nan where nobody was.
    """
    grid = told.covered.grid
    robots = list(told.covered.robots.values())
    arrays: dict[str, NDArray[np.generic]] = {
        "x_m": grid.x_m,
        "y_m": grid.y_m,
        "world_m": middles_in_world(told).astype(np.float32),
        "T_world_surface": np.concatenate(
            [grid.surface.T_world_surface.position, grid.surface.T_world_surface.orientation]
        ),
        "inside": grid.inside,
        "area_m2": grid.areas,
        "gap": told.gaps.numbers,
        "overworked": told.overworked.numbers,
        **_arrays(told.whole),
        "robots": np.array(list(told.covered.robots), dtype=np.str_),
    }
    for name in _arrays(told.whole):
        arrays[f"robot_{name}"] = np.stack([_arrays(each)[name] for each in robots])
    out = io.BytesIO()
    np.savez_compressed(out, allow_pickle=False, **arrays)
    return out.getvalue()


def _arrays(visits: Visits) -> dict[str, NDArray[np.generic]]:
    return {
        "dwell_s": visits.dwell_s,
        "passes": visits.passes,
        "speed_m_s": visits.speed,
        "direction_rad": visits.direction,
        "last_ns": visits.last_ns,
    }
