"""A camera's name belongs to one server: who has it is asked before, and looked out for afterwards."""

import threading
from collections.abc import Callable
from datetime import datetime

import zenoh

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_beat, decode_rig
from asterism.protocol.errors import InputError
from asterism.server.service.publish import Publisher

ANSWER_S = 2.0  # a server that does not answer for so long is dead
HEARD_S = 2.0  # in which a beat must have come round


def refuse_a_taken_name(session: zenoh.Session, camera: str, prefix: str = "") -> None:
    """Raises InputError when a server of that camera answers; one that does not within `ANSWER_S` is dead."""
    for reply in session.get(prefix + keys.rig(camera), timeout=ANSWER_S):
        if reply.ok is None:
            continue
        try:
            told = decode_rig(reply.ok.payload.to_bytes())
        except InputError:
            continue  # whoever that is, it is no server of ours
        if camera == keys.FUSED:
            raise InputError(f"asterism fuse is running already, by {_who(told)}; stop that one first")
        raise InputError(
            f"camera '{camera}' is being served already, by {_who(told)}; stop that one first, or give "
            "this camera another camera_name"
        )


def _who(told: "pb.RigReport") -> str:
    if not told.pid:
        return f"a server of version {told.version or '0.1'}"
    return f"process {told.pid} on {told.host or 'a host without a name'} since {_clock(told.started_ns)}"


def _clock(time_ns: int) -> str:
    return f"{datetime.fromtimestamp(time_ns * 1e-9).astimezone():%Y-%m-%d %H:%M:%S}"


def refuse_to_go_unheard(publisher: Publisher, listener: zenoh.Session, where: str) -> None:
    """Raises InputError when none of the publisher's beats reaches ``listener``, another session at the same place,
    ``where`` a person said it.
    """
    heard = threading.Event()
    with listener.declare_subscriber(publisher.beat_key, lambda _: heard.set()):
        if not heard.wait(HEARD_S):
            raise InputError(
                f"{where}: what is published there reaches nobody (a server's own listener carries its own "
                "keys only; a router may have rules); expected a zenoh router that lets this program publish "
                f"{publisher.beat_key.rpartition('/')[0]}/**"
            )


class Rivals:
    """Looks out for another server of the same camera; of two, the one that was started later has to end.

    ``end`` is called, once, when that is this one; ``sentence`` says why then.
    """

    def __init__(self, session: zenoh.Session, publisher: Publisher, end: Callable[[], None]) -> None:
        self.sentence = ""
        self._publisher = publisher
        self._end = end
        self._another = "another server of this camera"
        if publisher.camera == keys.FUSED:
            self._another = "another asterism fuse"
        self._subscriber = session.declare_subscriber(
            publisher.beat_key, self._beat, allowed_origin=zenoh.Locality.REMOTE
        )

    def close(self) -> None:
        """Look no more."""
        self._subscriber.undeclare()

    def _beat(self, sample: zenoh.Sample) -> None:
        try:
            beat = decode_beat(sample.payload.to_bytes())
        except InputError:
            return
        # One that does not say since when it runs is of nobody that could have been there first.
        if self.sentence or not beat.started_ns or (beat.started_ns, beat.session) >= self._publisher.age_key:
            return
        self.sentence = (
            f"{self._another} is on the network, since {_clock(beat.started_ns)} "
            f"({sample.key_expr}); it was there first, so this one ends"
        )
        self._end()
