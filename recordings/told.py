"""What a recording's files tell of themselves, under a check sum: MCAP has none for metadata."""

import zlib
from collections.abc import Mapping

METADATA = "asterism"  # the name under which it stands
OFFSET_KEY = "led.offset: "  # before the name of a file that the rig's led.offset gives
_CHECK = "crc32"


def with_check_sum(told: Mapping[str, str]) -> dict[str, str]:
    """The same, and a check sum of it."""
    return {**told, _CHECK: _sum(told)}


def is_sound(told: Mapping[str, str]) -> bool:
    """Whether the check sum is right; version 0.1 wrote none."""
    return told.get(_CHECK) in (None, _sum(told)) and "camera" in told


def _sum(told: Mapping[str, str]) -> str:
    text = "\0".join(f"{key}\0{value}" for key, value in sorted(told.items()) if key != _CHECK)
    return f"{zlib.crc32(text.encode()):08x}"
