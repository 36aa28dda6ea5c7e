"""The live table's lines, as wide as the terminal: what matters least gives way, and no number is ever broken."""

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from rich.cells import cell_len
from rich.text import Text

GAP = 2
NAME_CELLS = 12  # of a name on a narrow terminal
REASON_CELLS = 16  # a reason with less room than that begins on its own line
STYLES = {"TRACKED": "green", "TILT_AMBIGUOUS": "yellow", "IDENTITY_AMBIGUOUS": "magenta"}  # all else is red
ON = "on"  # the surface
SHORT_STATES = {"TILT_AMBIGUOUS": "TILT?", "IDENTITY_AMBIGUOUS": "IDENTITY?"}


@dataclass(frozen=True, slots=True)
class Row:
    """One robot of one camera, as it is shown. ``position_mm`` is None while there is no pose."""

    camera: str
    robot: str
    state: str
    reason: str = ""
    age_s: float | None = None
    position_mm: tuple[float, float, float] | None = None
    heading_deg: float = 0.0
    tilt_deg: float = 0.0
    leds: int = 0
    rms_px: float = 0.0
    rate_hz: float = 0.0
    speed_mm_s: float | None = None  # where the server smooths
    turning_deg_s: float | None = None
    surface: str = ""  # `on` it, or how it is off; of a robot that by the rig stands on it


class _Column(NamedTuple):
    title: str
    cell: Callable[[Row], str]
    rank: int = 0  # the lowest above 0 gives way first, 0 never
    number: bool = True
    only_if: Callable[[Row], bool] | None = None  # it is shown where that is so of a row


def _position(axis: int) -> Callable[[Row], str]:
    return lambda row: "" if row.position_mm is None else _decimals(row.position_mm[axis], 2)


def _with_pose(cell: Callable[[Row], str]) -> Callable[[Row], str]:
    return lambda row: "" if row.position_mm is None else cell(row)


def _told(value: float | None) -> str:
    return "" if value is None else _decimals(value, 1)


_CAMERA = _Column("camera", lambda row: row.camera, 10, number=False)
_COLUMNS = (
    _Column("robot", lambda row: row.robot, number=False),
    _Column("state", lambda row: row.state, 9, number=False),
    _Column("age", lambda row: _age(row.age_s), 8),
    _Column("x mm", _position(0)),
    _Column("y mm", _position(1)),
    _Column("z mm", _position(2)),
    _Column("heading°", _with_pose(lambda row: _decimals(row.heading_deg, 1)), 7),
    _Column("tilt°", _with_pose(lambda row: _decimals(row.tilt_deg, 1)), 4),
    _Column("mm/s", lambda row: _told(row.speed_mm_s), 6, only_if=lambda row: row.speed_mm_s is not None),
    _Column("°/s", lambda row: _told(row.turning_deg_s), 5, only_if=lambda row: row.turning_deg_s is not None),
    _Column("surface", lambda row: row.surface, 5, number=False, only_if=lambda row: bool(row.surface)),
    _Column("LEDs", _with_pose(lambda row: str(row.leds)), 2),
    _Column("rms px", _with_pose(lambda row: _decimals(row.rms_px, 3)), 1),
    _Column("Hz", _with_pose(lambda row: f"{row.rate_hz:.0f}"), 3),
)


def table(rows: Sequence[Row], width: int) -> list[Text]:
    """Heading and rows in at most ``width`` cells, as far as names and positions have room there."""
    columns = [*([_CAMERA] if len({row.camera for row in rows}) > 1 else []), *_COLUMNS]
    columns = [column for column in columns if column.only_if is None or any(map(column.only_if, rows))]
    shown = list(rows)
    if _needed(columns, shown) > width:
        shown = [_shortened(row) for row in rows]
    while (needed := _needed(columns, shown)) > width and any(column.rank for column in columns):
        columns.remove(min((column for column in columns if column.rank), key=lambda column: column.rank))
    widths = _widths(columns, shown)
    heading = Text(
        (" " * GAP).join(_padded(c.title, w, c.number) for c, w in zip(columns, widths, strict=True)).rstrip()
    )
    heading.stylize("bold")
    return [heading, *(line for row in shown for line in _lines(row, columns, widths, max(width, needed)))]


def _widths(columns: Sequence[_Column], rows: Sequence[Row]) -> list[int]:
    return [max(cell_len(text) for text in (column.title, *map(column.cell, rows))) for column in columns]


def _needed(columns: Sequence[_Column], rows: Sequence[Row]) -> int:
    return sum(_widths(columns, rows)) + GAP * (len(columns) - 1)


def _lines(row: Row, columns: Sequence[_Column], widths: Sequence[int], width: int) -> list[Text]:
    """A robot's line; where it has no pose, the reason stands in the place of the numbers."""
    line = Text()
    for column, cells in zip(columns, widths, strict=True):
        if row.position_mm is None and column.title == "x mm":
            break
        line.append(_padded(column.cell(row), cells, column.number) + " " * GAP, _style(row, column))
    if row.position_mm is not None or not row.reason:
        line.rstrip()
        return [line]
    indent = line.cell_len if width - line.cell_len >= REASON_CELLS else GAP
    parts = textwrap.wrap(row.reason, max(width - indent, REASON_CELLS)) or [""]
    lines = [line.append(parts.pop(0))] if indent > GAP else [line]
    lines += [Text(" " * indent + part) for part in parts]
    for each in lines:
        each.rstrip()
    return lines


def _style(row: Row, column: _Column) -> str:
    if column.title == "surface":
        return "" if row.surface == ON else "yellow"
    return STYLES.get(_long(row.state), "red") if column.title == "state" else ""


def _long(state: str) -> str:
    return next((long for long, short in SHORT_STATES.items() if short == state), state)


def _shortened(row: Row) -> Row:
    return replace(
        row,
        camera=shorten(row.camera, NAME_CELLS),
        robot=shorten(row.robot, NAME_CELLS),
        state=SHORT_STATES.get(row.state, row.state),
    )


def _padded(text: str, cells: int, right: bool) -> str:
    space = " " * (cells - cell_len(text))
    return space + text if right else text + space


def _decimals(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if abs(value) < 1e7 else f"{value:.1e}"


def _age(age_s: float | None) -> str:
    if age_s is None:
        return "-"
    if age_s < 1.0:
        return f"{1e3 * age_s:.0f} ms"
    return f"{age_s:.0f} s" if age_s < 600.0 else f"{age_s / 60:.0f} min"


def shorten(text: str, cells: int) -> str:
    """A name in at most ``cells`` characters, its middle left out: what tells names apart is often at their ends."""
    if len(text) <= cells:
        return text
    return f"{text[: (cells - 1) // 2]}…{text[-(cells // 2) :]}"


def joined(parts: Sequence[str], width: int) -> str:
    """Parts of a sentence, with commas; a line ends between parts, never within one."""
    lines = [parts[0]]
    for part in parts[1:]:
        lines[-1] += ","
        if len(lines[-1]) + 1 + len(part) < width:
            lines[-1] += f" {part}"
        else:
            lines.append(f"  {part}")
    return "\n".join(lines)


def printable(text: str) -> str:
    """Text from the network without what would steer a terminal: control, invisible and direction characters."""
    return "".join(char if char.isprintable() else "?" for char in text)
