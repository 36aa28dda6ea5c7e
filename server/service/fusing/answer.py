"""What a camera's server answers when it is asked for its rig, read beside the loop: that takes a tenth of a second."""

import threading
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import heights_file
from asterism.protocol.errors import InputError
from asterism.protocol.messages import PROTOCOL
from asterism.protocol.rig import parse_rig
from asterism.server.fusing.fitting import view_of
from asterism.server.fusing.fleet import View

MOST_TEXT = 256 << 10  # of a rig of a hundred robots it is a third; a YAML reader takes ten seconds for it
MOST_TABLE = heights_file.MOST_BYTES  # of a surface
MOST_READ = 64  # that are remembered
_READING = threading.Lock()
Texts = tuple[object, ...]  # of all files of a rig


class Answer(NamedTuple):
    """Of the server of a ``session``, ``who`` that is; ``view`` is None where its ``texts`` are those that were known
    already, and where a ``problem`` says why it cannot be gone by.
    """

    session: int
    who: str
    texts: Texts
    view: View | None = None
    problem: str = ""


def read_answer(told: "pb.RigReport", camera: str, known: Texts) -> Answer:
    """The answer of whoever serves that camera; ``known`` are the texts of the rig by which it is taken now."""
    texts = (told.rig_yaml, told.camera_yaml, dict(told.offset_yaml), dict(told.files))
    answer = Answer(told.session, f"process {told.pid} on {told.host}", texts)
    if texts == known and told.protocol == PROTOCOL:
        return answer
    tables = [text for text in told.files.values() if text.startswith(heights_file.BEGIN)]
    whole = sum(map(len, (told.rig_yaml, told.camera_yaml, *told.offset_yaml.values(), *told.files.values())))
    if whole - sum(map(len, tables)) > MOST_TEXT or sum(map(len, tables)) > MOST_TABLE:
        return answer._replace(problem=f"its rig is longer than {MOST_TEXT} characters; expected that of a camera")
    read = _read(
        Told(told.protocol, told.rig_yaml, told.camera_yaml, *map(_rows, (told.offset_yaml, told.files))), camera
    )
    return answer._replace(problem=read) if isinstance(read, str) else answer._replace(view=read)


class Told(NamedTuple):
    """What a rig is read from: the same is not read twice, also where it cannot be gone by."""

    protocol: int
    rig_yaml: str
    camera_yaml: str
    offset_yaml: tuple[tuple[str, str], ...]
    files: tuple[tuple[str, str], ...]


def _rows(texts: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    return tuple(sorted(texts.items()))


def _read(told: Told, camera: str) -> View | str:
    """The view, or why there is none. One at a time: long ones would take the loop's processor from it."""
    with _READING:
        return _read_once(told, camera)


@lru_cache(maxsize=MOST_READ)
def _read_once(told: Told, camera: str) -> View | str:
    try:
        return _view_of(told, camera)
    except InputError as error:
        return str(error)


def _view_of(told: Told, camera: str) -> View:
    where = f"camera '{camera}'"
    if told.protocol != PROTOCOL:
        older = "here" if told.protocol > PROTOCOL else "there"
        raise InputError(
            f"{where}: its server speaks protocol {max(told.protocol, 1)}, this program {PROTOCOL}, expected the same: "
            f"update asterism-localization {older}"
        )
    view = view_of(parse_rig(told.rig_yaml, told.camera_yaml, where, dict(told.offset_yaml), dict(told.files)), where)
    if view.camera != camera:
        raise InputError(f"{where}: who answers for its rig has one of camera '{view.camera[:40]}'")
    return view
