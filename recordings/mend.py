"""Mends the files of a recording: an index where it lies, all else in a new file, with the old one kept beside it.

A file that was only cut off, or whose index is not right, gets its index at its end: nothing is rewritten, it takes
no second copy. What is damaged elsewhere is written anew from every message that can be read; the old file stays as
NAME.damaged.
"""

import contextlib
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.schemas import descriptor_set
from asterism.recordings.chunks import Unpacked
from asterism.recordings.decodable import channel_of, is_decodable
from asterism.recordings.examine import Examined, examine, whole_chunks
from asterism.recordings.packing import Packing
from asterism.recordings.records import Told
from asterism.recordings.told import METADATA
from asterism.recordings.walk import opened
from asterism.recordings.writer import Writer

DAMAGED = ".damaged"
UNFINISHED = ".mending"


@dataclass(slots=True)
class Mended:
    """What became of a file: ``kept`` messages over ``seconds``; the rest are parts of a sentence."""

    name: str
    kept: int = 0
    seconds: float = 0.0
    done: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        kept = f"{self.kept} messages over {self.seconds:.2f} s"
        if not self.done:
            return f"{self.name}: {kept}, whole"
        return "; ".join([f"{self.name}: {kept} kept" if self.kept else f"{self.name}: nothing kept", *self.done])


def mend(files: list[Path]) -> list[Mended]:
    """Mend what is not whole. Nobody else may write meanwhile: `held_for_recovery`.

    Raises InputError, before anything is changed, where a file is none or a link, or where nothing can be read;
    WorldError where the disk takes no more: the file in work is then as it was.
    """
    found = [examine(file) for file in files]
    if not any(one.contents.messages or one.texts for one in found):
        names = ", ".join(one.path.name for one in found)
        raise InputError(f"{files[0].parent}: holds nothing that can be read (looked into {names})")
    texts = {name: told for one in reversed(found) for name, told in one.texts.items()}
    try:
        return [_mend(one, texts) for one in found]
    except OSError as error:
        raise WorldError(f"{error.filename or files[0].parent}: cannot be written ({error.strerror})") from None


def _mend(found: Examined, texts: dict[str, dict[str, str]]) -> Mended:
    mended = Mended(found.path.name, found.contents.messages)
    if found.spans:
        mended.seconds = (max(last for _, last in found.spans) - min(first for first, _ in found.spans)) * 1e-9
    if found.is_whole:
        return mended
    if found.size == 0:
        found.path.unlink()
        mended.done = ["it was empty and is removed"]
    elif found.faults and not found.contents.messages:
        mended.done = [f"nothing in it can be read ({found.faults[0]}); it is now {_set_aside(found.path)}"]
        found.path.unlink(missing_ok=True)
    elif found.faults:
        mended.done = [*_lost(found), *_rewrite(found, texts, mended)]
    else:
        _append_index(found)
        cut = [f"{found.cut_bytes} bytes cut off at its end"] if found.cut_bytes else []
        mended.done = [*cut, *_lost(found), "its index is written anew"]
    return mended


def _lost(found: Examined) -> list[str]:
    """What is missing, in seconds since the first message that is known of."""
    spans, told = found.spans, []
    first = min((span[0] for span in spans), default=0)
    begin = first if found.told is None else min(first, found.told[0])
    for hole in sorted(found.holes):
        before = spans[hole - 1][1] if hole > 0 else begin
        after = spans[hole][0] if hole < len(spans) else 0 if found.told is None else found.told[1]
        if after > before:
            told.append(f"{(after - before) * 1e-9:.2f} s lost from {(before - begin) * 1e-9:.2f} s on")
        elif hole >= len(spans) and found.told is None and not found.cut_bytes:
            told.append(f"what came after {(before - begin) * 1e-9:.2f} s is lost, if there was anything")
        elif hole == 0 and found.told is None:
            told.append("what came before is lost, if there was anything")
    return told


