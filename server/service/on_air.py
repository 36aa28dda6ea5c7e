"""Going on the air: a session, a name that nobody else has, a publisher that is heard."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import zenoh

from asterism.protocol.codec import encode_rig
from asterism.protocol.errors import InputError
from asterism.protocol.network import DEFAULT_ENDPOINT, client_config, joins, open_server
from asterism.protocol.rig import Rig
from asterism.server.service.names import Rivals, refuse_a_taken_name, refuse_to_go_unheard
from asterism.server.service.publish import Clock, Publisher


class Place(NamedTuple):
    """Where on the network, as a person said it: an endpoint to listen on, or one to join, and a file of options; with
    ROS 2's nodes there, which of its keys are the server's own.
    """

    listen: str | None = None
    connect: str | None = None
    options: Path | None = None
    ros_keys: tuple[str, ...] | None = None

    def __str__(self) -> str:
        return str(self.connect or self.listen or self.options or DEFAULT_ENDPOINT)


class OnAir(NamedTuple):
    """A server's place on the network."""

    session: zenoh.Session
    publisher: Publisher
    rivals: Rivals


@contextmanager
def on_air(place: Place, rig: Rig, clock: Clock, end: Callable[[], None], prefix: str = "") -> Iterator[OnAir]:
    """Publish at that place until the context ends.

    ``end`` is called when another server of the same camera turns out to have been there first. Raises InputError for
    an endpoint that cannot be used, a name that is taken, a place where nobody would hear; WorldError where nothing
    answers.
    """
    if place.listen and place.connect:
        raise InputError("--listen and --connect exclude each other; --connect joins what is there as a client")
    session = open_server(*place)
    try:
        refuse_a_taken_name(session, rig.camera.name, prefix)
    except BaseException:
        session.close()
        raise
    with Publisher(session, rig.camera.name, encode_rig(rig), clock, prefix) as publisher:
        if joins(place.connect, place.options):
            with zenoh.open(client_config(place.connect, place.options)) as listener:
                refuse_to_go_unheard(publisher, listener, str(place))
        rivals = Rivals(session, publisher, end)
        try:
            yield OnAir(session, publisher, rivals)
        finally:
            rivals.close()
