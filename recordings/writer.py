"""Writes one MCAP file. Every chunk carries its own schemas and channels, so that damage to one costs no other.

Large payloads are never copied: they go from where they are to the disk, or into the compression.
"""

import os
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, MessageIndex, Metadata, MetadataIndex, Schema

from asterism import __version__
from asterism.recordings.packing import Packing
from asterism.recordings.records import HEAD, MAGIC, MESSAGE_HEAD, Buffer
from asterism.recordings.summary import Contents

LIBRARY = f"asterism {__version__}"
CHUNK_BYTES = 1 << 20
_CHUNK_HEAD_BYTES = 8 + 8 + 8 + 4 + 4 + 8  # and the compression's name
_MOST_AT_ONCE = 512  # buffers of one write; POSIX allows 1024


class Output:
    """An unbuffered file that knows where its last whole records end."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self.whole = 0  # bytes on disk that end with a whole record

    def write(self, parts: Sequence[Buffer]) -> None:
        """Write whole records; on failure leave the file as it was and raise OSError."""
        left = [view for part in parts if len(view := memoryview(part))]
        total = sum(map(len, left))
        try:
            while left:
                done = os.writev(self._file, left[:_MOST_AT_ONCE])
                while left and done >= len(left[0]):
                    done -= len(left.pop(0))
                if left:
                    left[0] = left[0][done:]
        except OSError:
            os.ftruncate(self._file, self.whole)
            os.lseek(self._file, self.whole, os.SEEK_SET)
            raise
        self.whole += total

    def sync(self) -> None:
        """Bring everything to the disk itself."""
        os.fsync(self._file)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._file)


class Writer:
    """Writes messages into a new file. Not for several threads at once.

    Every method that writes raises OSError where the disk does not take it:
    the file is then as it was before, and may be finished, without the messages that are in no chunk yet.
    """

    def __init__(self, path: Path, packing: Packing) -> None:
        self.contents = Contents()
        self._packing = packing
        self._pack = packing.packer()
        self._output = Output(path)
        self._numbers: dict[str, int] = {}  # of channels, by topic
        self._begin_chunk()
        header = RecordBuilder()
        Header("", LIBRARY).write(header)
        self._output.write([MAGIC, header.end()])

    @property
    def bytes_written(self) -> int:
        """How much is on the disk by now."""
        return self._output.whole

    def channel(self, topic: str, schema: Callable[[], tuple[str, str, bytes]], metadata: dict[str, str]) -> int:
        """The number of a topic's channel; ``schema`` gives name, encoding and data where it is a new one."""
        if topic not in self._numbers:
            self.contents.channels[len(self._numbers) + 1] = Channel(
                id=len(self._numbers) + 1,
                topic=topic,
                message_encoding="protobuf",
                metadata=metadata,
                schema_id=self._schema(*schema()),
            )
            self._numbers[topic] = len(self._numbers) + 1
        return self._numbers[topic]

    def add(self, channel: int, sequence: int, times_ns: tuple[int, int], payload: Sequence[Buffer]) -> None:
        """Append a message: ``times_ns`` are log and publish time, ``payload`` its bytes in one or more pieces.

        They must not change before the chunk is written, which it is at once for large ones.
        """
        if channel not in self._index:
            self._describe(channel)
        self._index[channel].append((times_ns[0], self._bytes))
        length = MESSAGE_HEAD.size + sum(map(len, payload))
        head = HEAD.pack(Opcode.MESSAGE, length) + MESSAGE_HEAD.pack(channel, sequence & 0xFFFFFFFF, *times_ns)
        self._parts += (head, *payload)
        self._bytes += HEAD.size + length
        if self._bytes >= CHUNK_BYTES:
            self.flush()

    def metadata(self, name: str, entries: dict[str, str]) -> None:
        """Append named texts."""
        self.flush()
        record = RecordBuilder()
        Metadata(name, entries).write(record)
        offset, length = self._output.whole, record.count
        self._output.write([record.end()])
        self.contents.metadata.append(MetadataIndex(offset, length, name))

    def flush(self) -> None:
        """Bring everything added so far to the file."""
        if not self._index:
            return
        head, data = self._chunk()
        start = self._output.whole
        behind, offsets = self._message_indexes(start + len(head) + sum(map(len, data)))
        self._output.write([head, *data, behind])
        times = [time_ns for index in self._index.values() for time_ns, _ in index]
        self.contents.chunks.append(
            ChunkIndex(
                chunk_start_offset=start,
                chunk_length=len(head) + sum(map(len, data)),
                compression=self._packing.compression,
                compressed_size=sum(map(len, data)),
                uncompressed_size=self._bytes,
                message_start_time=min(times),
                message_end_time=max(times),
                message_index_offsets=offsets,
                message_index_length=len(behind),
            )
        )
        for channel, index in self._index.items():
            self.contents.counts[channel] += len(index)
        self._begin_chunk()

    def finish(self) -> None:
        """Write the summary of what is on the disk, and close; what is not yet there is left out.

        Where the disk does not take it, it can be tried again.
        """
        self._drop_undescribed()
        self._output.write([self.contents.ending(self._output.whole)])
        self._output.close()

    def sync(self) -> None:
        """Bring the file to the disk itself."""
        self._output.sync()

    def close(self) -> None:
        """Let go of a file that is not to be finished."""
        self._output.close()

    def _begin_chunk(self) -> None:
        self._parts: list[Buffer] = []
        self._bytes = 0
        self._index: dict[int, list[tuple[int, int]]] = {}  # log time and offset of every message, by channel
        self._described: set[int] = set()  # schemas that stand in the chunk

    def _schema(self, name: str, encoding: str, data: bytes) -> int:
        schemas = self.contents.schemas
        for schema in schemas.values():
            if (schema.name, schema.encoding, schema.data) == (name, encoding, data):
                return int(schema.id)
        number = len(schemas) + 1
        schemas[number] = Schema(id=number, name=name, encoding=encoding, data=data)
        return number

    def _describe(self, number: int) -> None:
        """Put channel and schema into the chunk."""
        channel, record = self.contents.channels[number], RecordBuilder()
        if channel.schema_id not in self._described:
            self._described.add(channel.schema_id)
            self.contents.schemas[channel.schema_id].write(record)
        channel.write(record)
        self._index[number] = []
        self._parts.append(record.end())
        self._bytes += len(self._parts[-1])

    def _drop_undescribed(self) -> None:
        """Forget channels and schemas that stand in no chunk: a summary tells of what is in the file."""
        contents = self.contents
        contents.channels = {n: channel for n, channel in contents.channels.items() if n in contents.counts}
        used = {channel.schema_id for channel in contents.channels.values()}
        contents.schemas = {n: schema for n, schema in contents.schemas.items() if n in used}

    def _chunk(self) -> tuple[bytes, list[Buffer]]:
        """A chunk's record up to its data, and the data."""
        crc = 0
        for part in self._parts if self._packing.crc else ():
            crc = zlib.crc32(part, crc)
        data = self._pack(self._parts)
        times = [time_ns for index in self._index.values() for time_ns, _ in index]
        name, packed = self._packing.compression.encode(), sum(map(len, data))
        head = RecordBuilder()
        head.write(HEAD.pack(Opcode.CHUNK, _CHUNK_HEAD_BYTES + len(name) + packed))
        head.write8(min(times))
        head.write8(max(times))
        head.write8(self._bytes)
        head.write4(crc)
        head.write_prefixed_string(self._packing.compression)
        head.write8(packed)
        return head.end(), data

    def _message_indexes(self, at: int) -> tuple[bytes, dict[int, int]]:
        """The records behind a chunk that ends ``at``, and where each channel's begins."""
        records, offsets = RecordBuilder(), {}
        for channel, index in self._index.items():
            offsets[channel] = at + records.count
            MessageIndex(channel_id=channel, records=index).write(records)
        return records.end(), offsets
