"""A walk over an MCAP file from front to back, whatever its index says: whole records, and gaps where there are none.

A chunk is whole when its check sum is right; behind a gap the walk goes on at the next whole chunk. It takes little
memory and bounded time for any file.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from asterism.protocol.errors import InputError
from asterism.recordings.chunks import MOST_BYTES, SIGNATURE, SIGNATURE_BYTES, Chunk, Unpacked
from asterism.recordings.records import (
    HEAD,
    MAGIC,
    OPCODES,
    Damaged,
    check_record,
)

_BLOCK = 4 << 20  # of the search behind damage
# Unpacked in vain, at most so much and so many times the file: one made of what only looks like chunks comes to an end.
_TRIED_BYTES, _TRIED_TIMES = 1 << 30, 4


class Part(NamedTuple):
    """A whole record; ``opcode`` 0 is the magic at a file's end; ``amiss``: a whole chunk whose opcode or length is
    wrong.
    """

    offset: int
    length: int  # with opcode and length
    opcode: int
    body: memoryview
    chunk: Chunk | None = None
    unpacked: Unpacked | None = None
    amiss: bool = False


class Gap(NamedTuple):
    """Bytes that are no whole records; ``cut``: the file ends in the middle of one."""

    offset: int
    length: int
    why: str
    cut: bool = False


@contextmanager
def opened(path: Path, follow: bool = True) -> Iterator[BinaryIO]:
    """A regular file for reading; unless ``follow``, no link. Raises InputError for anything else."""
    try:
        mode = path.stat(follow_symlinks=follow).st_mode
        if stat.S_ISLNK(mode):
            raise InputError(f"{path}: is a link; expected a file, so that what it leads to stays as it is")
        if not stat.S_ISREG(mode):
            raise InputError(f"{path}: is {_kind(mode)}, expected a file that asterism recorded")
        file = path.open("rb", buffering=0)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    with file:
        try:
            yield file
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def _kind(mode: int) -> str:
    kinds = (
        (stat.S_ISDIR, "a folder"),
        (stat.S_ISFIFO, "a pipe"),
        (stat.S_ISSOCK, "a socket"),
    )
    return next((name for test, name in kinds if test(mode)), "a device")


def walk(file: BinaryIO, start: int | None = None) -> Iterator[Part | Gap]:
    """Every part of a file, in its order, the bytes before ``start`` left out (none: from the magic on)."""
    return _Walk(file).parts(start)


class _Walk:
    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, os.SEEK_END)
        self._tries = max(_TRIED_BYTES, _TRIED_TIMES * self._size)

    def parts(self, start: int | None) -> Iterator[Part | Gap]:
        at = start if start is not None else min(len(MAGIC), self._size)
        if start is None and self._read(0, len(MAGIC)) != MAGIC:
            yield Gap(0, at, "it does not begin as an MCAP file")
        while at < self._size:
            try:
                found: Part | Gap = self._part(at)
            except Damaged as damage:
                found = self._gap(at, damage)
            yield found
            at += found.length

    def _read(self, at: int, length: int) -> bytes:
        """So many bytes, or those up to the file's end."""
        parts, end = [], at + length
        while at < end:
            self._file.seek(at)
            part = self._file.read(end - at)
            if not part:
                break
            parts.append(part)
            at += len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _part(self, at: int) -> Part:
        head = self._read(at, HEAD.size)
        if head[: len(MAGIC)] == MAGIC:
            return Part(at, len(MAGIC), 0, memoryview(b""))
        if len(head) < HEAD.size:
            raise Damaged("it is cut off")
        opcode, length = HEAD.unpack(head)
        if opcode not in OPCODES:
            return self._chunk_anyway(at, "what is no record")
        if length > self._size - at - HEAD.size:
            return self._chunk_anyway(at, "it is cut off")
        if length > MOST_BYTES + SIGNATURE_BYTES:
            return self._chunk_anyway(at, f"a record of {length} bytes, where at most {MOST_BYTES} are read")
        body = memoryview(self._read(at + HEAD.size, length))
        if opcode == Opcode.CHUNK:
            return self._chunk(at, body)
        if SIGNATURE.match(bytes([Opcode.CHUNK]) + head[1:] + body[:SIGNATURE_BYTES].tobytes()):
            return self._chunk_anyway(at, "a chunk that calls itself something else")
        check_record(opcode, body)
        return Part(at, HEAD.size + length, opcode, body)

    def _chunk(self, at: int, body: memoryview) -> Part:
        why = ""
        try:
            chunk = Chunk(body)
            if not chunk.consistent:
                raise Damaged("a length that is not its chunk's")
            if chunk.swells and self._tries < 0:
                raise Damaged("one of too many chunks that unpack to too much")
            try:
                return Part(at, HEAD.size + len(body), Opcode.CHUNK, body, chunk, chunk.read())
            except Damaged:
                self._tries -= min(chunk.size, MOST_BYTES)
                raise
        except Damaged as damage:
            why = str(damage)
        return self._chunk_anyway(at, why)

    def _chunk_anyway(self, at: int, why: str) -> Part:
        """The chunk that is there although its opcode or one of its lengths is wrong: its check sum tells."""
        head = self._read(at, SIGNATURE_BYTES + 8)
        if len(head) < SIGNATURE_BYTES + 8:
            raise Damaged(why)
        outer = HEAD.unpack_from(head)[1]
        # The smaller first: what is behind a packed chunk goes unnoticed when that is read.
        for body_bytes in sorted({outer, self._told_by_chunk(head)}):
            if not 0 < body_bytes <= min(MOST_BYTES + SIGNATURE_BYTES, self._size - at - HEAD.size):
                continue
            body = memoryview(self._read(at + HEAD.size, body_bytes))
            try:
                chunk = Chunk(body)
                if not chunk.is_checked or self._tries < 0:
                    continue
                self._tries -= len(body) + min(chunk.size, MOST_BYTES)
                unpacked = chunk.read(MOST_BYTES)
            except Damaged:
                continue
            return Part(at, HEAD.size + body_bytes, Opcode.CHUNK, body, chunk, unpacked, amiss=True)
        raise Damaged(why)

    @staticmethod
    def _told_by_chunk(head: bytes) -> int:
        try:
            chunk = Chunk(head[HEAD.size :])
        except Damaged:
            return 0
        return chunk.head_bytes + chunk.packed

    def _gap(self, at: int, damage: Damaged) -> Gap:
        """From what is no whole record to the next that is one, or the next whole chunk, or the end."""
        head = self._read(at, SIGNATURE_BYTES + 8)
        limit = self._size
        if len(head) > HEAD.size:
            opcode, length = HEAD.unpack_from(head)
            # A chunk whose lengths agree is as long as it says, whatever is wrong inside.
            if opcode == Opcode.CHUNK and length == self._told_by_chunk(head):
                limit = min(at + HEAD.size + length, self._size)
        found = self._search(at + 1, limit)
        cut = found == self._size and (len(head) < HEAD.size or self._is_cut(at, head))
        return Gap(at, found - at, "it is cut off" if cut else str(damage), cut)

    def _is_cut(self, at: int, head: bytes) -> bool:
        """Whether the file ends in a record that was not written whole: the rest of it, or zeros, as disks leave."""
        if self._read(self._size - len(MAGIC), len(MAGIC)) == MAGIC:
            return False
        opcode, length = HEAD.unpack_from(head)
        if opcode in OPCODES and self._size - at - HEAD.size < length <= MOST_BYTES + SIGNATURE_BYTES:
            return True
        blocks = range(at, self._size, _BLOCK)
        return not any(self._read(block, min(_BLOCK, self._size - block)).strip(b"\0") for block in blocks)

    def _search(self, at: int, limit: int) -> int:
        """Where the next whole chunk begins; ``limit`` where there is none before."""
        while at < limit and self._tries >= 0:
            block = self._read(at, _BLOCK + SIGNATURE_BYTES)
            for match in SIGNATURE.finditer(block):
                if match.start() < min(_BLOCK, limit - at) and self._is_whole(at + match.start()):
                    return at + match.start()
            at += _BLOCK
        return limit

    def _is_whole(self, at: int) -> bool:
        if self._tries < 0:
            return False
        try:
            return self._part(at).chunk is not None
        except Damaged:
            self._tries -= 1 << 16
            return False
