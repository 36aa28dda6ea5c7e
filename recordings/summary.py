"""What stands at an MCAP file's end: schemas, channels, statistics and where everything is."""

import struct
import zlib
from collections import defaultdict
from dataclasses import dataclass, field

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    DataEnd,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from asterism.recordings.chunk_places import ChunkPlaces
from asterism.recordings.records import MAGIC


@dataclass(slots=True)
class Contents:
    """What a file holds, as its summary tells it."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))  # messages by channel
    chunks: ChunkPlaces = field(default_factory=ChunkPlaces)
    metadata: list[MetadataIndex] = field(default_factory=list)

    @property
    def messages(self) -> int:
        """How many messages there are."""
        return sum(self.counts.values())

    def statistics(self) -> Statistics:
        """In numbers."""
        first, last = self.chunks.span_ns
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=self.messages,
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )

    def groups(self) -> list[tuple[Opcode, list[McapRecord | ChunkPlaces]]]:
        """The summary's records, in their order."""
        return [
            (Opcode.SCHEMA, list(self.schemas.values())),
            (Opcode.CHANNEL, list(self.channels.values())),
            (Opcode.STATISTICS, [self.statistics()]),
            (Opcode.CHUNK_INDEX, [self.chunks] if self.chunks else []),
            (Opcode.METADATA_INDEX, list(self.metadata)),
        ]

    def ending(self, at: int) -> bytes:
        """Everything from the end of the data, which is ``at``, to the end of the file."""
        data = RecordBuilder()
        DataEnd(0).write(data)
        behind = data.end()
        summary_start = at + len(behind)
        summary = RecordBuilder()
        offsets: list[SummaryOffset] = []
        for opcode, records in self.groups():
            before = summary.count
            for record in records:
                record.write(summary)
            if records:
                offsets.append(SummaryOffset(opcode, summary_start + before, summary.count - before))
        offset_start = summary_start + summary.count
        for offset in offsets:
            offset.write(summary)
        written: bytes = summary.end()
        footer = RecordBuilder()
        Footer(summary_start, offset_start, summary_crc(written, summary_start, offset_start)).write(footer)
        ending: bytes = behind + written + footer.end() + MAGIC
        return ending


def summary_crc(summary: bytes, summary_start: int, offset_start: int) -> int:
    """The footer's check sum: of the summary, and of the footer up to it."""
    return zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start), zlib.crc32(summary))
