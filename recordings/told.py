"""What a recording's files tell of themselves, under a check sum: MCAP has none for metadata."""

import zlib
from collections.abc import Mapping

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, parse_rig

METADATA = "asterism"  # the name under which it stands
RIG = "rig.yaml"
_CAMERA = "camera.yaml"
_OFFSET = "led.offset: "  # before the name of a file that the rig's led.offset gives
_FILE = "file: "  # before the names of all others that the rig rests on
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


def rig_metadata(rig: Rig) -> dict[str, str]:
    """What is told of the rig in force: whole, with every file that it names."""
    return {
        "camera": rig.camera.name,
        "frame_id": rig.parent_frame,
        RIG: rig.rig_text,
        _CAMERA: rig.camera_text,
        **{f"{_OFFSET}{name}": text for name, text in rig.offset_texts.items()},
        **{f"{_FILE}{name}": text for name, text in rig.files.items()},
    }


def rig_files(told: Mapping[str, str]) -> dict[str, str]:
    """What of it a rig is made of."""
    return {key: text for key, text in told.items() if key in (RIG, _CAMERA) or key.startswith((_OFFSET, _FILE))}


def rig_told(told: Mapping[str, str], where: str) -> Rig:
    """The rig that is told of. Raises InputError where there is none in it."""
    try:
        texts = told[RIG], told[_CAMERA]
    except KeyError as missing:
        raise InputError(f"{where}: holds no {missing}; it was not recorded by asterism") from None
    return parse_rig(*texts, where, _behind(told, _OFFSET), _behind(told, _FILE))


def _behind(told: Mapping[str, str], prefix: str) -> dict[str, str]:
    return {key.removeprefix(prefix): text for key, text in told.items() if key.startswith(prefix)}
