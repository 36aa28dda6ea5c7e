"""Parquet: one table of all robots, as pandas, polars, DuckDB and Spark read it.

Needs pyarrow, which the extra `parquet` brings.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.recordings.export.columns import Column, Value, columns, groups, row
from asterism.recordings.export.frames import ExportedFrame
from asterism.recordings.export.written import Written

if TYPE_CHECKING:
    import pyarrow as pa

ROWS = 16_384  # of a group: what is in memory at once
_TIME = "time_s"  # of CSV; here it is a timestamp


def write_parquet(frames: Iterable[ExportedFrame], path: Path, points: Mapping[str, Sequence[str]]) -> Written:
    """Write all robots into one table: a row a robot and frame, in the frames' order, the columns of CSV; instead of
    ``time_s`` there is ``time``, a timestamp in UTC to the ns. Every field's metadata hold its unit.

    Raises ModuleNotFoundError without pyarrow, OSError where the disk does not take it.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    of = groups(dict.fromkeys(name for names in points.values() for name in names))
    layout = columns(of)
    schema, written = pa.schema([_field(column) for column in layout]), Written(files=[path.name])
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        rows: list[list[Value]] = []
        for frame in written.counted(frames):
            rows += [row(of, frame, robot) for robot in frame.robots]
            if len(rows) >= ROWS:
                writer.write_table(_table(rows, layout, schema))
                rows = []
        if rows:
            writer.write_table(_table(rows, layout, schema))
    return written


def _table(rows: list[list[Value]], layout: list[Column], schema: pa.Schema) -> pa.Table:
    import pyarrow as pa

    by_column: list[Sequence[Value]] = list(zip(*rows, strict=True))
    at_ns = by_column[[column.name for column in layout].index("exposed_ns")]
    arrays = [
        pa.array(at_ns if column.name == _TIME else values, type=field.type)
        for column, values, field in zip(layout, by_column, schema, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _field(column: Column) -> pa.Field:
    import pyarrow as pa

    if column.name == _TIME:
        return pa.field("time", pa.timestamp("ns", tz="UTC"))
    kinds = {
        "text": pa.string(), "integer": pa.int64(), "natural": pa.uint64(), "real": pa.float64(), "flag": pa.bool_(),
    }  # fmt: skip
    return pa.field(column.name, kinds[column.type], metadata={"unit": column.unit} if column.unit else None)
