"""What a server publishes, as it arrives over the network, back into the messages that it records itself.

Times and numbers stand in the messages; only a status, and what tools covered, do not tell their own number.
"""

from typing import NamedTuple

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_coverage, decode_event, decode_frame_report, decode_odometry, decode_status
from asterism.protocol.errors import InputError
from asterism.protocol.messages import COVERAGE, EVENT, FRAME_REPORT, ODOMETRY, STATUS, Kind, Message
from asterism.recordings.decodable import is_decodable

KINDS: dict[str, Kind] = {
    "odometry": ODOMETRY, "frame": FRAME_REPORT, "status": STATUS, "event": EVENT, "coverage": COVERAGE,
}  # fmt: skip


class Arrived(NamedTuple):
    """A message of one camera in one session; ``told`` is what it holds, None for a pose."""

    camera: str
    session: int
    message: Message
    told: "pb.FrameReport | pb.Event | pb.Status | pb.Coverage | None" = None

    @property
    def robot(self) -> str:
        """Whose pose it is; empty for all else."""
        return (keys.robot_of(self.message.key) or "") if self.message.kind is ODOMETRY else ""


def expressions(prefix: str) -> list[str]:
    """What to subscribe to: all that servers publish but their beats."""
    of_cameras = (keys.odometry("*", "*"), keys.frame("*"), keys.status("*"), keys.event("*"), keys.coverage("*"))
    return [prefix + expression for expression in of_cameras]


def arrived(key: str, payload: bytes) -> Arrived:
    """The message under ``key``, which has no prefix. Raises InputError for one that no server makes."""
    camera, kind = key.split("/")[1], KINDS[key.rpartition("/")[2]]
    if not is_decodable(kind.schema, payload):
        raise _none(key, kind, payload)
    if kind is ODOMETRY:
        pose = decode_odometry(payload)
        message = Message(key, kind, payload, pose.exposed_ns, pose.published_ns, pose.sequence)
        return Arrived(camera, pose.session, message)
    told: pb.FrameReport | pb.Event | pb.Status | pb.Coverage
    if kind is FRAME_REPORT:
        told = decode_frame_report(payload)
        times = (told.exposed_ns, told.published_ns, told.sequence)
    elif kind is EVENT:
        told = decode_event(payload)
        times = (told.since_ns, told.published_ns, told.sequence)
    elif kind is COVERAGE:
        told = decode_coverage(payload)
        times = (told.exposed_ns, told.exposed_ns, 0)
    else:
        told = decode_status(payload)
        times = (told.time_ns, told.time_ns, 0)
    if not 0 < times[0] < 1 << 63:  # what is empty decodes as anything
        raise _none(key, kind, payload)
    return Arrived(camera, told.session, Message(key, kind, payload, *times), told)


def _none(key: str, kind: Kind, payload: bytes) -> InputError:
    return InputError(f"{key}: {len(payload)} bytes that are no {kind.schema} of a server")
