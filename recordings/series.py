"""One series of MCAP files (poses-0001, poses-0002, ... or frames-...), split by size, that survives a full disk."""

import os
from collections.abc import Callable
from pathlib import Path

from mcap.writer import CompressionType, Writer

from asterism import __version__
from asterism.protocol.messages import Kind, Message
from asterism.protocol.schemas import descriptor_set
from asterism.recordings.index import rebuild_index

LIBRARY = f"asterism {__version__}"
CHUNK_BYTES = 1 << 20
OFFSET_KEY = "led.offset: "  # of the metadata, before the name of a file that the rig's led.offset gives


class _Output:
    """An unbuffered file that knows where its last whole records end.

    MCAP's writer hands over whole records; they are collected until `push` and written in one go, so that a write
    that fails can be taken back.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._pending = bytearray()
        self.whole = 0  # bytes on disk that end with a whole record

    def write(self, data: bytes) -> int:
        self._pending += data
        return len(data)

    def tell(self) -> int:
        return self.whole + len(self._pending)

    def flush(self) -> None:
        """What the writer calls after a chunk; `push` does the work."""

    def push(self) -> None:
        """Write what is pending; on failure leave the file as it was and raise OSError."""
        view = memoryview(self._pending)
        done = 0
        try:
            while done < len(view):
                done += os.write(self._file, view[done:])
        except OSError:
            view.release()
            os.ftruncate(self._file, self.whole)
            raise
        view.release()
        self.whole += done
        self._pending.clear()

    def close(self) -> None:
        os.close(self._file)


class Series:
    """Writes messages into <folder>/<stem>-NNNN.mcap. Not for several threads at once.

    ``begin`` is called with every new file's number, and returns the messages that it begins with (calibration,
    fixed transforms), so that each file can be read alone; ``metadata`` is written into each.
    """

    def __init__(
        self,
        folder: Path,
        stem: str,
        compression: CompressionType,
        split_bytes: int,
        metadata: dict[str, str],
        begin: Callable[[], list[Message]],
    ) -> None:
        self._folder = folder
        self._stem = stem
        self._compression = compression
        self._split_bytes = split_bytes
        self._metadata = metadata
        self._begin = begin
        self._number = 0
        self._output: _Output | None = None
        self._writer: Writer | None = None
        self._path = folder
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._finished_bytes = 0

    @property
    def bytes_written(self) -> int:
        """How much all files hold by now."""
        output = self._output
        return self._finished_bytes + (output.whole if output is not None else 0)

    def add(self, message: Message) -> None:
        """Append a message. Raises OSError when the disk does not take it; call `abandon` then."""
        if self._output is None or self._output.tell() >= self._split_bytes:
            self._next_file(message.log_ns)
        self._append(message)
        assert self._output is not None
        self._output.push()

    def begin_anew(self, metadata: dict[str, str]) -> None:
        """Let the next message begin a new file, with that metadata. Raises OSError like `add`."""
        self._metadata = metadata
        if self._writer is not None:
            self._finish()

    def flush(self) -> None:
        """Bring everything added so far to the file. Raises OSError like `add`."""
        if self._writer is not None and self._output is not None:
            self._writer.flush()
            self._output.push()

    def close(self, ending: dict[str, str]) -> None:
        """Finish the current file, with ``ending`` as its last metadata. Raises OSError like `add`."""
        if self._writer is None or self._output is None:
            return
        self._writer.add_metadata("asterism/end", ending)
        self._finish()

    def abandon(self) -> None:
        """Leave the file readable after a write failed: drop what could not be written and index the rest."""
        if self._output is None:
            return
        whole = self._output.whole
        self._output.close()
        self._writer = self._output = None
        self._finished_bytes += whole
        if whole:
            rebuild_index(self._path)
        else:
            self._path.unlink()

    def _finish(self) -> None:
        assert self._writer is not None
        assert self._output is not None
        self._writer.finish()
        self._output.push()
        self._output.close()
        self._finished_bytes += self._output.whole
        self._writer = self._output = None

    def _next_file(self, time_ns: int) -> None:
        if self._writer is not None:
            self._finish()
        self._number += 1
        self._path = self._folder / f"{self._stem}-{self._number:04d}.mcap"
        self._output = _Output(self._path)
        self._writer = Writer(
            self._output,
            chunk_size=CHUNK_BYTES,
            compression=self._compression,
        )
        self._channels.clear()
        self._schemas.clear()
        self._writer.start(library=LIBRARY)
        self._writer.add_metadata("asterism", self._metadata)
        for message in self._begin():
            self._append(Message(message.key, message.kind, message.payload, time_ns, time_ns, message.sequence))

    def _append(self, message: Message) -> None:
        assert self._writer is not None
        self._writer.add_message(
            channel_id=self._channel(message.key, message.kind),
            log_time=message.log_ns,
            data=message.payload,
            publish_time=message.publish_ns,
            sequence=message.sequence,
        )

    def _channel(self, key: str, kind: Kind) -> int:
        assert self._writer is not None
        if key not in self._channels:
            if kind.schema not in self._schemas:
                self._schemas[kind.schema] = self._writer.register_schema(
                    kind.schema, "protobuf", descriptor_set(kind.schema)
                )
            self._channels[key] = self._writer.register_channel(
                key, "protobuf", self._schemas[kind.schema], {"on_wire": "yes" if kind.on_wire else "no"}
            )
        return self._channels[key]
