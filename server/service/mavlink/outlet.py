"""The outlet `serve --mavlink ROBOT=HOST:PORT`: poses to a robot's flight controller, and the time where it asks."""

import socket

from asterism.protocol.codec import decode_odometry
from asterism.protocol.errors import InputError
from asterism.protocol.messages import ODOMETRY, STATUS, Message
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.service.hearing import Hearing
from asterism.server.service.mavlink.endpoint import WORLD, Endpoint, joined, systems_of
from asterism.server.service.mavlink.link import Link
from asterism.server.service.publish import Clock
from asterism.server.service.say import complain, say
from asterism.server.service.threads import Newest

MOST_WAITING = 30  # frames: a pose that is older is worth nothing to who flies by it


class Mavlink:
    """Sends to these endpoints until it is closed; ``clock`` is the one that stamps poses.

    Raises InputError as `systems_of` does, and for a host that is none.
    """

    def __init__(self, rig: Rig, endpoints: list[Endpoint], clock: Clock) -> None:
        systems = systems_of(endpoints, rig)
        self._links: list[Link] = []
        try:
            for where, system in zip(endpoints, systems, strict=True):
                self._links.append(Link(where.robot, system, joined(where)))
        except InputError:
            self._hang_up()
            raise
        self._rig = rig
        self._clock = clock
        self._sending: Newest[list[Message]] = Newest(self._send, "mavlink", MOST_WAITING)
        self._by_socket = {link.to: link for link in self._links}
        self._hearing = Hearing(self._by_socket, self._answer, "mavlink-time")
        for where, system in zip(endpoints, systems, strict=True):
            say(f"MAVLink to {where.host}:{where.port}: {where.robot}, as system {system}")

    def write(self, messages: list[Message], frame: Frame) -> None:  # noqa: ARG002
        """Send the frame's poses when it is their turn."""
        self._sending.give(messages)

    def between(self, messages: list[Message]) -> None:
        """Send a heartbeat."""
        self._sending.give(messages)

    def take_rig(self, rig: Rig) -> None:
        """Poses by another rig may jump; whose poses it takes away is said, since who flies by them hears nothing."""
        self._rig = rig
        known = {robot.id for robot in rig.robots} if rig.parent_frame == WORLD else set()
        if gone := [link.robot for link in self._links if link.robot not in known]:
            why = "the rig has no `world` now" if not known else "the rig has it no more"
            complain(f"MAVLink: no pose goes out of {', '.join(gone)}: {why}")

    def close(self) -> None:
        """Send what waits, and no more."""
        self._sending.close(rest=True)
        self._hearing.close()
        self._hang_up()
        unsent = sum(link.unsent for link in self._links)
        if unsent or self._sending.dropped:
            say(f"MAVLink: {unsent} messages could not be sent, {self._sending.dropped} frames waited too long")

    def _hang_up(self) -> None:
        for link in self._links:
            link.to.close()

    def _send(self, messages: list[Message]) -> None:
        for message in messages:
            if message.kind == ODOMETRY:
                told = decode_odometry(message.payload)
                if told.frame_id == WORLD:  # a rig that was read again may have none
                    for link in self._links:
                        if link.robot == told.robot:
                            link.pose(told, self._rig)
            elif message.kind == STATUS:
                for link in self._links:
                    link.alive()

    def _answer(self, asked: socket.socket) -> None:
        """Tell who asks what time it is by the clock that stamps poses."""
        self._by_socket[asked].answer(self._clock.now_ns())
