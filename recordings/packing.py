"""How chunks are packed, and by what damage to them shows."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import lz4.frame
import zstandard

from asterism.recordings.records import Buffer

ZSTD_LEVEL = 1


class Packing(NamedTuple):
    """``compression`` is MCAP's word for it; ``crc``: MCAP's check sum, of the chunk as it was before."""

    compression: str
    crc: bool = True

    def packer(self) -> Callable[[Sequence[Buffer]], list[Buffer]]:
        """What packs a chunk's pieces; those of a plain one stay where they are."""
        if self.compression == "zstd":
            zstd = zstandard.ZstdCompressor(level=ZSTD_LEVEL, write_checksum=True)
            if not self.crc:
                zstd = zstandard.ZstdCompressor(compression_params=_LONG_RUNS)
            joined = Joined()
            return lambda parts: [zstd.compress(joined(parts))]
        if self.compression == "lz4":
            return lambda parts: [lz4.frame.compress(b"".join(parts))]
        return list


class Joined:
    """Pieces one after the other, in memory that is used again: new memory for every frame costs more than the copy."""

    def __init__(self) -> None:
        self._room = bytearray()

    def __call__(self, parts: Sequence[Buffer]) -> memoryview:
        """They hold until the next call."""
        size = sum(map(len, parts))
        if size > len(self._room):
            self._room = bytearray(size + size // 8)
        whole, at = memoryview(self._room), 0
        for part in parts:
            whole[at : at + len(part)] = part
            at += len(part)
        return whole[:size]


# Level 1 with a small table and long matches: a quarter faster where nearly all is alike, and as small.
_LONG_RUNS = zstandard.ZstdCompressionParameters(
    window_log=17, hash_log=8, chain_log=6, search_log=1, min_match=7, strategy=1, write_checksum=True
)
# What costs the processor least for whole frames: no compression.
PLAIN = Packing("")
ZSTD_AND_CRC = Packing("zstd")
# Under zstd's own check sum, which takes a third of the time of MCAP's: for what is large and packs to little.
ZSTD = Packing("zstd", crc=False)
