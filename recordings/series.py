"""One series of MCAP files (poses-0001, poses-0002, ... or frames-...), split by size, that survives a full disk."""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path

from asterism.protocol.messages import ANNOTATIONS, CALIBRATION, TRANSFORMS, Kind, Message
from asterism.protocol.schemas import descriptor_set
from asterism.recordings.packing import Packing
from asterism.recordings.records import Buffer
from asterism.recordings.told import METADATA, with_check_sum
from asterism.recordings.writer import Writer

MOST_CHUNKS = 10_000  # of a file, whose index is in memory: 1 MB
VIEWERS = frozenset(kind.schema for kind in (ANNOTATIONS, CALIBRATION, TRANSFORMS))  # made of what was published


class Series:
    """Writes messages into <folder>/<stem>-NNNN.mcap. Not for several threads at once.

    ``begin`` is called with every new file, and returns the messages that it begins with (calibration, fixed
    transforms), so that each file can be read alone; ``metadata`` is written into each.
    """

    def __init__(
        self,
        folder: Path,
        stem: str,
        packing: Packing,
        split_bytes: int,
        metadata: dict[str, str],
        begin: Callable[[], list[Message]],
    ) -> None:
        self._folder = folder
        self._stem = stem
        self._packing = packing
        self._split_bytes = split_bytes
        self._metadata = with_check_sum(metadata)
        self._begin = begin
        self._number = 0
        self._writer: Writer | None = None
        self._path = folder
        self._open = 0  # messages that were added to the file in work, but for those that are for viewers
        self._unfinished: list[tuple[Path, Writer]] = []  # whose index found no room
        self.finished: list[tuple[Path, int, int]] = []  # files that are whole, their bytes and messages

    @property
    def bytes_written(self) -> int:
        """How much all files hold by now."""
        current = self._writer.bytes_written if self._writer is not None else 0
        return sum(size for _, size, _ in self.finished) + current

    def add(self, message: Message, payload: Sequence[Buffer] | None = None) -> None:
        """Append a message; ``payload`` in pieces instead of its own. Raises OSError when the disk does not take it;
        call `abandon` then.
        """
        counts = message.kind.schema not in VIEWERS
        self._open += counts
        writer = self._writer
        if writer is None or writer.bytes_written >= self._split_bytes or len(writer.contents.chunks) >= MOST_CHUNKS:
            self._next_file(message.log_ns)
            self._open = int(counts)
        self._append(message, payload if payload is not None else [message.payload])

    def begin_anew(self, metadata: dict[str, str]) -> None:
        """Let the next message begin a new file, with that metadata. Raises OSError like `add`."""
        if self._writer is not None:
            self._finish()
        self._metadata = with_check_sum(metadata)

    def flush(self) -> None:
        """Bring everything added so far to the file. Raises OSError like `add`."""
        if self._writer is not None:
            self._writer.flush()

    def close(self, ending: dict[str, str]) -> None:
        """Finish the current file, with ``ending`` as its last metadata. Raises OSError like `add`."""
        self._finish_late()
        if self._writer is not None:
            self._writer.metadata("asterism/end", ending)
            self._finish()

    def abandon(self) -> int:
        """Leave the file readable after a write failed, and begin a new one with the next message.

        Returns how many messages that were added are lost, but for those that are for viewers. Never raises.
        """
        writer, self._writer = self._writer, None
        lost, self._open = self._open, 0
        if writer is None:
            return lost
        contents = writer.contents
        for number, count in contents.counts.items():
            schema = contents.schemas[contents.channels[number].schema_id].name
            lost -= count if schema not in VIEWERS else 0
        if contents.messages:
            self._unfinished.append((self._path, writer))
            self._finish_late()
        else:
            writer.close()
            with contextlib.suppress(OSError):
                self._path.unlink()
        return lost

    def _finish_late(self) -> None:
        """Write the index that found no room, if there is some now."""
        with contextlib.suppress(OSError):
            while self._unfinished:
                path, writer = self._unfinished[0]
                writer.finish()
                del self._unfinished[0]
                self.finished.append((path, writer.bytes_written, writer.contents.messages))

    def delete_oldest(self) -> int:
        """Delete the oldest finished file; returns how many messages it held."""
        path, _, messages = self.finished.pop(0)
        path.unlink(missing_ok=True)
        return messages

    def _finish(self) -> None:
        assert self._writer is not None
        # Once more, should the beginning be damaged.
        self._writer.metadata(METADATA, self._metadata)
        self._writer.finish()
        self.finished.append((self._path, self._writer.bytes_written, self._writer.contents.messages))
        self._writer, self._open = None, 0

    def _next_file(self, time_ns: int) -> None:
        self._finish_late()
        if self._writer is not None:
            self._finish()
        self._number += 1
        self._path = self._folder / f"{self._stem}-{self._number:04d}.mcap"
        self._writer = Writer(self._path, self._packing)
        self._writer.metadata(METADATA, self._metadata)
        for message in self._begin():
            first = Message(message.key, message.kind, message.payload, time_ns, time_ns, message.sequence)
            self._append(first, [message.payload])

    def _append(self, message: Message, payload: Sequence[Buffer]) -> None:
        assert self._writer is not None
        channel = self._writer.channel(
            message.key, lambda: _schema(message.kind), {"on_wire": "yes" if message.kind.on_wire else "no"}
        )
        self._writer.add(channel, message.sequence, (message.log_ns, message.publish_ns), payload)


def _schema(kind: Kind) -> tuple[str, str, bytes]:
    return kind.schema, "protobuf", descriptor_set(kind.schema)
