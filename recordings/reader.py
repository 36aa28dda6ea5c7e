"""Reading a recording: its messages in the order of time, its frames, its rig."""

from collections.abc import Iterator
from heapq import merge
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from numpy.typing import NDArray

from asterism.protocol.codec import decode_image
from asterism.protocol.errors import InputError
from asterism.protocol.messages import Kind, Message
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig, parse_rig
from asterism.recordings.index import begins_as_mcap, is_complete
from asterism.recordings.series import OFFSET_KEY


def recording_files(path: Path) -> tuple[list[Path], list[Path]]:
    """The poses and frames files of a recording's folder. Raises InputError where there are none."""
    if not path.exists():
        raise InputError(f"{path}: there is no such recording")
    if not path.is_dir():
        raise InputError(f"{path}: is a file, expected a recording's folder (with poses-0001.mcap in it)")
    poses, frames = sorted(path.glob("poses-*.mcap")), sorted(path.glob("frames-*.mcap"))
    if not poses:
        raise InputError(f"{path}: is no recording, expected a folder with poses-0001.mcap in it")
    return poses, frames


class Recording:
    """A recording's folder, opened for reading.

    Raises InputError when it is no recording, or was cut off and not recovered.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._poses, self._frames = recording_files(path)
        for file in self._poses + self._frames:
            if not begins_as_mcap(file):
                raise InputError(f"{file}: is no MCAP file, expected what asterism recorded")
            if not is_complete(file):
                raise InputError(
                    f"{file}: was cut off (its server was killed?); run this first: {typed('recover', path)}"
                )
        self.metadata = self._read_metadata()

    def rig(self) -> Rig:
        """The rig that was in force. Raises InputError if the recording does not hold it."""
        try:
            offsets = {
                key.removeprefix(OFFSET_KEY): text for key, text in self.metadata.items() if key.startswith(OFFSET_KEY)
            }
            return parse_rig(self.metadata["rig.yaml"], self.metadata["camera.yaml"], str(self.path), offsets)
        except KeyError as missing:
            raise InputError(f"{self.path}: holds no {missing}; it was not recorded by asterism") from None

    def messages(self) -> Iterator[Message]:
        """Everything but the images, in the order of `log_time`, then as it was written."""
        for file in self._poses:
            yield from _messages(file)

    def messages_and_images(self) -> Iterator[Message]:
        """Everything, in the order of `log_time`; an image comes before what was made of it."""
        images = (message for file in self._frames for message in _messages(file))
        yield from merge(images, self.messages(), key=lambda message: message.log_ns)

    def frames(self) -> Iterator[tuple[NDArray[np.uint8], int, int]]:
        """Images (h, w) uint8 with their mid-exposure in ns and their number."""
        for file in self._frames:
            for message in _messages(file):
                yield decode_image(message.payload), message.log_ns, message.sequence

    def count_frames(self) -> int:
        """How many images the recording holds."""
        return sum(_summary_of(file)[0] for file in self._frames)

    def frames_span_ns(self) -> int:
        """Time between the first and the last image."""
        spans = [_summary_of(file)[1:] for file in self._frames]
        return max(last for _, last in spans) - min(first for first, _ in spans) if spans else 0

    def count_messages(self) -> int:
        """How many messages there are beside the images."""
        return sum(_summary_of(file)[0] for file in self._poses)

    def _read_metadata(self) -> dict[str, str]:
        found: dict[str, str] = {}
        with self._poses[0].open("rb") as stream:
            for entry in SeekingReader(stream).iter_metadata():
                if entry.name == "asterism":
                    found.update(entry.metadata)
        return found


def _messages(file: Path) -> Iterator[Message]:
    kinds: dict[int, Kind] = {}
    with file.open("rb") as stream:
        try:
            for schema, channel, message in SeekingReader(stream, validate_crcs=True).iter_messages():
                if channel.id not in kinds:
                    name = schema.name if schema is not None else ""
                    kinds[channel.id] = Kind(name, channel.metadata.get("on_wire") == "yes")
                yield Message(
                    channel.topic,
                    kinds[channel.id],
                    message.data,
                    message.log_time,
                    message.publish_time,
                    message.sequence,
                )
        except (McapError, ValueError, RuntimeError) as error:
            raise InputError(f"{file}: is damaged ({error})") from None


def _summary_of(file: Path) -> tuple[int, int, int]:
    """Messages, first and last time."""
    with file.open("rb") as stream:
        summary = SeekingReader(stream).get_summary()
    if summary is None or summary.statistics is None:
        return 0, 0, 0
    statistics = summary.statistics
    return statistics.message_count, statistics.message_start_time, statistics.message_end_time
