"""Reading a recording: its messages in the order in which they were written, its frames, its rig.

That is the order of the frames, also where the server's clock was set. Files are read from front to back; what is
damaged is refused with a hint to `recover`.
"""

import os
from collections.abc import Iterator
from itertools import chain, islice, pairwise
from pathlib import Path
from statistics import median
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics
from numpy.typing import NDArray

from asterism.protocol.codec import decode_image
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT, PROTOCOL, UNNUMBERED, Kind, Message
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.recordings.records import MAGIC, Damaged, read_metadata
from asterism.recordings.summary_check import check_index, counted_chunks, read_at
from asterism.recordings.told import METADATA, RIG, is_sound, rig_files, rig_told
from asterism.recordings.walk import Gap, opened, walk

RATE_FRAMES = 50  # whose spacing tells the rate


def recording_files(path: Path) -> tuple[list[Path], list[Path]]:
    """The poses and frames files of a recording's folder. Raises InputError where there are none."""
    if not path.exists():
        raise InputError(f"{path}: there is no such recording")
    if not path.is_dir():
        raise InputError(f"{path}: is a file, expected a recording's folder (with poses-0001.mcap in it)")
    poses, frames = (
        sorted(path.glob(f"{stem}-*.mcap"), key=lambda file: (len(file.name), file.name))
        for stem in ("poses", "frames")
    )
    if not poses and not frames:
        raise InputError(f"{path}: is no recording, expected a folder with poses-0001.mcap in it")
    return poses, frames


