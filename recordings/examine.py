"""What a file of a recording holds, whatever its index says, and what is wrong with it."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, MessageIndex, MetadataIndex

from asterism.recordings.chunks import Unpacked
from asterism.recordings.decodable import is_decodable
from asterism.recordings.records import (
    MAGIC,
    Cursor,
    Told,
    read_channel,
    read_message,
    read_metadata,
    read_schema,
)
from asterism.recordings.summary import Contents
from asterism.recordings.summary_check import ending_is_right, told_spans
from asterism.recordings.told import METADATA, is_sound
from asterism.recordings.walk import Gap, Part, opened, walk

Span = tuple[int, int]


@dataclass(slots=True)
class Examined:
    """``contents`` are those that are whole; ``data_end`` is where they end.

    ``faults`` cannot be mended where they are; without one, a file whose ``ending_right`` is false lacks no more than
    its index. ``holes`` counts, by the number of whole chunks before it, what is missing.
    """

    path: Path
    size: int
    contents: Contents = field(default_factory=Contents)
    texts: dict[str, dict[str, str]] = field(default_factory=dict)  # metadata by name
    data_end: int = len(MAGIC)
    ending_right: bool = False
    faults: list[str] = field(default_factory=list)
    cut_bytes: int = 0
    missing: list[MessageIndex] = field(default_factory=list)  # of the last chunk
    spans: list[Span] = field(default_factory=list)  # first and last time of every whole chunk
    holes: set[int] = field(default_factory=set)
    told: Span | None = None  # first and last time by the file's own index, where that is sound
    spare: Unpacked = field(default_factory=Unpacked)  # channels and schemas that only the index has

    @property
    def is_whole(self) -> bool:
        """Whether nothing is to be done."""
        return self.ending_right and not self.faults and not self.cut_bytes

    def fault(self, why: str) -> None:
        """One more, each kind once."""
        if why not in self.faults:
            self.faults.append(why)


def examine(path: Path) -> Examined:
    """Read a file from front to back. Raises InputError where it is no file, or a link."""
    with opened(path, follow=False) as file:
        return _Examination(path, file).run()


def whole_chunks(file: BinaryIO) -> Iterator[Unpacked]:
    """The contents of every whole chunk that is not there twice; messages outside of chunks come as chunks of one."""
    seen: set[tuple[int, ...]] = set()
    for part in walk(file):
        if isinstance(part, Gap):
            continue
        if part.opcode == Opcode.MESSAGE:
            yield Unpacked(messages=[_loose(part)])
        elif part.unpacked is not None and not _repeated(part, seen):
            yield part.unpacked


def _loose(part: Part) -> Told:
    return read_message(part.body)


def _described(part: Part) -> Unpacked:
    if part.opcode == Opcode.SCHEMA:
        schema = read_schema(part.body)
        return Unpacked(schemas={schema.id: schema})
    channel = read_channel(part.body)
    return Unpacked(channels={channel.id: channel})


def _repeated(part: Part, seen: set[tuple[int, ...]]) -> bool:
    chunk, unpacked = part.chunk, part.unpacked
    if chunk is None or unpacked is None or not unpacked.messages:
        return False
    if chunk.print in seen:
        return True
    seen.add(chunk.print)
    return False


class _Examination:
    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._file = file
        self._found = Examined(path, file.seek(0, 2))
        self._seen: set[tuple[int, ...]] = set()
        self._ended = False  # the end of the data was read

    def run(self) -> Examined:
        found = self._found
        for part in walk(self._file):
            if isinstance(part, Gap):
                self._gap(part)
            elif part.opcode == Opcode.CHUNK and part.unpacked is not None:
                self._chunk(part, part.unpacked)
            elif part.opcode == Opcode.MESSAGE_INDEX:
                self._message_index(part)
            elif self._ended:
                self._behind(part)
            else:
                self._other(part)
            if not self._ended and not isinstance(part, Gap):
                found.data_end = part.offset + part.length
        if not found.faults and not found.cut_bytes and self._ended:
            found.ending_right = not found.missing and ending_is_right(self._file, found.data_end, found.contents)
        self._compare_with_index()
        return found

    def _gap(self, gap: Gap) -> None:
        found = self._found
        if self._ended:
            return  # damage in the index, which is written anew
        found.holes.add(len(found.spans))
        if gap.cut:
            found.cut_bytes = gap.length
        else:
            found.fault(gap.why)

    def _chunk(self, part: Part, unpacked: Unpacked) -> None:
        found, contents, chunk = self._found, self._found.contents, part.chunk
        assert chunk is not None
        if self._ended:
            found.fault("data behind its end")
        if found.missing:
            found.fault("an index of messages that is not its chunk's")
        if part.amiss:
            found.fault("a length that is not its chunk's")
        if _repeated(part, self._seen):
            found.fault("a chunk that is there twice")
            return
        self._describe(unpacked)
        if not unpacked.messages:
            return
        index: dict[int, list[Span]] = defaultdict(list)
        for message in unpacked.messages:
            index[message.channel].append((message.log_ns, message.at))
            self._look(message)
        times = [message.log_ns for message in unpacked.messages]
        span = (min(times), max(times))
        if (chunk.first_ns, chunk.last_ns) != span:
            found.fault("times that are not its chunk's")
        found.spans.append(span)
        for channel, entries in index.items():
            contents.counts[channel] += len(entries)
        found.missing = [MessageIndex(channel_id=channel, records=entries) for channel, entries in index.items()]
        contents.chunks.append(
            ChunkIndex(
                chunk_length=part.length,
                chunk_start_offset=part.offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=span[1],
                message_index_length=0,
                message_index_offsets={},
                message_start_time=span[0],
                uncompressed_size=chunk.size,
            )
        )

    def _describe(self, unpacked: Unpacked) -> None:
        found, contents = self._found, self._found.contents
        for known, told in ((contents.schemas, unpacked.schemas), (contents.channels, unpacked.channels)):
            for number, record in told.items():
                if known.setdefault(number, record) != record:
                    found.fault("two channels of one number")

    def _look(self, message: Told) -> None:
        """Whether a message has its channel and can be decoded."""
        contents, found = self._found.contents, self._found
        channel = contents.channels.get(message.channel)
        schema = None if channel is None else contents.schemas.get(channel.schema_id)
        if channel is None or schema is None:
            found.fault("messages without their channel")
        elif not is_decodable(schema.name, message.data):
            found.fault("messages that cannot be decoded")

    def _message_index(self, part: Part) -> None:
        found, cursor = self._found, Cursor(part.body)
        channel = cursor.u16()
        cursor.u32()
        entries = sorted((cursor.u64(), cursor.u64()) for _ in range(cursor.left // 16))
        if not entries or self._ended:
            return
        expected = next((index for index in found.missing if index.channel_id == channel), None)
        if expected is None or sorted(expected.records) != entries:
            found.fault("an index of messages that is not its chunk's")
            return
        found.missing.remove(expected)
        chunk = found.contents.chunks.last
        chunk.message_index_offsets[channel] = part.offset
        chunk.message_index_length += part.length

    def _other(self, part: Part) -> None:
        found, contents = self._found, self._found.contents
        if part.opcode == Opcode.DATA_END:
            self._ended = True
        elif part.opcode == Opcode.METADATA:
            told = read_metadata(part.body)
            if told.name != METADATA or is_sound(told.metadata):
                found.texts[told.name] = told.metadata
            else:
                found.fault("its metadata")
            contents.metadata.append(MetadataIndex(offset=part.offset, length=part.length, name=told.name))
        elif part.opcode == Opcode.MESSAGE:
            found.fault("messages outside of chunks")
            message = _loose(part)
            contents.counts[message.channel] += 1
            found.spans.append((message.log_ns, message.log_ns))
        elif part.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            found.fault("channels outside of chunks")
            self._describe(_described(part))
        elif part.opcode not in (Opcode.HEADER, Opcode.ATTACHMENT):
            found.fault("an index before the end of the data")
        if (part.opcode == Opcode.HEADER) != (part.offset == len(MAGIC)):
            found.fault("it does not begin as an MCAP file")

    def _behind(self, part: Part) -> None:
        if part.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            told, spare = _described(part), self._found.spare
            spare.schemas |= told.schemas
            spare.channels |= told.channels

    def _compare_with_index(self) -> None:
        """Find the chunks that the index knows and the file lacks."""
        found = self._found
        told = told_spans(self._file, found.data_end)
        if not told:
            return
        found.told = min(first for first, _ in told), max(last for _, last in told)
        there, starts = set(found.spans), [first for first, _ in found.spans]
        found.holes = {bisect_left(starts, span[0]) for span in told if span not in there}
