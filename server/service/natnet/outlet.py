"""The outlet `serve --natnet`: answers NatNet's clients, and sends each of them every frame by itself (unicast)."""

import contextlib
import re
import socket

import numpy as np

from asterism import __version__
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_frame_report, report_pose
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.service.hearing import Hearing
from asterism.server.service.natnet import wire
from asterism.server.service.natnet.audience import Address, Audience
from asterism.server.service.say import say
from asterism.server.service.threads import Newest

NAME = "Asterism"
MOST_WAITING = 30  # frames


class NatNet:
    """Serves at that address until it is closed. Raises InputError for one that cannot be had."""

    def __init__(self, rig: Rig, host: str, port: int) -> None:
        self._rig = self._told_rig = rig
        self._socket = _bound(host, port)
        self.port: int = self._socket.getsockname()[1]
        self._audience = Audience()
        self._sending: Newest[tuple[bytes, Rig]] = Newest(self._send, "natnet", MOST_WAITING)
        self._hearing = Hearing([self._socket], self._answer, "natnet-calls")
        say(f"NatNet {wire.VERSION[0]}.{wire.VERSION[1]} at {host}:{self.port}, to each client by itself (unicast)")

    def write(self, messages: list[Message], frame: Frame) -> None:  # noqa: ARG002
        """Send the frame when it is its turn."""
        for message in messages:
            if message.kind is FRAME_REPORT:
                self._sending.give((message.payload, self._rig))

    def between(self, messages: list[Message]) -> None:
        """The protocol has no place for it."""

    def take_rig(self, rig: Rig) -> None:
        """Its robots are the rigid bodies of the frames from now on."""
        self._rig = rig

    def close(self) -> None:
        """Send what waits, and no more."""
        self._sending.close(rest=True)
        self._hearing.close()
        self._socket.close()
        if self._sending.dropped:
            say(f"NatNet did not keep up: {self._sending.dropped} frames were left out")

    def _send(self, given: tuple[bytes, Rig]) -> None:
        payload, rig = given
        changed, self._told_rig = rig is not self._told_rig, rig
        clients = self._audience.now()
        if not clients:
            return
        report = decode_frame_report(payload)
        times = wire.Times(report.exposed_ns, report.arrived_ns, report.published_ns)
        told = wire.frame(report.sequence, bodies(report, rig), times, changed)
        for client in clients:
            with contextlib.suppress(OSError):  # who is gone is forgotten when it has not called for a while
                self._socket.sendto(told, client)

    def _answer(self, called: socket.socket) -> None:
        datagram, client = called.recvfrom(wire.LONGEST)
        self._take(datagram, client)

    def _take(self, datagram: bytes, client: Address) -> None:
        match wire.kind_of(datagram):
            case None:
                return
            case wire.Id.DISCONNECT:
                self._audience.leaves(client)
                return
            case wire.Id.CONNECT | wire.Id.KEEP_ALIVE as kind:
                room = self._audience.joins(client)
                if kind == wire.Id.KEEP_ALIVE or not room:
                    return
                version = [int(part) for part in re.findall(r"\d{1,2}", __version__)]
                answer = wire.server_info(NAME, version, self.port)
            case wire.Id.REQUEST_DESCRIPTIONS:
                answer = wire.descriptions(self._rig.robots)
            case _:
                answer = wire.message(wire.Id.UNRECOGNIZED)
        self._socket.sendto(answer, client)


def bodies(report: "pb.FrameReport", rig: Rig) -> list[wire.Body]:
    """The robots of a frame as rigid bodies. Where a report's are not the rig's, because it was read again just now,
    they keep its names' numbers.
    """
    numbers = {robot.id: number for number, robot in enumerate(rig.robots, start=1)}
    eye = np.zeros(3) if rig.T_world_camera is None else rig.T_world_camera.position
    told = []
    for robot in report.robots:
        pose = report_pose(robot.pose) if robot.HasField("pose") else None
        away_m = 0.0 if pose is None else float(np.linalg.norm(pose.position - eye))
        if robot.id in numbers:
            error_m = robot.rms_px * away_m / float(rig.camera.matrix[0, 0])
            told.append(wire.Body(numbers[robot.id], pose, error_m))
    return told


def _bound(host: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.bind((host, port))
    except OSError as error:
        made.close()
        raise InputError(
            f"--natnet {host}:{port}: cannot be listened on ({error.strerror}); expected an address of this machine "
            "and a free UDP port"
        ) from None
    return made
