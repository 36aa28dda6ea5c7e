"""Surveyed truth from a spreadsheet: a row a robot and frame.

Columns, in any order and in capitals or not: `robot`; `frame` (the image's name) or a time (`time_s`, `exposed_ns`);
`x`, `y`, `z` each with its unit (`x_m`, `x_mm`, `x_cm`, or `x [mm]`); and the orientation, which may be left out where
it was not surveyed: `qx`, `qy`, `qz`, `qw`, or `roll`, `pitch`, `yaw` with theirs (`yaw_deg`, `yaw_rad`), turned about
the parent's fixed axes x, y, z in that order, as REP 103 has it; `yaw` alone is that of a robot that stands upright.
"""

import math
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.keys import key_problem
from asterism.protocol.yaml_file import shortened
from asterism.server.calibration.survey.table import Cells, Table, open_table

SUFFIX = ".csv"
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
ANGLES = {"deg": math.pi / 180.0, "rad": 1.0}
FARTHEST_M = 1e6
UNIT = 1e-3  # a quaternion may be off unit length by so much
_QUATERNION = ("qx", "qy", "qz", "qw")
_TURNS = ("roll", "pitch", "yaw")
_ALIASES = {"robot_id": "robot", "id": "robot", "image": "frame", "file": "frame"}
_KNOWN = {
    *("robot", "frame", "time_s", "exposed_ns", *_ALIASES, *_QUATERNION),
    *(f"{axis}_{unit}" for axis in "xyz" for unit in LENGTHS),
    *(f"{turn}_{unit}" for turn in _TURNS for unit in ANGLES),
}


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One robot in one frame: ``position`` (3,) m; ``orientation`` (4,) x y z w, None where it was not surveyed."""

    line: int
    frame: str
    exposed_ns: int | None
    robot: str
    position: Floats
    orientation: Floats | None


@dataclass(frozen=True, slots=True, eq=False)
class SurveyRows:
    """A spreadsheet's rows in its order; ``remarks`` say what was not taken, or taken for something."""

    rows: tuple[Row, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Layout:
    """Which column holds what: ``position`` and ``turns`` by name with the factor to m and rad."""

    robot: str
    frame: str | None
    time: str | None
    position: tuple[tuple[str, float], ...]
    quaternion: tuple[str, ...]
    turns: tuple[tuple[str, float] | None, ...]


def read_survey_csv(path: Path) -> SurveyRows:
    """The rows of a spreadsheet. One whose place is empty was not surveyed, and is left out, which a remark says.

    Raises InputError with file, line and column, what was found and what is accepted; for a column that is missing,
    which.
    """
    table = open_table(path, _KNOWN)
    layout = _layout(table)
    rows: list[Row] = []
    empty = 0
    seen: dict[tuple[str, str], int] = {}
    times: dict[str, tuple[int | None, int]] = {}
    for cells in table.rows:
        if not any(cells.values[name] for name, _ in layout.position):
            empty += 1
            continue
        row = _row(table, layout, cells)
        if (line := seen.setdefault((row.frame, row.robot), row.line)) != row.line:
            raise table.error(cells, layout.robot, f"{row.robot!r} has frame {row.frame!r} in line {line} already")
        time_ns, line = times.setdefault(row.frame, (row.exposed_ns, row.line))
        if time_ns != row.exposed_ns:
            raise table.error(cells, layout.time, f"another time than frame {row.frame!r} has in line {line}")
        rows.append(row)
    if not rows:
        raise table.error(None, None, "holds no row with a place, expected a row a robot and frame")
    return SurveyRows(tuple(rows), tuple(_remarks(table, layout, empty)))


def _layout(table: Table) -> _Layout:
    names = {_ALIASES.get(name, name): name for name in table.columns}
    aliased = [name for name in table.columns if name in _ALIASES and _ALIASES[name] in table.columns]
    if aliased or sum(_ALIASES.get(name, name) == "robot" for name in table.columns) > 1:
        raise table.error(None, None, f"names {_list(table.columns)}, expected one column for the robot and the frame")
    if "robot" not in names:
        raise table.error(None, None, "column robot is missing, expected the robot's id in every row")
    time = next((name for name in ("exposed_ns", "time_s") if name in names), None)
    if "frame" not in names and time is None:
        raise table.error(
            None, None, "column frame is missing, expected the image's name in every row (or a time_s or exposed_ns)"
        )
    position = tuple(_with_unit(table, axis, LENGTHS) for axis in "xyz")
    quaternion = tuple(name for name in _QUATERNION if name in names)
    turns = tuple(_with_unit(table, turn, ANGLES, needed=False) for turn in _TURNS)
    _check_orientation(table, quaternion, turns)
    placed = tuple(found for found in position if found is not None)
    return _Layout(names["robot"], names.get("frame"), time, placed, quaternion, turns)


def _with_unit(table: Table, name: str, units: dict[str, float], needed: bool = True) -> tuple[str, float] | None:
    """The column of that name with its unit, and the factor."""
    accepted = " or ".join(f"{name}_{unit}" for unit in units)
    found = [(f"{name}_{unit}", factor) for unit, factor in units.items() if f"{name}_{unit}" in table.columns]
    if len(found) > 1:
        raise table.error(None, None, f"columns {found[0][0]} and {found[1][0]} are both there, expected one of them")
    if not found and name in table.columns:
        raise table.error(None, name, f"tells no unit, expected {accepted}")
    if not found and needed:
        raise table.error(None, None, f"column {name} is missing, expected {accepted}")
    return found[0] if found else None


def _check_orientation(table: Table, quaternion: tuple[str, ...], turns: tuple[tuple[str, float] | None, ...]) -> None:
    """All of a quaternion, all three angles, yaw alone, or nothing."""
    if quaternion and any(turns):
        raise table.error(
            None, None, f"columns {quaternion[0]} and {_turn_names(turns)[0]} are both there, expected one kind"
        )
    for name in _QUATERNION:
        if quaternion and name not in quaternion:
            raise table.error(None, None, f"column {name} is missing, expected all of {', '.join(_QUATERNION)}")
    if any(turns[:2]) and not all(turns):
        missing = next(name for name, found in zip(_TURNS, turns, strict=True) if found is None)
        raise table.error(
            None,
            None,
            f"column {missing} is missing, expected {missing}_deg or {missing}_rad beside {_turn_names(turns)[0]}",
        )


def _row(table: Table, layout: _Layout, cells: Cells) -> Row:
    robot = cells.values[layout.robot]
    if problem := key_problem(robot):
        raise table.error(cells, layout.robot, f"{shortened(robot)!r} {problem}")
    exposed_ns = _time(table, layout, cells)
    frame = cells.values[layout.frame] if layout.frame is not None else str(exposed_ns)
    if not frame:
        raise table.error(cells, layout.frame, "is empty, expected the image's name")
    if not frame.isprintable():
        raise table.error(cells, layout.frame, f"{shortened(repr(frame))}, expected the image's name")
    position = np.array([_real(table, cells, name, factor, FARTHEST_M) for name, factor in layout.position])
    return Row(cells.line, frame, exposed_ns, robot, position, _orientation(table, layout, cells))


def _time(table: Table, layout: _Layout, cells: Cells) -> int | None:
    """ns; None where there is no column for it, or, beside a frame, nothing in it."""
    column = layout.time
    if column is None or (layout.frame is not None and not cells.values[column]):
        return None
    text = cells.values[column]
    if column == "exposed_ns" and not (text.isascii() and text.isdecimal()):
        raise table.error(cells, column, f"{shortened(text)!r}, expected ns as a whole number, every digit of it")
    time_ns = round(Decimal(table.number(cells, column)) * (1 if column == "exposed_ns" else 10**9))
    if not 0 <= time_ns < 1 << 63:
        raise table.error(cells, column, f"{shortened(text)!r}, expected a time from 0 to {(1 << 63) // 10**9} s")
    return time_ns


def _real(table: Table, cells: Cells, column: str, factor: float, most: float) -> float:
    if not cells.values[column]:
        raise table.error(cells, column, "is empty, expected a number, or a row without a place")
    value = float(table.number(cells, column)) * factor
    if not abs(value) <= most:
        raise table.error(cells, column, f"{shortened(cells.values[column])!r}, expected up to {most:g} in SI units")
    return value


def _orientation(table: Table, layout: _Layout, cells: Cells) -> Floats | None:
    """x y z w; None where its cells are empty."""
    turns = [found for found in layout.turns if found is not None]
    if not any(cells.values[name] for name in (*layout.quaternion, *(name for name, _ in turns))):
        return None
    if layout.quaternion:
        quat = np.array([_real(table, cells, name, 1.0, 2.0) for name in _QUATERNION])
        length = float(np.linalg.norm(quat))
        if abs(length - 1.0) > UNIT:
            raise table.error(cells, "qw", f"a quaternion of length {length:g}, expected qx, qy, qz, qw of length 1")
        return Pose(np.zeros(3), quat).orientation
    roll, pitch, yaw = (0.0 if found is None else _real(table, cells, *found, 1e4) for found in layout.turns)
    about_z, about_y, about_x = np.array([0.0, 0.0, yaw]), np.array([0.0, pitch, 0.0]), np.array([roll, 0.0, 0.0])
    turned = exp_rotation(about_z) @ exp_rotation(about_y) @ exp_rotation(about_x)
    return Pose.from_matrix(turned, np.zeros(3)).orientation


def _remarks(table: Table, layout: _Layout, empty: int) -> list[str]:
    taken = {layout.robot, layout.frame, layout.time, *(name for name, _ in layout.position), *layout.quaternion}
    taken |= set(_turn_names(layout.turns))
    ignored = [name for name in table.columns if name and name not in taken]
    remarks = [f"{table.path}: columns not looked at: {_list(ignored)}"] if ignored else []
    if empty:
        remarks.append(f"{table.path}: rows without a place, left out: {empty}")
    if _turn_names(layout.turns) and layout.turns[0] is None:
        remarks.append(f"{table.path}: has a yaw, but no roll and pitch: robots are taken to stand upright")
    return remarks


def _turn_names(turns: tuple[tuple[str, float] | None, ...]) -> list[str]:
    return [found[0] for found in turns if found is not None]


def _list(names: list[str]) -> str:
    return ", ".join(repr(shortened(name, 30)) for name in names[:5]) + (", ..." if len(names) > 5 else "")
