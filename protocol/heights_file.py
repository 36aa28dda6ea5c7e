"""A grid of heights as a table: header `x,y,z` or `x,y,z,sigma`, a row for every node that there is, m."""

import io
import math

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights

COLUMNS = ("x", "y", "z", "sigma")
BEGIN = ",".join(COLUMNS[:3])  # of every table
WHAT = "the nodes of a grid, m: x,y,z or x,y,z,sigma"
MOST_NODES = 512 * 512
MOST_BYTES = 32 << 20
LARGEST_M = 20.0  # of what a robot drives on, along x or y
LARGEST_SIGMA_M = 0.05
_FARTHEST_M = 100.0
_ON_GRID = 5e-3  # of a step
_SAME = 1e-5  # of the whole extent: places so near are one
_SLOPE = 3e-5  # what rounding may turn a surface by, rad
Ints = NDArray[np.int64]


def parse_heights(text: str, name: str) -> Heights:
    """The grid that a table's text describes. Raises InputError with file, line or column, and what is accepted."""
    numbered = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip(" ,\t")]
    numbered = [(number, line) for number, line in numbered if not line.startswith("#")]
    header = _header(numbered[0][1].lstrip("\ufeff") if numbered else "", name)
    lines = [number for number, _ in numbered[1:]]
    if len(lines) > MOST_NODES:
        raise InputError(
            f"{name}: has {len(lines)} rows, expected a grid of at most {MOST_NODES} nodes; take every other"
        )
    rows = _numbers([line for _, line in numbered[1:]], lines, len(header), name)
    _refuse_values(rows, lines, name)
    (origin_x, step_x, i), (origin_y, step_y, j) = (_axis(rows[:, axis], lines, name, COLUMNS[axis]) for axis in (0, 1))
    shape = int(i.max()) + 1, int(j.max()) + 1
    if shape[0] * shape[1] > MOST_NODES:
        raise InputError(
            f"{name}: is on a grid of {shape[0]} x {shape[1]} nodes, {step_x:.3g} x {step_y:.3g} m apart, "
            f"expected at most {MOST_NODES} nodes"
        )
    _refuse_twice(i * shape[1] + j, lines, name)
    values, sigmas = np.full(shape, np.nan), np.zeros(shape)
    values[i, j] = rows[:, 2]
    if len(header) > 3:
        sigmas[i, j] = rows[:, 3]
    there = np.isfinite(values)
    if not (there[:-1, :-1] & there[1:, :-1] & there[:-1, 1:] & there[1:, 1:]).any():
        raise InputError(f"{name}: no four nodes of its grid are beside one another, expected a surface between nodes")
    return Heights(np.array([origin_x, origin_y]), np.array([step_x, step_y]), values, sigmas)


def _header(line: str, name: str) -> tuple[str, ...]:
    header = tuple(part.strip().strip('"').lower() for part in line.split(","))
    if header in (COLUMNS[:3], COLUMNS):
        return header
    shown = line.strip()[:60]
    shown = shown if shown.isprintable() else repr(shown)
    hint = ""
    if ";" in line or "\t" in line:
        hint = "; columns are separated by commas, and numbers have a point"
    elif "mm" in line.lower():
        hint = "; lengths are in m"
    elif line.lstrip().lower().startswith("solid"):
        hint = "; is it an STL? Name it under `stl`"
    raise InputError(f"{name}: begins with {shown or 'nothing'}, expected the header x,y,z or x,y,z,sigma{hint}")


