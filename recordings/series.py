"""One series of MCAP files (poses-0001, poses-0002, ... or frames-...), split by size, that survives a full disk."""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path

from asterism.protocol.messages import Kind, Message
from asterism.protocol.schemas import descriptor_set
from asterism.recordings.records import Buffer
from asterism.recordings.told import METADATA, with_check_sum
from asterism.recordings.writer import Writer


class Series:
    """Writes messages into <folder>/<stem>-NNNN.mcap. Not for several threads at once.

    ``begin`` is called with every new file, and returns the messages that it begins with (calibration, fixed
    transforms), so that each file can be read alone; ``metadata`` is written into each.
    """

    def __init__(
        self,
        folder: Path,
        stem: str,
        compression: str,
        split_bytes: int,
        metadata: dict[str, str],
        begin: Callable[[], list[Message]],
    ) -> None:
        self._folder = folder
        self._stem = stem
        self._compression = compression
        self._split_bytes = split_bytes
        self._metadata = with_check_sum(metadata)
        self._begin = begin
        self._number = 0
        self._writer: Writer | None = None
        self._path = folder
        self._began_with = 0
        self.finished: list[tuple[Path, int]] = []  # files that are whole, and their bytes

    @property
    def bytes_written(self) -> int:
        """How much all files hold by now."""
        current = self._writer.bytes_written if self._writer is not None else 0
        return sum(size for _, size in self.finished) + current

    def add(self, message: Message, payload: Sequence[Buffer] | None = None) -> None:
        """Append a message; ``payload`` in pieces instead of its own. Raises OSError when the disk does not take it;
        call `abandon` then.
        """
        if self._writer is None or self._writer.bytes_written >= self._split_bytes:
            self._next_file(message.log_ns)
        self._append(message, payload if payload is not None else [message.payload])

    def flush(self) -> None:
        """Bring everything added so far to the file. Raises OSError like `add`."""
        if self._writer is not None:
            self._writer.flush()

    def close(self, ending: dict[str, str]) -> None:
        """Finish the current file, with ``ending`` as its last metadata. Raises OSError like `add`."""
        if self._writer is not None:
            self._writer.metadata("asterism/end", ending)
            self._finish()

    def abandon(self) -> int:
        """Leave the file readable after a write failed, and begin a new one with the next message.

        Returns how many messages that were added are lost. Never raises.
        """
        writer, self._writer = self._writer, None
        if writer is None:
            return 0
        # What a file begins with is nothing that was added.
        lost = writer.dropped - (0 if writer.contents.messages else self._began_with)
        with contextlib.suppress(OSError):
            if writer.contents.messages:
                writer.finish()
                self.finished.append((self._path, writer.bytes_written))
            else:
                writer.close()
                self._path.unlink()
        return lost

    def _finish(self) -> None:
        assert self._writer is not None
        # Once more, should the beginning be damaged.
        self._writer.metadata(METADATA, self._metadata)
        self._writer.finish()
        self.finished.append((self._path, self._writer.bytes_written))
        self._writer = None

    def _next_file(self, time_ns: int) -> None:
        if self._writer is not None:
            self._finish()
        self._number += 1
        self._path = self._folder / f"{self._stem}-{self._number:04d}.mcap"
        self._writer = Writer(self._path, self._compression)
        self._writer.metadata(METADATA, self._metadata)
        begin = self._begin()
        self._began_with = len(begin)
        for message in begin:
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