def _append_index(found: Examined) -> None:
    """Cut off what is behind the data and write the index there."""
    data = RecordBuilder()
    for index in found.missing:
        chunk = found.contents.chunks.last
        chunk.message_index_offsets[index.channel_id] = found.data_end + data.count
        before = data.count
        index.write(data)
        chunk.message_index_length += data.count - before
    behind = data.end()
    with found.path.open("r+b") as file:
        file.truncate(found.data_end)
        file.seek(found.data_end)
        file.write(behind + found.contents.ending(found.data_end + len(behind)))
        file.flush()
        os.fsync(file.fileno())


def _rewrite(found: Examined, texts: dict[str, dict[str, str]], mended: Mended) -> list[str]:
    """Write every message that can be read into a new file; the old one is kept. Returns what is to be said."""
    new = found.path.with_name(found.path.name + UNFINISHED)
    new.unlink(missing_ok=True)
    try:
        copy = _Copy(found, new, texts)
        with opened(found.path, follow=False) as file:
            copy.run(file)
    except OSError as error:
        new.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(new)) from None
    mended.kept = copy.kept
    kept_as = _set_aside(found.path)
    new.replace(found.path)
    left_out = [f"{count} {why} left out" for why, count in copy.left_out.items()]
    return [*left_out, f"written anew ({', '.join(found.faults)}); the old file is kept as {kept_as}"]


def _set_aside(path: Path) -> str:
    """Keep a file as NAME.damaged, with a number behind where there is one already; its own name is free then, or may
    be taken by another file at once.
    """
    for number in range(1, 1000):
        name = path.name + DAMAGED + (f"-{number}" if number > 1 else "")
        aside = path.with_name(name)
        if not os.path.lexists(aside):
            return _keep_as(path, aside)
    raise OSError(0, "a thousand damaged ones are kept already", str(path))


def _keep_as(path: Path, aside: Path) -> str:
    try:
        aside.hardlink_to(path)  # so that there is a file of that name at every moment
    except OSError:
        path.rename(aside)
    return aside.name


class _Copy:
    """Messages of a damaged file into a new one."""

    def __init__(self, found: Examined, new: Path, texts: dict[str, dict[str, str]]) -> None:
        usual = found.contents.chunks.compressions.most_common(1)
        self._writer = Writer(new, Packing(usual[0][0] if usual else "zstd"))
        self._found = found
        self._texts = texts
        self._camera = texts.get(METADATA, {}).get("camera", "")
        self._schemas = found.spare.schemas | found.contents.schemas
        self._channels = found.spare.channels | found.contents.channels
        self.kept = 0
        self.left_out: Counter[str] = Counter()

    def run(self, file: BinaryIO) -> None:
        """Copy everything. Raises OSError."""
        try:
            if METADATA in self._texts:
                self._writer.metadata(METADATA, self._texts[METADATA])
            for chunk in whole_chunks(file):
                self._chunk(chunk)
            for name, told in self._found.texts.items():
                if name != METADATA:
                    self._writer.metadata(name, told)
            self._writer.flush()
            self._writer.sync()
            self._writer.finish()
        except OSError:
            with contextlib.suppress(OSError):
                self._writer.close()
            raise

    def _chunk(self, chunk: Unpacked) -> None:
        self._schemas |= chunk.schemas
        self._channels |= chunk.channels
        for message in chunk.messages:
            self._message(message)
        # Payloads are views of this chunk: let go of it.
        self._writer.flush()

    def _message(self, message: Told) -> None:
        channel = self._channels.get(message.channel)
        schema = None if channel is None else self._schemas.get(channel.schema_id)
        if channel is None or schema is None:
            told = channel_of(message.data, self._camera)
            if told is None:
                self.left_out["messages of an unknown kind"] += 1
                return
            key, kind = told
            channel = Channel(0, key, "protobuf", {"on_wire": "yes" if kind.on_wire else "no"}, 0)
            schema = Schema(id=0, name=kind.schema, encoding="protobuf", data=descriptor_set(kind.schema))
        if not is_decodable(schema.name, message.data):
            self.left_out["messages that cannot be decoded"] += 1
            return
        number = self._writer.channel(channel.topic, _described(schema), channel.metadata)
        self._writer.add(number, message.sequence, (message.log_ns, message.publish_ns), [message.data])
        self.kept += 1


def _described(schema: Schema) -> Callable[[], tuple[str, str, bytes]]:
    return lambda: (schema.name, schema.encoding, schema.data)