def _numbers(rows: list[str], lines: list[int], count: int, name: str) -> Floats:
    if not rows:
        raise InputError(f"{name}: has no row behind its header, expected the nodes of a grid")
    try:
        numbers = np.loadtxt(io.StringIO("\n".join(rows)), delimiter=",", ndmin=2, comments=None)
        if numbers.shape == (len(rows), count) and np.isfinite(numbers).all():
            return numbers
    except ValueError:
        pass
    for line, row in zip(lines, rows, strict=True):
        try:
            good = len([number for number in map(float, row.split(",")) if math.isfinite(number)]) == count
        except ValueError:
            good = False
        if not good:
            shown = row.strip()[:60]
            shown = shown if shown.isprintable() else repr(shown)
            raise InputError(
                f"{name}: line {line}: '{shown}', expected {count} finite numbers {','.join(COLUMNS[:count])}"
            )
    raise InputError(f"{name}: not every row has {count} finite numbers, expected {','.join(COLUMNS[:count])}")


def _refuse_values(rows: Floats, lines: list[int], name: str) -> None:
    extent = np.ptp(rows[:, :2], axis=0)
    most = float(np.abs(rows[:, :3]).max())
    if extent.max() > LARGEST_M or most > _FARTHEST_M:
        raise InputError(
            f"{name}: is {extent[0]:.4g} x {extent[1]:.4g} m large and reaches {most:.4g} m from its origin, expected "
            f"at most {LARGEST_M:g} m and {_FARTHEST_M:g} m; is that mm? Divide x, y, z (and sigma) by 1000"
        )
    if rows.shape[1] > 3:
        wrong = (rows[:, 3] < 0.0) | (rows[:, 3] > LARGEST_SIGMA_M)
        if wrong.any():
            first = int(np.argmax(wrong))
            raise InputError(
                f"{name}: line {lines[first]}: a sigma of {rows[first, 3]:g}, expected m, 0 to {LARGEST_SIGMA_M:g}"
            )


def _axis(values: Floats, lines: list[int], name: str, axis: str) -> tuple[float, float, Ints]:
    """First place, step, and every row's number along an axis."""
    places, inverse = np.unique(values, return_inverse=True)
    gaps = np.diff(places)
    wide = gaps[gaps > _SAME * (places[-1] - places[0])]
    if not len(wide):
        raise InputError(
            f"{name}: all rows have the same {axis}, expected the nodes of a grid, two or more along {axis}"
        )
    # Written places are rounded: a node is counted from the one before it, and the step is the mean.
    number = np.concatenate([[0.0], np.cumsum(np.rint(gaps / wide.min()))])
    step = float(places[-1] - places[0]) / float(number[-1])
    off = np.abs(places - places[0] - number * step)
    if (off > _ON_GRID * step).any():
        worst = int(off.argmax())
        raise InputError(
            f"{name}: line {lines[int(np.argmax(inverse == worst))]}: {axis} = {places[worst]:g} is not where the node "
            f"of an even grid is ({step:.4g} m apart from {places[0]:g} on), expected rows on a grid; points that lie "
            "anyhow have to be put on one first"
        )
    return float(places[0]), step, number.astype(np.int64)[inverse]


def _refuse_twice(node: Ints, lines: list[int], name: str) -> None:
    order = np.argsort(node, kind="stable")
    same = np.flatnonzero(np.diff(node[order]) == 0)
    if len(same):
        first, second = (lines[int(order[same[0] + k])] for k in (0, 1))
        raise InputError(f"{name}: lines {first} and {second} are the same node of the grid, expected each once")


def heights_text(heights: Heights) -> str:
    """The table of a grid, which `parse_heights` reads: heights with as many digits as its slopes are worth."""
    digits = min(max(math.ceil(-math.log10(_SLOPE * float(heights.step.min()))), 6), 9)
    lines = [",".join(COLUMNS)]
    xs, ys = (
        [f"{heights.origin[axis] + heights.step[axis] * k:.7g}" for k in range(heights.values.shape[axis])]
        for axis in (0, 1)
    )
    there = np.argwhere(np.isfinite(heights.values)).tolist()
    for i, j in there:
        lines.append(f"{xs[i]},{ys[j]},{_short(heights.values[i, j], digits)},{heights.sigmas[i, j]:.2g}")
    return "\n".join(lines) + "\n"


def _short(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
