"""Chunks of an MCAP file: read within bounds of memory, and found again behind damage."""

import re
import struct
import zlib
from dataclasses import dataclass, field

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from asterism.recordings.records import (
    HEAD,
    Buffer,
    Cursor,
    Damaged,
    Told,
    read_channel,
    read_message,
    read_schema,
    records_in,
)

MOST_BYTES = 64 << 20  # of a chunk, packed or not: an image of 64 million pixels
SWELLING = 300
COMPRESSIONS = frozenset({"", "lz4", "zstd"})
_HEAD = struct.Struct("<QQQII")  # first and last time, size unpacked, check sum, length of the compression's name
# How a chunk begins, whatever is in it: opcode, length, times, size, check sum, compression; unpacked ones tell their
# size twice.
SIGNATURE = re.compile(rb"\x06.{5}\x00{3}.{16}(.{5}\x00{3}).{4}(?:\x00{4}\1|\x04\x00{3}zstd|\x03\x00{3}lz4)", re.DOTALL)
SIGNATURE_BYTES = HEAD.size + _HEAD.size + 8


@dataclass(slots=True)
class Unpacked:
    """A chunk's records, in the order in which they were written."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: list[Told] = field(default_factory=list)


class Chunk:
    """A chunk in a file: ``body`` is its record without opcode and length. Raises Damaged where its head is none.

    ``packed`` is the length of what follows the head, as the head tells it; ``data`` is what does follow.
    """

    def __init__(self, body: Buffer) -> None:
        cursor = Cursor(body)
        self.first_ns, self.last_ns, self.size, self.crc, length = _HEAD.unpack(cursor.take(_HEAD.size))
        name = bytes(cursor.take(length))
        self.compression = name.decode("ascii", "replace")
        if self.compression not in COMPRESSIONS:
            raise Damaged("an unknown compression")
        self.packed = cursor.u64()
        self.head_bytes = cursor.at
        self.data = cursor.take(cursor.left)

    @property
    def consistent(self) -> bool:
        """Whether head and record tell the same length."""
        return self.packed == len(self.data)

    @property
    def swells(self) -> bool:
        """Whether it tells that it unpacks to so much more than it is that it may be a bomb, or all black."""
        return bool(self.size > SWELLING * len(self.data) + (1 << 20))

    @property
    def is_checked(self) -> bool:
        """Whether a check sum tells what is damaged: MCAP's, or zstd's own."""
        if self.crc or self.compression != "zstd":
            return bool(self.crc)
        try:
            return bool(zstandard.get_frame_parameters(self.data).has_checksum)
        except zstandard.ZstdError:
            return False

    @property
    def print(self) -> tuple[int, int]:
        """Tells it from others: a check sum of its data and their length."""
        return zlib.crc32(self.data), len(self.data)

    def unpack(self, size: int | None = None) -> Buffer:
        """Its records' bytes; ``size`` where the head is not to be believed. Raises Damaged: check sum, compression."""
        believed = self.size if size is None else size
        if believed > MOST_BYTES:
            raise Damaged(f"a chunk of {believed} bytes, where at most {MOST_BYTES} are read")
        ended = True
        if self.compression == "":
            unpacked: Buffer = self.data
        elif self.compression == "zstd":
            unpacked = _zstd(self.data, believed)
        else:
            unpacked, ended = _lz4(self.data, believed)
        wrong = ""
        if size is None and len(unpacked) != self.size:
            wrong = "a chunk of another size than it tells"
        elif size is None and not ended:
            wrong = "an LZ4 frame without its end"  # which other readers refuse
        elif self.crc and zlib.crc32(unpacked) != self.crc:
            wrong = "a wrong check sum"
        if wrong:
            del unpacked  # the exception's traceback would keep it
            raise Damaged(wrong)
        return unpacked

    def read(self, size: int | None = None) -> Unpacked:
        """Everything in it; ``size`` as in `unpack`. Raises Damaged."""
        found = Unpacked()
        for at, opcode, body in records_in(self.unpack(size)):
            if opcode == Opcode.MESSAGE:
                found.messages.append(read_message(body, at))
            elif opcode == Opcode.SCHEMA:
                schema = read_schema(body)
                found.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = read_channel(body)
                found.channels[channel.id] = channel
        return found


def _zstd(data: memoryview, size: int) -> bytes:
    """Reads no more than one byte beyond the size that is told, so that a bomb costs what it tells."""
    try:
        with zstandard.ZstdDecompressor(max_window_size=MOST_BYTES).stream_reader(data) as stream:
            found: bytes = stream.read(size + 1)
            return found
    except (zstandard.ZstdError, ValueError, MemoryError) as error:
        raise Damaged(f"zstd: {error}") from None


def _lz4(data: memoryview, size: int) -> tuple[bytes, bool]:
    """Likewise; and whether the frame's end was reached."""
    frame = lz4.frame.LZ4FrameDecompressor()
    try:
        found: bytes = frame.decompress(data, max_length=size + 1)
    except (RuntimeError, ValueError, MemoryError, EOFError) as error:
        raise Damaged(f"LZ4: {error}") from None
    return found, frame.eof