class Recording:
    """A recording's folder, opened for reading.

    Raises InputError when it is no recording, was cut off or damaged and not recovered, or is of a newer version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._poses, self._frames = recording_files(path)
        self._statistics = {file: self._check(file) for file in self._poses + self._frames}
        self.metadata = self._read_metadata()
        protocol = self.metadata.get("protocol", "1")  # which version 0.1 did not tell
        if not protocol.isdecimal() or int(protocol) > PROTOCOL:
            raise InputError(
                f"{path}: holds messages of protocol {protocol[:20]}, this program reads those up to {PROTOCOL}; "
                "a newer version of it does"
            )

    def rig(self) -> Rig:
        """The rig that was in force when it began. Raises InputError if the recording does not hold it."""
        return rig_told(self.metadata, str(self.path))

    def rigs(self) -> list[tuple[int, Rig]]:
        """Every rig that was in force, with the number of the first frame that was solved with it: a server reads its
        rig again when it is told to. Raises InputError like `rig`.
        """
        rigs, told = [(0, self.rig())], rig_files(self.metadata)
        for file in self._poses[1:]:
            metadata = self._metadata_of(file) or {}
            if RIG in metadata and rig_files(metadata) != told:
                told = rig_files(metadata)
                reports = (message for message in self._messages(file) if message.kind.schema == FRAME_REPORT.schema)
                rigs += [(first.sequence, rig_told(metadata, str(self.path))) for first in islice(reports, 1)]
        return rigs

    def files(self) -> list[tuple[Path, Rig]]:
        """The files of messages, each with the rig that was in force in it. Raises InputError like `rig`."""
        found, told, rig = [], rig_files(self.metadata), self.rig()
        for file in self._poses:
            metadata = self._metadata_of(file) or {}
            if RIG in metadata and rig_files(metadata) != told:
                told, rig = rig_files(metadata), rig_told(metadata, str(self.path))
            found.append((file, rig))
        return found

    def messages(self) -> Iterator[Message]:
        """Everything but the images, as it was written."""
        return chain.from_iterable(self._messages(file) for file in self._poses)

    def messages_and_images(self) -> Iterator[Message]:
        """Everything; an image comes before what was made of it."""
        images = self._images()
        image = next(images, None)
        for message in self.messages():
            while image is not None and message.kind.schema not in UNNUMBERED and image.sequence <= message.sequence:
                yield image
                image = next(images, None)
            yield message
        if image is not None:
            yield from chain([image], images)

    def frames(self) -> Iterator[tuple[NDArray[np.uint8], int, int]]:
        """Images (h, w) uint8 with their mid-exposure in ns and their number."""
        return self.frames_from(0)

    def frames_from(self, first: int) -> Iterator[tuple[NDArray[np.uint8], int, int]]:
        """The same without so many before; what lies before them is not read."""
        for message in self._images_from(first):
            yield decode_image(message.payload), message.log_ns, message.sequence

    def count_frames(self) -> int:
        """How many images the recording holds."""
        return sum(self._statistics[file].message_count for file in self._frames)

    def frame_rate_hz(self) -> float | None:
        """By the spacing of the first images; None where there are too few."""
        times = [message.log_ns for message in islice(self._images(), RATE_FRAMES)]
        steps = [after - before for before, after in pairwise(times) if after > before]
        return 1e9 / median(steps) if steps else None

    def count_messages(self) -> int:
        """How many messages there are beside the images."""
        return sum(self._statistics[file].message_count for file in self._poses)

    def _images(self) -> Iterator[Message]:
        return chain.from_iterable(self._messages(file) for file in self._frames)

    def _images_from(self, first: int) -> Iterator[Message]:
        for file in self._frames:
            held = self._statistics[file].message_count
            if first < held:
                start, before = self._chunk_of(file, first) if first else (None, 0)
                yield from islice(self._messages(file, start), first - before, None)
            first = max(first - held, 0)

    def _chunk_of(self, file: Path, first: int) -> tuple[int, int]:
        """Where the chunk begins that holds a message, and how many messages are before it."""
        before = 0
        with opened(file) as stream:
            try:
                for place, count in counted_chunks(stream):
                    if first < before + count:
                        return place.offset, before
                    before += count
            except Damaged as damage:
                raise InputError(f"{file}: is damaged ({damage}); {self._hint()}") from None
        raise InputError(f"{file}: is damaged (its index tells of other messages); {self._hint()}")

    def _check(self, file: Path) -> Statistics:
        with opened(file) as stream:
            begin = read_at(stream, 0, len(MAGIC))
            if begin and begin != MAGIC[: len(begin)]:
                raise InputError(f"{file}: is no MCAP file, expected what asterism recorded; {self._hint()}")
            try:
                return check_index(stream)
            except Damaged as damage:
                if _ends_as_mcap(stream):
                    raise InputError(f"{file}: is damaged ({damage}); {self._hint()}") from None
                raise InputError(f"{file}: was cut off (its server was killed?); {self._hint()}") from None

    def _hint(self) -> str:
        return f"run this first: {typed('recover', self.path)}"

    def _read_metadata(self) -> dict[str, str]:
        """From the first file that has it. Raises InputError where that is damaged."""
        told = (self._metadata_of(file) for file in self._poses + self._frames)
        return next((metadata for metadata in told if metadata is not None), {})

    def _metadata_of(self, file: Path) -> dict[str, str] | None:
        with opened(file) as stream:
            for part in walk(stream):
                if isinstance(part, Gap) or part.opcode in (Opcode.CHUNK, Opcode.DATA_END):
                    break
                if part.opcode == Opcode.METADATA and (told := read_metadata(part.body)).name == METADATA:
                    if is_sound(told.metadata):
                        return dict(told.metadata)
                    raise InputError(f"{file}: is damaged (its metadata); {self._hint()}")
        return None

    def _messages(self, file: Path, start: int | None = None) -> Iterator[Message]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        with opened(file) as stream:
            for part in walk(stream, start):
                if isinstance(part, Gap) or part.amiss:
                    why = part.why if isinstance(part, Gap) else "a chunk's head"
                    raise InputError(f"{file}: is damaged ({why}); {self._hint()}")
                if part.opcode == Opcode.DATA_END:
                    return
                if part.unpacked is None:
                    continue
                schemas |= part.unpacked.schemas
                channels |= part.unpacked.channels
                for told in part.unpacked.messages:
                    channel = channels.get(told.channel)
                    if channel is None:
                        raise InputError(f"{file}: is damaged (a message without its channel); {self._hint()}")
                    schema = schemas.get(channel.schema_id)
                    kind = Kind(schema.name if schema else "", channel.metadata.get("on_wire") == "yes")
                    payload = bytes(told.data)
                    yield Message(channel.topic, kind, payload, told.log_ns, told.publish_ns, told.sequence)


def _ends_as_mcap(stream: BinaryIO) -> bool:
    size = stream.seek(0, os.SEEK_END)
    return read_at(stream, max(size - len(MAGIC), len(MAGIC)), len(MAGIC)) == MAGIC
