"""A map as arrays in a file."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.server.coverage.visits import CoverageMap, Visits


def save(path: Path, covered: CoverageMap) -> None:
    """Write `coverage.npz`: `x_m` (columns,) and `y_m` (rows,) of the surface's frame, `area_m2` and `inside` (rows,
    columns), `robots`, and of each (robots, rows, columns) what `Visits` holds, by the names there.
    """
    grid, each = covered.grid, list(covered.robots.values())
    columns = [_columns(visits) for visits in each]
    np.savez_compressed(
        path,
        allow_pickle=False,
        x_m=grid.x_m,
        y_m=grid.y_m,
        area_m2=grid.areas,
        inside=grid.inside,
        robots=np.array(list(covered.robots), np.str_),
        **{name: np.stack([told[name] for told in columns]) for name in columns[0]},
    )


def _columns(visits: Visits) -> dict[str, NDArray[np.generic]]:
    return {
        "dwell_s": visits.dwell_s,
        "passes": visits.passes,
        "path_m": visits.path_m,
        "shift_m": visits.shift_m,
        "last_ns": visits.last_ns,
    }
