"""Whether the index at a file's end is there, sound, and that of the file."""

import os
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Statistics

from asterism.recordings.records import HEAD, MAGIC, Cursor, Damaged, records_in
from asterism.recordings.summary import Contents, summary_crc

MOST_BYTES = 64 << 20
_FOOTER_BYTES = HEAD.size + 20 + len(MAGIC)
_DATA_END_BYTES = HEAD.size + 4
_INDEX_HEAD_BYTES, _INDEX_ENTRY_BYTES = 2 + 4, 8 + 8  # of a record that tells where a channel's messages are


class Summary(NamedTuple):
    """The records at a file's end: where each begins in the file, its opcode and body."""

    start: int
    offset_start: int
    records: list[tuple[int, int, memoryview]]


class ChunkPlace(NamedTuple):
    """A chunk as the index tells it."""

    first_ns: int
    last_ns: int
    offset: int
    length: int


def read_at(file: BinaryIO, at: int, length: int) -> bytes:
    """So many bytes, or those up to the file's end."""
    file.seek(at)
    return file.read(length)


def read_summary(file: BinaryIO, begins: int | None = None) -> Summary:
    """Raises Damaged where a file has none that is sound; it ``begins`` elsewhere where the file has lost data."""
    size = file.seek(0, os.SEEK_END)
    cursor = Cursor(read_at(file, max(size - _FOOTER_BYTES, 0), _FOOTER_BYTES))
    head = HEAD.unpack(cursor.take(HEAD.size))
    start, offset_start, crc = cursor.u64(), cursor.u64(), cursor.u32()
    if head != (Opcode.FOOTER, 20) or cursor.take(len(MAGIC)) != MAGIC:
        raise Damaged("it does not end as a finished file does")
    where = start if begins is None else begins
    length = size - _FOOTER_BYTES - where
    if not len(MAGIC) <= where or not 0 <= length <= MOST_BYTES:
        raise Damaged("its index is not where it should be")
    data = read_at(file, where, length)
    if crc not in (0, summary_crc(data, start, offset_start)):
        raise Damaged("its index is damaged")
    return Summary(start, offset_start, [(where + at, opcode, body) for at, opcode, body in records_in(data)])


def chunk_places(summary: Summary) -> list[ChunkPlace]:
    """The chunks that an index knows. Raises Damaged."""
    cursors = (Cursor(body) for _, opcode, body in summary.records if opcode == Opcode.CHUNK_INDEX)
    return [ChunkPlace(cursor.u64(), cursor.u64(), cursor.u64(), cursor.u64()) for cursor in cursors]


def counted_chunks(file: BinaryIO) -> Iterator[tuple[ChunkPlace, int]]:
    """The chunks that the index knows, each with how many messages it holds, as the records behind it tell: in the
    file's order. Raises Damaged; reads little of each.
    """
    for place in sorted(chunk_places(read_summary(file)), key=lambda place: place.offset):
        at, count = place.offset + place.length, 0
        while True:
            head = read_at(file, at, HEAD.size + _INDEX_HEAD_BYTES)
            if len(head) < HEAD.size + _INDEX_HEAD_BYTES or head[0] != Opcode.MESSAGE_INDEX:
                break
            cursor = Cursor(head[HEAD.size :])
            cursor.u16()
            count += cursor.u32() // _INDEX_ENTRY_BYTES
            at += HEAD.size + HEAD.unpack_from(head)[1]
        yield place, count


def told_spans(file: BinaryIO, data_end: int) -> list[tuple[int, int]]:
    """First and last times of the chunks that the index behind the data knows; empty where it is not sound."""
    try:
        summary = read_summary(file, data_end + _DATA_END_BYTES)
        return [(place.first_ns, place.last_ns) for place in chunk_places(summary) if place.first_ns]
    except Damaged:
        return []


def check_index(file: BinaryIO) -> Statistics:
    """The file's statistics, once its index leads to chunks. Raises Damaged; reads little, however long the file."""
    summary = read_summary(file)
    for place in chunk_places(summary):
        head = read_at(file, place.offset, HEAD.size) if place.offset < summary.start else b""
        if len(head) < HEAD.size or HEAD.unpack(head) != (Opcode.CHUNK, place.length - HEAD.size):
            raise Damaged("its index leads to no chunk")
    bodies = [body for _, opcode, body in summary.records if opcode == Opcode.STATISTICS]
    return _statistics(bodies[0]) if bodies else Contents().statistics()


def _statistics(body: memoryview) -> Statistics:
    """Without the counts by channel."""
    cursor = Cursor(body)
    return Statistics(
        message_count=cursor.u64(),
        schema_count=cursor.u16(),
        channel_count=cursor.u32(),
        attachment_count=cursor.u32(),
        metadata_count=cursor.u32(),
        chunk_count=cursor.u32(),
        message_start_time=cursor.u64(),
        message_end_time=cursor.u64(),
        channel_message_counts={},
    )


def ending_is_right(file: BinaryIO, data_end: int, contents: Contents) -> bool:
    """Whether what stands behind the data is an index of exactly these contents."""
    try:
        summary = read_summary(file)
    except Damaged:
        return False
    behind = read_at(file, data_end, _DATA_END_BYTES)
    if behind != HEAD.pack(Opcode.DATA_END, 4) + bytes(4) or summary.start != data_end + _DATA_END_BYTES:
        return False
    expected = _records(contents)
    told = [(opcode, bytes(body)) for _, opcode, body in summary.records if opcode != Opcode.SUMMARY_OFFSET]
    return sorted(told) == sorted(expected) and _offsets_are_right(summary)


def _records(contents: Contents) -> list[tuple[int, bytes]]:
    """Opcode and body of everything that a summary of these contents tells."""
    builder = RecordBuilder()
    for _, group in contents.groups():
        for written in group:
            written.write(builder)
    text, at, found = builder.end(), 0, []
    while at < len(text):
        opcode, length = HEAD.unpack_from(text, at)
        found.append((opcode, text[at + HEAD.size : at + HEAD.size + length]))
        at += HEAD.size + length
    return found


def _offsets_are_right(summary: Summary) -> bool:
    """Whether each offset leads to the first record of its group, and tells how long the group is."""
    places: dict[int, tuple[int, int]] = {}
    for at, opcode, body in summary.records:
        first, length = places.get(opcode, (at, 0))
        places[opcode] = first, length + HEAD.size + len(body)
    if places.get(Opcode.SUMMARY_OFFSET, (0, 0))[0] != summary.offset_start:
        return False
    for _, opcode, body in summary.records:
        if opcode == Opcode.SUMMARY_OFFSET:
            cursor = Cursor(body)
            group, start, length = cursor.take(1)[0], cursor.u64(), cursor.u64()
            if length and places.get(group) != (start, length):
                return False
    return True
