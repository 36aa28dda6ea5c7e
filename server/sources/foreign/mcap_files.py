"""MCAP files that any program wrote: their topics and messages, read within bounds of memory."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from asterism.protocol.errors import InputError
from asterism.recordings.records import (
    MAGIC,
    Cursor,
    Damaged,
    Told,
    read_channel,
    read_message,
    read_schema,
)
from asterism.recordings.summary_check import read_at, read_summary
from asterism.recordings.walk import Gap, Part, opened, walk
from asterism.server.sources.foreign.topics import Topic, ros2_name

_COUNTS_AT = 8 + 2 + 4 * 4 + 2 * 8  # in a statistics record, behind its other numbers


class McapFiles:
    """One MCAP file, or several that follow each other. Raises InputError for what is none, or was cut off."""

    def __init__(self, name: str, paths: Sequence[Path]) -> None:
        self.name = name
        self._paths = paths
        self._topics = _merged([topic for path in paths for topic in _topics_of(path)])

    def topics(self) -> list[Topic]:
        """All topics."""
        return self._topics

    def messages(self, topic: Topic) -> Iterator[tuple[int, memoryview]]:
        """Log times, ns, and payloads of a topic's messages, in the files' order."""
        for path in self._paths:
            known = _Known()
            for message in known.messages(_parts(path)):
                channel = known.channels.get(message.channel)
                if channel is None:
                    raise InputError(f"{path}: is damaged (a message without its channel)")
                if known.topic_of(channel)[:3] == topic[:3]:
                    yield message.log_ns, message.data


class _Known:
    """Schemas and channels, as far as a file has told them."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}

    def topic_of(self, channel: Channel, count: int | None = None) -> Topic:
        """What a channel carries."""
        schema = self.schemas.get(channel.schema_id)
        kind = "" if schema is None else ros2_name(schema.name)
        return Topic(channel.topic, kind, channel.message_encoding, count)

    def learn(self, opcode: int, body: memoryview) -> None:
        """From a record outside of a chunk. Raises Damaged."""
        if opcode == Opcode.SCHEMA:
            schema = read_schema(body)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = read_channel(body)
            self.channels[channel.id] = channel

    def messages(self, parts: Iterator[Part]) -> Iterator[Told]:
        """Every message, once what was told before it is known."""
        for part in parts:
            if part.unpacked is not None:
                self.schemas |= part.unpacked.schemas
                self.channels |= part.unpacked.channels
                yield from part.unpacked.messages
            elif part.opcode == Opcode.MESSAGE:
                yield read_message(part.body)
            else:
                self.learn(part.opcode, part.body)


def _parts(path: Path) -> Iterator[Part]:
    """The records of a file up to the end of its data. Raises InputError where it is damaged."""
    with opened(path) as stream:
        for part in walk(stream):
            if isinstance(part, Gap) or part.amiss:
                why = part.why if isinstance(part, Gap) else "a chunk's head"
                raise InputError(f"{path}: is damaged at byte {part.offset} ({why}); {_mend(path)}")
            if part.opcode == Opcode.DATA_END:
                return
            yield part


def _topics_of(path: Path) -> list[Topic]:
    """From the summary at its end; a file that has none is read whole."""
    with opened(path) as stream:
        if read_at(stream, 0, len(MAGIC)) != MAGIC:
            raise InputError(f"{path}: is no MCAP file")
        try:
            found = _summed_up(stream)
        except Damaged:
            size = stream.seek(0, os.SEEK_END)
            if size < 2 * len(MAGIC) or read_at(stream, size - len(MAGIC), len(MAGIC)) != MAGIC:
                raise InputError(f"{path}: was cut off (its recorder was killed?); {_mend(path)}") from None
            found = []
    return found or _counted(path)


def _summed_up(stream: BinaryIO) -> list[Topic]:
    """What the summary tells. Raises Damaged."""
    known, counts = _Known(), dict[int, int]()
    for _, opcode, body in read_summary(stream).records:
        known.learn(opcode, body)
        if opcode == Opcode.STATISTICS:
            cursor = Cursor(body)
            cursor.take(_COUNTS_AT)
            told = Cursor(cursor.take(cursor.u32()))
            while told.left:
                number = told.u16()
                counts[number] = told.u64()
    return [known.topic_of(channel, counts.get(number)) for number, channel in known.channels.items()]


def _counted(path: Path) -> list[Topic]:
    """What the file itself holds."""
    known, counts = _Known(), dict[int, int]()
    for message in known.messages(_parts(path)):
        counts[message.channel] = counts.get(message.channel, 0) + 1
    return [known.topic_of(channel, counts.get(number, 0)) for number, channel in known.channels.items()]


def _merged(topics: list[Topic]) -> list[Topic]:
    """Every topic once, its messages in all channels and files counted together."""
    counts: dict[tuple[str, str, str], int | None] = {}
    for topic in topics:
        before = counts.get(topic[:3], 0)
        counts[topic[:3]] = None if before is None or topic.held is None else before + topic.held
    return [Topic(*key, count) for key, count in counts.items()]


def _mend(path: Path) -> str:
    return f"`mcap recover {path.name} -o whole.mcap`, of MCAP's own tools, keeps what is whole"
