"""The index at the end of an MCAP file, rebuilt in place: after a crash, or on a full disk.

A file whose writer died ends in the middle of a record. What is whole is kept, the broken tail is cut off, and the
summary that readers look for is appended. Nothing is rewritten, so it takes no second copy of the file.
MCAP format: https://mcap.dev/spec.
"""

import os
import struct
import zlib
from collections import defaultdict
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import breakup_chunk

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # opcode, length
_MESSAGE_HEAD = 22  # channel, sequence, both times


@dataclass(slots=True)
class Rebuilt:
    """What `rebuild_index` found: messages kept, bytes cut off the end, chunks that were unreadable."""

    messages: int
    cut_bytes: int
    damaged_chunks: int
    first_ns: int
    last_ns: int


@dataclass(slots=True)
class _Found:
    """What a walk over the file's records found."""

    end: int = len(MAGIC)  # behind the last whole record
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    damaged: int = 0
    # Message indexes that the last chunk still lacks.
    missing: list[MessageIndex] = field(default_factory=list)


def is_complete(path: Path) -> bool:
    """Whether the file ends as a finished MCAP file does."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        if size < 2 * len(MAGIC):
            return False
        file.seek(size - len(MAGIC))
        return file.read() == MAGIC


def begins_as_mcap(path: Path) -> bool:
    """Whether the file begins as an MCAP file does."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def rebuild_index(path: Path) -> Rebuilt:
    """Cut the broken tail off an unfinished MCAP file and append its index, in place.

    Raises OSError when the file cannot be written; what was readable stays readable then.
    """
    with path.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        found = _walk(file, size)
        file.truncate(found.end)
        file.seek(found.end)
        file.write(_ending(found))
    times = [(chunk.message_start_time, chunk.message_end_time) for chunk in found.chunks]
    return Rebuilt(
        messages=sum(found.counts.values()),
        cut_bytes=size - found.end,
        damaged_chunks=found.damaged,
        first_ns=min((start for start, _ in times), default=0),
        last_ns=max((end for _, end in times), default=0),
    )


def _walk(file: BinaryIO, size: int) -> _Found:
    """Read every whole record up to the first broken one, or the end of the data section."""
    found = _Found()
    file.seek(len(MAGIC))
    while True:
        start = file.tell()
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            break
        opcode, length = _HEAD.unpack(head)
        if opcode == 0 or start + _HEAD.size + length > size:
            break
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            break  # what follows is a summary that was not finished
        body = file.read(length)
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            _chunk(found, stream, start, _HEAD.size + length)
        elif opcode == Opcode.MESSAGE_INDEX:
            _message_index(found, stream, start, _HEAD.size + length)
        elif opcode == Opcode.METADATA:
            name = Metadata.read(stream).name
            found.metadata.append(MetadataIndex(offset=start, length=_HEAD.size + length, name=name))
        found.end = file.tell()
    return found


def _chunk(found: _Found, stream: ReadDataStream, start: int, length: int) -> None:
    chunk = Chunk.read(stream)
    found.missing = []
    try:
        records = breakup_chunk(chunk, validate_crc=True)
    except (McapError, ValueError, RuntimeError, struct.error):
        found.damaged += 1
        return
    indexes: dict[int, list[tuple[int, int]]] = defaultdict(list)
    offset = 0
    for record in records:
        if isinstance(record, Message):
            found.counts[record.channel_id] += 1
            indexes[record.channel_id].append((record.log_time, offset))
            offset += _HEAD.size + _MESSAGE_HEAD + len(record.data)
            continue
        if isinstance(record, Schema):
            found.schemas[record.id] = record
        elif isinstance(record, Channel):
            found.channels[record.id] = record
        builder = RecordBuilder()
        record.write(builder)
        offset += builder.count
    found.chunks.append(
        ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
    )
    found.missing = [MessageIndex(channel_id=channel, records=records) for channel, records in indexes.items()]


def _message_index(found: _Found, stream: ReadDataStream, start: int, length: int) -> None:
    index = MessageIndex.read(stream)
    if not any(missing.channel_id == index.channel_id for missing in found.missing):
        return
    chunk = found.chunks[-1]
    chunk.message_index_offsets[index.channel_id] = start
    chunk.message_index_length += length
    found.missing = [missing for missing in found.missing if missing.channel_id != index.channel_id]


def _ending(found: _Found) -> bytes:
    """Everything from behind the last whole record to the end of the file."""
    data = RecordBuilder()
    for index in found.missing:
        chunk = found.chunks[-1]
        before = data.count
        chunk.message_index_offsets[index.channel_id] = found.end + before
        index.write(data)
        chunk.message_index_length += data.count - before
    DataEnd(0).write(data)
    behind = data.end()
    summary_start = found.end + len(behind)
    summary = RecordBuilder()
    offsets: list[SummaryOffset] = []
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(found.channels),
        channel_message_counts=dict(found.counts),
        chunk_count=len(found.chunks),
        message_count=sum(found.counts.values()),
        message_end_time=max((chunk.message_end_time for chunk in found.chunks), default=0),
        message_start_time=min((chunk.message_start_time for chunk in found.chunks), default=0),
        metadata_count=len(found.metadata),
        schema_count=len(found.schemas),
    )
    groups = (
        (Opcode.SCHEMA, list(found.schemas.values())),
        (Opcode.CHANNEL, list(found.channels.values())),
        (Opcode.STATISTICS, [statistics]),
        (Opcode.CHUNK_INDEX, found.chunks),
        (Opcode.METADATA_INDEX, found.metadata),
    )
    for opcode, records in groups:
        before = summary.count
        for record in records:
            record.write(summary)
        if records:
            offsets.append(
                SummaryOffset(
                    group_opcode=opcode,
                    group_start=summary_start + before,
                    group_length=summary.count - before,
                )
            )
    summary_offset_start = summary_start + summary.count
    for offset in offsets:
        offset.write(summary)
    written = summary.end()
    crc = zlib.crc32(written)
    crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, summary_offset_start), crc)
    footer = RecordBuilder()
    Footer(summary_offset_start=summary_offset_start, summary_start=summary_start, summary_crc=crc).write(footer)
    ending: bytes = behind + written + footer.end() + MAGIC
    return ending
