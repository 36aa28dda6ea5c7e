"""Going on the air: a session, a name that nobody else has, a publisher that is heard."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import zenoh

from asterism.protocol.codec import encode_rig
from asterism.protocol.errors import InputError
from asterism.protocol.network import DEFAULT_ENDPOINT, client_config, joins, open_server
from asterism.protocol.rig import Rig
from asterism.server.service.names import Rivals, refuse_a_taken_name, refuse_to_go_unheard
from asterism.server.service.publish import Clock, Publisher
from asterism.server.service.say import say
from asterism.server.service.uplink import Uplink


class Place(NamedTuple):
    """Where on the network, as a person said it: an endpoint to listen on, or one to join, and a file of options; with
    ROS 2's nodes there, which of its keys are the server's own. ``joining`` is the option that names one to join.
    """

    listen: str | None = None
    connect: str | None = None
    options: Path | None = None
    ros_keys: tuple[str, ...] | None = None
    joining: str = "--connect"

    def __str__(self) -> str:
        return str(self.connect or self.listen or self.options or DEFAULT_ENDPOINT)


class OnAir(NamedTuple):
    """A server's place on the network."""

    session: zenoh.Session
    publisher: Publisher
    rivals: Rivals


def on_air(
    place: Place, rig: Rig, clock: Clock, end: Callable[[], None], prefix: str = ""
) -> AbstractContextManager[OnAir]:
    """Publish what a rig's camera shows at that place, as `on_air_as`."""
    return on_air_as(rig.camera.name, encode_rig(rig), place, clock, end, prefix)


@contextmanager
def on_air_as(
    name: str, rig_payload: bytes, place: Place, clock: Clock, end: Callable[[], None], prefix: str = ""
) -> Iterator[OnAir]:
    """Publish under a camera's name at that place until the context ends; the rig is answered for with the payload.

    ``end`` is called when another server of the same camera turns out to have been there first. Raises InputError for
    an endpoint that cannot be used, a name that is taken, a place where nobody would hear; WorldError where nothing
    answers.
    """
    if place.listen and place.connect:
        raise InputError(
            f"--listen and {place.joining} exclude each other; {place.joining} joins what is there as a client"
        )
    session = open_server(*place)
    try:
        refuse_a_taken_name(session, name, prefix)
    except BaseException:
        session.close()
        raise
    with ExitStack() as stack:
        publisher = stack.enter_context(Publisher(session, name, rig_payload, clock, prefix))
        if joins(place.connect, place.options):
            with zenoh.open(client_config(place.connect, place.options)) as listener:
                refuse_to_go_unheard(publisher, listener, f"{place.joining} {place}")
            stack.callback(Uplink(session, str(place), say).close)
        rivals = Rivals(session, publisher, end)
        stack.callback(rivals.close)
        yield OnAir(session, publisher, rivals)
