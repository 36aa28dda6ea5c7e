"""CSV: one file a robot, a row a frame, units in the names of the columns."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from decimal import Decimal
from pathlib import Path
from typing import Protocol

from asterism.recordings.export.columns import Group, Value, columns, groups, row
from asterism.recordings.export.frames import ExportedFrame
from asterism.recordings.export.written import Written


class _Rows(Protocol):
    def writerow(self, row: Sequence[object], /) -> object: ...


def write_csv(frames: Iterable[ExportedFrame], folder: Path, points: Mapping[str, Sequence[str]]) -> Written:
    """Write <folder>/<robot>.csv of every robot that is told of, also of those that were never located.

    ``points`` names the points of each; what else a robot carries is left out. Numbers are written so that they read
    back as the same float64. Raises OSError where the disk does not take it.
    """
    written, files = Written(), _Files(folder, points)
    with files.open:
        for frame in written.counted(frames):
            for robot in frame.robots:
                of, rows = files.of(robot.id)
                rows.writerow([_cell(value) for value in row(of, frame, robot)])
    written.files = sorted(f"{robot}.csv" for robot in files.by_robot)
    return written


class _Files:
    """The files, by robot; each is begun with its header when it is asked for."""

    def __init__(self, folder: Path, points: Mapping[str, Sequence[str]]) -> None:
        self._folder = folder
        self._points = points
        self.open = ExitStack()
        self.by_robot: dict[str, tuple[tuple[Group, ...], _Rows]] = {}

    def of(self, robot: str) -> tuple[tuple[Group, ...], _Rows]:
        """Columns and rows of a robot."""
        if robot not in self.by_robot:
            file = self.open.enter_context((self._folder / f"{robot}.csv").open("w", encoding="utf-8", newline=""))
            rows, of = csv.writer(file, lineterminator="\n"), groups(self._points.get(robot, ()))
            rows.writerow([column.name for column in columns(of)])
            self.by_robot[robot] = of, rows
        return self.by_robot[robot]


def _cell(value: Value) -> Value:
    """Numbers without an exponent: PlotJuggler takes a column for text if the first number in it has one."""
    if isinstance(value, bool):
        return str(value).lower()  # as most programs write them
    if isinstance(value, float):
        text = repr(value)
        return format(Decimal(text), "f") if "e" in text else text
    return value
