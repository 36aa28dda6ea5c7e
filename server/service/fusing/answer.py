"""What a camera's server answers when it is asked for its rig, read beside the loop: that takes a tenth of a second."""

from typing import NamedTuple

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.errors import InputError
from asterism.protocol.messages import PROTOCOL
from asterism.protocol.rig import parse_rig
from asterism.server.fusing.fitting import view_of
from asterism.server.fusing.fleet import View

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
    try:
        return answer._replace(view=_view_of(told, camera))
    except InputError as error:
        return answer._replace(problem=str(error))


def _view_of(told: "pb.RigReport", camera: str) -> View:
    where = f"camera '{camera}'"
    if told.protocol != PROTOCOL:
        older = "here" if told.protocol > PROTOCOL else "there"
        raise InputError(
            f"{where}: its server speaks protocol {max(told.protocol, 1)}, this program {PROTOCOL}, expected the same: "
            f"update asterism-localization {older}"
        )
    view = view_of(parse_rig(told.rig_yaml, told.camera_yaml, where, told.offset_yaml, told.files), where)
    if view.camera != camera:
        raise InputError(f"{where}: who answers for its rig has one of camera '{view.camera[:40]}'")
    return view
