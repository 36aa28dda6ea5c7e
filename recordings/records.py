"""MCAP records read from bytes that may be damaged: within their bounds, and nothing but `Damaged` is raised.

MCAP format: https://mcap.dev/spec.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, length
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
OPCODES = frozenset(int(opcode) for opcode in Opcode)
_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")

Buffer = bytes | memoryview


class Damaged(Exception):
    """What is read is not what was written; the text says how that shows."""


class Cursor:
    """Fields of a record, one after the other."""

    def __init__(self, data: Buffer) -> None:
        self._data = memoryview(data)
        self.at = 0

    @property
    def left(self) -> int:
        """Bytes behind the last field."""
        return len(self._data) - self.at

    def take(self, length: int) -> memoryview:
        """The next bytes. Raises Damaged where there are fewer."""
        if length > self.left:
            raise Damaged("a length that leads behind its record")
        self.at += length
        return self._data[self.at - length : self.at]

    def u16(self) -> int:
        """An unsigned number of two bytes."""
        return int(_U16.unpack(self.take(2))[0])

    def u32(self) -> int:
        """Of four."""
        return int(_U32.unpack(self.take(4))[0])

    def u64(self) -> int:
        """Of eight."""
        return int(_U64.unpack(self.take(8))[0])

    def text(self) -> str:
        """A string with its length before it."""
        try:
            return str(self.take(self.u32()), "utf-8")
        except UnicodeDecodeError:
            raise Damaged("a text that is no UTF-8") from None

    def end(self) -> None:
        """Raises Damaged where anything is left: lengths are believed only where all of them agree."""
        if self.left:
            raise Damaged("a length that is not its record's")

    def texts(self) -> dict[str, str]:
        """A map of strings."""
        part = Cursor(self.take(self.u32()))
        found: dict[str, str] = {}
        while part.left:
            key = part.text()
            found[key] = part.text()
        return found


def read_schema(body: Buffer) -> Schema:
    """Raises Damaged."""
    cursor = Cursor(body)
    number, name, encoding = cursor.u16(), cursor.text(), cursor.text()
    schema = Schema(id=number, name=name, encoding=encoding, data=bytes(cursor.take(cursor.u32())))
    cursor.end()
    if number == 0:
        raise Damaged("a schema of number 0")
    return schema


def read_channel(body: Buffer) -> Channel:
    """Raises Damaged."""
    cursor = Cursor(body)
    number, schema, topic, encoding = cursor.u16(), cursor.u16(), cursor.text(), cursor.text()
    channel = Channel(id=number, schema_id=schema, topic=topic, message_encoding=encoding, metadata=cursor.texts())
    cursor.end()
    return channel


def read_metadata(body: Buffer) -> Metadata:
    """Raises Damaged."""
    cursor = Cursor(body)
    metadata = Metadata(name=cursor.text(), metadata=cursor.texts())
    cursor.end()
    return metadata


def check_record(opcode: int, body: Buffer) -> None:
    """Raises Damaged where a record of the data, but for chunks, is not whole; those of an index are not looked at."""
    cursor = Cursor(body)
    if opcode == Opcode.MESSAGE:
        read_message(cursor.take(cursor.left))
    elif opcode == Opcode.MESSAGE_INDEX:
        cursor.u16()
        cursor.take(cursor.u32() // 16 * 16)
    elif opcode == Opcode.HEADER:
        cursor.text()
        cursor.text()
    elif opcode in _SIZES:
        cursor.take(_SIZES[Opcode(opcode)])
    elif opcode == Opcode.ATTACHMENT:
        checked = cursor.take(max(cursor.left - 4, 0))
        if cursor.u32() != zlib.crc32(checked):
            raise Damaged("a wrong check sum")
    elif opcode in _READ:
        _READ[Opcode(opcode)](cursor.take(cursor.left))
    else:
        return
    cursor.end()


class Told(NamedTuple):
    """A message as it lies in a chunk: ``at`` is where its record begins there, ``data`` a view of its payload."""

    at: int
    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: memoryview


def read_message(body: memoryview, at: int = 0) -> Told:
    """Raises Damaged."""
    if len(body) < MESSAGE_HEAD.size:
        raise Damaged("a message shorter than its head")
    channel, sequence, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(body)
    return Told(at, channel, sequence, log_ns, publish_ns, body[MESSAGE_HEAD.size :])


def records_in(data: Buffer) -> Iterator[tuple[int, int, memoryview]]:
    """Where each record begins, its opcode and its body. Raises Damaged."""
    view = memoryview(data)
    at = 0
    while at < len(view):
        if at + HEAD.size > len(view):
            raise Damaged("a record shorter than its head")
        opcode, length = HEAD.unpack_from(view, at)
        begin = at + HEAD.size
        if length > len(view) - begin:
            raise Damaged("a length that leads behind its chunk")
        yield at, opcode, view[begin : begin + length]
        at = begin + length


_SIZES = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}
_READ: dict[Opcode, Callable[[Buffer], object]] = {
    Opcode.SCHEMA: read_schema,
    Opcode.CHANNEL: read_channel,
    Opcode.METADATA: read_metadata,
}
