"""The chunks of a finished file one by one, in any order, as bytes: for programs that read an hour in seconds."""

from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode

from asterism.protocol.errors import InputError
from asterism.protocol.program import typed
from asterism.recordings.chunks import Chunk
from asterism.recordings.records import HEAD, Buffer, Damaged, read_channel, read_schema
from asterism.recordings.summary_check import ChunkPlace, chunk_places, read_at, read_summary
from asterism.recordings.walk import opened


class Indexed(NamedTuple):
    """A file by its index: its chunks in their order, and the schemas' names of its channels, by their numbers."""

    path: Path
    chunks: list[ChunkPlace]
    channels: dict[int, str]

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last time of its messages; None where there is none that has one. Films count from 0."""
        spans = [chunk for chunk in self.chunks if chunk.last_ns]
        if not spans:
            return None
        return min(chunk.first_ns for chunk in spans), max(chunk.last_ns for chunk in spans)


def indexed(path: Path) -> Indexed:
    """A file of a recording. Raises InputError where its index is damaged."""
    with opened(path) as stream:
        try:
            summary = read_summary(stream)
            chunks = sorted(chunk_places(summary), key=lambda chunk: chunk.offset)
            schemas, channels = {}, []
            for _, opcode, body in summary.records:
                if opcode == Opcode.SCHEMA:
                    schema = read_schema(body)
                    schemas[schema.id] = schema.name
                elif opcode == Opcode.CHANNEL:
                    channels.append(read_channel(body))
        except Damaged as damage:
            raise _damaged(path, damage) from None
    return Indexed(path, chunks, {channel.id: schemas.get(channel.schema_id, "") for channel in channels})


def chunk_bytes(path: Path, place: ChunkPlace) -> Buffer:
    """A chunk's records, unpacked and checked. Raises InputError where it is damaged."""
    with opened(path) as stream:
        body = memoryview(read_at(stream, place.offset, place.length))[HEAD.size :]
    try:
        chunk = Chunk(body)
        if not chunk.consistent:
            raise Damaged("a length that is not its chunk's")
        return chunk.unpack()
    except Damaged as damage:
        raise _damaged(path, damage) from None


def _damaged(path: Path, damage: Damaged) -> InputError:
    return InputError(f"{path}: is damaged ({damage}); run this first: {typed('recover', path.parent)}")
