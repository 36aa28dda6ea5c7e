"""Where the chunks of an MCAP file are: the records of its index, as they will stand there."""

from collections import Counter

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex


class ChunkPlaces:
    """In the order of the file. All but the newest are bytes: as objects, those of a day would take gigabytes."""

    def __init__(self) -> None:
        self.compressions: Counter[str] = Counter()
        self.span_ns = (0, 0)  # first and last time; zeros where there is no chunk
        self._packed = bytearray()
        self._last: ChunkIndex | None = None

    def __len__(self) -> int:
        return self.compressions.total()

    @property
    def last(self) -> ChunkIndex:
        """The newest, to which may be added. There must be one."""
        assert self._last is not None
        return self._last

    def append(self, chunk: ChunkIndex) -> None:
        """One more."""
        first, last = self.span_ns if self.compressions else (chunk.message_start_time, chunk.message_end_time)
        self.span_ns = (min(first, chunk.message_start_time), max(last, chunk.message_end_time))
        self.compressions[chunk.compression] += 1
        if self._last is not None:
            self._packed += _record(self._last)
        self._last = chunk

    def write(self, builder: RecordBuilder) -> None:
        """Write all records, as one of mcap's writes itself."""
        builder.write(bytes(self._packed))
        if self._last is not None:
            self._last.write(builder)


def _record(chunk: ChunkIndex) -> bytes:
    builder = RecordBuilder()
    chunk.write(builder)
    record: bytes = builder.end()
    return record
