"""A grid of heights as a table: header `x,y,z` or `x,y,z,sigma`, a row for every node that there is, m."""

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights

COLUMNS = ("x", "y", "z", "sigma")
MOST_NODES = 512 * 512
_ON_GRID = 1e-3  # of a step


def parse_heights(text: str, name: str) -> Heights:
    """The grid that a table's text describes. Raises InputError with file, line or column, and what is accepted."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    header = tuple(part.strip() for part in lines[0].split(",")) if lines else ()
    if header not in (COLUMNS[:3], COLUMNS):
        raise InputError(
            f"{name}: begins with {', '.join(header) or 'nothing'}, expected the header x,y,z or x,y,z,sigma"
        )
    try:
        rows = np.array([[float(part) for part in line.split(",")] for line in lines[1:]])
    except ValueError:
        raise InputError(f"{name}: not every row has {len(header)} numbers, expected {','.join(header)}") from None
    if rows.ndim != 2 or rows.shape[1] != len(header) or not np.isfinite(rows).all():
        raise InputError(f"{name}: not every row has {len(header)} finite numbers, expected {','.join(header)}")
    (origin_x, step_x, i), (origin_y, step_y, j) = _axis(rows[:, 0], name, "x"), _axis(rows[:, 1], name, "y")
    shape = int(i.max()) + 1, int(j.max()) + 1
    if shape[0] * shape[1] > MOST_NODES:
        raise InputError(f"{name}: a grid of {shape[0]} x {shape[1]} nodes, expected at most {MOST_NODES} in all")
    values, sigmas = np.full(shape, np.nan), np.zeros(shape)
    values[i, j] = rows[:, 2]
    if len(header) > 3:
        sigmas[i, j] = rows[:, 3]
    return Heights(np.array([origin_x, origin_y]), np.array([step_x, step_y]), values, sigmas)


def _axis(values: Floats, name: str, axis: str) -> tuple[float, float, "np.ndarray[tuple[int], np.dtype[np.int64]]"]:
    """First place, step, and every row's number along an axis."""
    places = np.unique(values)
    gaps = np.diff(places)
    gaps = gaps[gaps > 1e-9]
    if not len(gaps):
        raise InputError(f"{name}: all rows have the same {axis}, expected the nodes of a grid")
    step = float(gaps.min())
    number = (values - places[0]) / step
    index = np.rint(number).astype(np.int64)
    if (np.abs(number - index) > _ON_GRID * np.maximum(index, 1)).any():
        raise InputError(f"{name}: the {axis} of its rows are not evenly spaced, expected the nodes of a grid")
    return float(places[0]), step, index


def heights_text(heights: Heights) -> str:
    """The table of a grid, which `parse_heights` reads."""
    lines = [",".join(COLUMNS)]
    for i, j in np.argwhere(np.isfinite(heights.values)).tolist():
        x, y = heights.origin + heights.step * [i, j]
        lines.append(f"{x:.7g},{y:.7g},{heights.values[i, j]:.8g},{heights.sigmas[i, j]:.3g}")
    return "\n".join(lines) + "\n"
