"""What a client of OptiTrack's protocol that nobody here wrote (PyPI natnet) gets."""

import contextlib
import socket
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("natnet", reason="natnet is not installed (pip install '.[dev]')")

from natnet import NatNetClient

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import set_report_pose, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.service.natnet.address import address
from asterism.server.service.natnet.outlet import NatNet
from tests.clients.serving import until
from tests.helpers import random_pose
from tests.rigs import FOCAL_PX, make_rig

RIG = make_rig(3, T_world_camera=Pose(np.array([0.0, 0.0, 1.25]), np.array([1.0, 0.0, 0.0, 0.0])))
EXPOSED_NS = 1_800_000_000_123_456_789
FRAMES = 20
HOST = "127.0.0.1"


class Client:
    """natnet's client, and what it received."""

    def __init__(self, port: int) -> None:
        self.client = NatNetClient(HOST, HOST, command_port=port, use_multicast=False)
        self.frames: list[Any] = []
        self.descriptions: list[Any] = []
        self.client.on_data_frame_received_event.handlers.append(self.frames.append)
        self.client.on_data_description_received_event.handlers.append(self.descriptions.append)
        self.client.connect()

    def has(self, received: list[Any], count: int) -> bool:
        self.client.update_sync()
        return len(received) >= count


@contextlib.contextmanager
def serving(rig: Rig = RIG) -> Iterator[tuple[NatNet, Client]]:
    """The outlet, and a client that has connected."""
    outlet = NatNet(rig, HOST, 0)
    client = Client(outlet.port)
    try:
        yield outlet, client
    finally:
        client.client.shutdown()
        outlet.close()


def write(outlet: NatNet, number: int, poses: dict[str, Pose | None]) -> None:
    report = pb.FrameReport(
        sequence=number, exposed_ns=EXPOSED_NS + number, arrived_ns=EXPOSED_NS + 5, published_ns=EXPOSED_NS + 9
    )
    for robot, pose in poses.items():
        told = report.robots.add(id=robot, rms_px=0.25, state=pb.TRACKED if pose else pb.LOST)
        if pose is not None:
            set_report_pose(told.pose, pose)
    messages = [Message("frame", FRAME_REPORT, to_bytes(report), report.exposed_ns, report.published_ns, number)]
    outlet.write(messages, Frame(np.zeros((4, 4), np.uint8), number, report.exposed_ns))


def test_a_client_finds_the_rigid_bodies_and_their_poses(rng: np.random.Generator) -> None:
    with serving() as (outlet, client):
        assert client.client.server_info.application_name == "Asterism"
        assert str(client.client.protocol_version) == "3.1.0.0"
        client.client.request_modeldef()
        until(lambda: client.has(client.descriptions, 1))
        sent = [{robot.id: random_pose(rng) for robot in RIG.robots} for _ in range(FRAMES)]
        for number, poses in enumerate(sent):
            write(outlet, number, {**poses, "r01": None} if number == 7 else dict(poses))
        until(lambda: client.has(client.frames, FRAMES))
    found = client.descriptions[0].rigid_bodies
    assert [(body.id_num, body.name) for body in found] == [(1, "r00"), (2, "r01"), (3, "r02")]
    for body, robot in zip(found, RIG.robots, strict=True):
        np.testing.assert_allclose([marker.pos for marker in body.markers], robot.leds, rtol=1e-6)
    assert [frame.prefix.frame_number for frame in client.frames] == list(range(FRAMES))
    for number, (frame, poses) in enumerate(zip(client.frames, sent, strict=True)):
        assert [body.id_num for body in frame.rigid_bodies] == [1, 2, 3]
        for body, (robot, pose) in zip(frame.rigid_bodies, poses.items(), strict=True):
            if number == 7 and robot == "r01":
                assert not body.tracking_valid
                assert np.isnan([*body.pos, *body.rot]).all()
                continue
            assert body.tracking_valid
            np.testing.assert_allclose(body.pos, pose.position, rtol=1e-6)
            np.testing.assert_allclose(body.rot, pose.orientation, rtol=1e-6, atol=1e-7)
            away_m = np.linalg.norm(pose.position - [0.0, 0.0, 1.25])
            assert body.marker_error == pytest.approx(0.25 * away_m / FOCAL_PX, rel=1e-6)
        stamps = frame.suffix.stamp_camera_mid_exposure, frame.suffix.stamp_data_received, frame.suffix.stamp_transmit
        assert stamps == (EXPOSED_NS + number, EXPOSED_NS + 5, EXPOSED_NS + 9)
        assert frame.suffix.timestamp == pytest.approx(1_800_000_000.123456789, abs=1e-6)
        assert not frame.suffix.tracked_models_changed


def test_another_rig_has_other_bodies_and_the_client_is_told(rng: np.random.Generator) -> None:
    with serving() as (outlet, client):
        outlet.take_rig(replace(RIG, robots=RIG.robots[1:]))
        for number in range(2):
            write(outlet, number, {"r01": random_pose(rng), "r02": None})
        client.client.request_modeldef()
        until(lambda: client.has(client.frames, 2) and client.has(client.descriptions, 1))
    assert [body.name for body in client.descriptions[0].rigid_bodies] == ["r01", "r02"]
    assert [frame.suffix.tracked_models_changed for frame in client.frames] == [True, False]
    assert [body.tracking_valid for body in client.frames[0].rigid_bodies] == [True, False]


def test_nothing_is_sent_to_who_did_not_call_or_has_left(rng: np.random.Generator) -> None:
    with serving() as (outlet, client), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(20.0)
        other.sendto(b"\x02\x00\x04\x00what", (HOST, outlet.port))  # a request is no call
        assert other.recv(100) == b"\x64\x00\x00\x00"  # 100: it is not known
        for damaged in (b"", b"\x00", b"\x00\x00\xff\xff", rng.bytes(50)):
            other.sendto(damaged, (HOST, outlet.port))
        other.sendto(b"\x0a\x00\x00\x00", (HOST, outlet.port))
        until(lambda: len(outlet._audience.now()) == 2)
        other.sendto(b"\x09\x00\x00\x00", (HOST, outlet.port))
        until(lambda: len(outlet._audience.now()) == 1)
        write(outlet, 0, {"r00": random_pose(rng)})
        until(lambda: client.has(client.frames, 1))
        other.setblocking(False)
        with pytest.raises(BlockingIOError):
            other.recv(1000)


def test_addresses_are_read_and_others_refused() -> None:
    assert address("127.0.0.1") == ("127.0.0.1", 1510)
    assert address("10.0.0.7:2000") == ("10.0.0.7", 2000)
    for text in ("", "localhost", "rig.yaml", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:70000", "::1", "224.0.0.1"):
        with pytest.raises(InputError, match="expected an IPv4 address"):
            address(text)


def test_a_port_that_is_taken_and_a_foreign_address_are_refused() -> None:
    with (
        serving() as (outlet, _),
        pytest.raises(InputError, match=f"--natnet {HOST}:{outlet.port}: cannot be listened"),
    ):
        NatNet(RIG, HOST, outlet.port)
    with pytest.raises(InputError, match="expected an address of this machine"):
        NatNet(RIG, "192.0.2.77", 1510)
