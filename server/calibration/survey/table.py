"""A table that a person made in a spreadsheet: CSV with named columns, as programs of several countries write it.

Cells are parted by commas, semicolons or tabs, as the header tells; decimals have a point, or beside semicolons and
tabs a comma, one of them in the whole file. A byte order mark and Excel's `sep=` line are passed over.
"""

import csv
import io
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.text_file import read_text
from asterism.protocol.yaml_file import shortened

EXPECTED = "a spreadsheet's CSV with named columns"
SAVED_AS = f"{EXPECTED} (in Excel: save as 'CSV UTF-8')"
LONGEST = 256 << 20  # bytes
MOST_COLUMNS = 1000
_PARTED_BY = (";", "\t", ",")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d{1,3})?", re.ASCII)


@dataclass(frozen=True, slots=True)
class Cells:
    """One row: its line in the file, and what stands in it by the column's name, without spaces around."""

    line: int
    values: dict[str, str]


@dataclass(slots=True)
class Table:
    """A table in the making: names of columns as `plain_name` gives them."""

    path: Path
    columns: list[str]
    delimiter: str
    rows: Iterator[Cells]
    _mark: tuple[str, int] | None = field(default=None)  # of decimals, and the line that told it

    def error(self, row: Cells | None, column: str | None, text: str) -> InputError:
        """An InputError that names file, line and column."""
        line = f"line {row.line}" if row is not None else ""
        named = f"column {shortened(column)!r}" if column is not None else ""
        where = ", ".join(filter(None, (line, named)))
        return InputError(f"{self.path}: {where}: {text}" if where else f"{self.path}: {text}")

    def number(self, row: Cells, column: str) -> str:
        """The number in a cell, as text with a point. Raises InputError where it is none, or its decimals have another
        mark than those of lines before.
        """
        text = row.values[column]
        if not _NUMBER.fullmatch(text):
            raise self.error(row, column, f"{shortened(text)!r}, expected a number such as 12.5")
        mark = next((mark for mark in ".," if mark in text), None)
        if mark == "," and self.delimiter == ",":
            raise self.error(
                row, column, f"{shortened(text)!r} in a file whose cells are parted by commas, expected 12.5"
            )
        if mark is not None and self._mark is None:
            self._mark = mark, row.line
        if mark is not None and self._mark is not None and mark != self._mark[0]:
            raise self.error(
                row,
                column,
                f"{shortened(text)!r}, but line {self._mark[1]} has decimals behind a {self._mark[0]!r}, expected one "
                "mark in the whole file, and none for thousands",
            )
        return text.replace(",", ".")


def plain_name(name: str) -> str:
    """A column's name as it is meant: `X [mm]`, `x (mm)` and `x_mm` are the same."""
    return re.sub(r"[\s_()\[\]]+", "_", name.strip().lower().replace("°", "deg")).strip("_")


def open_table(path: Path, known: Collection[str]) -> Table:
    """The table in a file. What parts its cells is what gives the header the most of the ``known`` names.

    Raises InputError for what is no text, has no header, names a column twice; its rows raise it as they are read.
    """
    text = read_text(path, SAVED_AS, LONGEST).removeprefix("\ufeff")
    skipped = 0
    if re.match(r"sep=[;,\t]\r?\n", text):
        text, skipped = text[text.index("\n") + 1 :], 1
    headers = {mark: _header(text, mark) for mark in _PARTED_BY}
    delimiter = max(_PARTED_BY, key=lambda mark: sum(name in known for name in headers[mark]))
    columns = headers[delimiter]
    table = Table(path, columns, delimiter, iter(()))
    if not any(name in known for name in columns):
        found = ", ".join([name for name in columns if name][:3])
        raise table.error(
            None, None, f"its first line names no known column ({shortened(found)!r}), expected {EXPECTED}"
        )
    if len(columns) > MOST_COLUMNS:
        raise table.error(None, None, f"{len(columns)} columns, expected at most {MOST_COLUMNS}")
    if twice := [name for name in columns if name and columns.count(name) > 1]:
        raise table.error(None, twice[0], "is there twice, expected once")
    table.rows = _rows(table, text, skipped)
    return table


def _header(text: str, delimiter: str) -> list[str]:
    """The names in the first line that holds something."""
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        return next(([plain_name(cell) for cell in row] for row in reader if any(map(str.strip, row))), [])
    except csv.Error:
        return []


def _rows(table: Table, text: str, skipped: int) -> Iterator[Cells]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=table.delimiter, strict=True)
    headed = False
    while True:
        try:
            row = [cell.strip() for cell in next(reader)]
        except StopIteration:
            return
        except csv.Error as error:
            raise InputError(
                f"{table.path}: line {reader.line_num + skipped}: {_told(error)}, expected {EXPECTED}"
            ) from None
        cells = Cells(reader.line_num + skipped, {})
        if not any(row):
            continue  # spreadsheets leave empty rows behind
        if not headed:
            headed = True
            continue
        if len(row) < len(table.columns) or any(row[len(table.columns) :]):
            raise table.error(cells, None, f"{len(row)} cells, expected {len(table.columns)} as in the header")
        cells.values.update(zip(table.columns, row, strict=False))
        yield cells


def _told(error: csv.Error) -> str:
    """It may quote what parts the cells."""
    return str(error).replace("\t", "tab")
