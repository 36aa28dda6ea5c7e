"""What Foxglove and PlotJuggler get, read by a client that decodes by the schemas it is told alone."""

import contextlib
import socket
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed (pip install '.[foxglove]')")

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.messages import EVENT, FRAME_REPORT, ODOMETRY, STATUS, Message
from asterism.protocol.rig import Rig, load_rig
from asterism.server.chain.frame import Frame
from asterism.server.service.foxglove_outlet import FRAMES_BEHIND, FoxgloveOutlet
from asterism.server.service.loopback import free_port
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.foxglove_client import FoxgloveClient, Heard
from tests.service.published import published

FRAMES = 3
FLOOD = 800  # frames, some 10 MB: more than all buffers between the two hold
CAMERA = "demo"
FRAME, IMAGE, ANNOTATIONS = keys.frame(CAMERA), keys.image(CAMERA), keys.annotations(CAMERA)

Told = list[tuple[list[Message], Frame]]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(DEMO_RIG)


@pytest.fixture(scope="module")
def told(rig: Rig) -> Told:
    return list(published(rig, FRAMES))


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def outlet(rig: Rig, port: int) -> Iterator[FoxgloveOutlet]:
    outlet = FoxgloveOutlet(rig, port)
    yield outlet
    outlet.close()


def status(time_ns: int) -> Message:
    payload = to_bytes(pb.Status(frames=5))
    return Message(keys.status(CAMERA), STATUS, payload, time_ns, time_ns, 0)


def subscribed(client: FoxgloveClient, outlet: FoxgloveOutlet) -> list[Heard]:
    """Once what a status brings along comes, the client's subscriptions hold. What came by then."""
    client.wait_for(lambda: bool(client.topics))
    for k in range(1, 1000):
        outlet.between([status(k)])
        with contextlib.suppress(TimeoutError):
            return client.until(keys.calibration(CAMERA), timeout_s=0.05)
    raise AssertionError("nothing comes")


def test_the_channels_are_those_of_a_recording(outlet: FoxgloveOutlet, port: int, rig: Rig) -> None:
    with FoxgloveClient(port) as client:
        client.wait_for(lambda: len(client.topics) >= len(rig.robots) + 7)
        assert client.topics == {
            **{keys.odometry(CAMERA, robot.id): "foxglove.Odometry" for robot in rig.robots},
            FRAME: "asterism.FrameReport",
            keys.status(CAMERA): "asterism.Status",
            keys.event(CAMERA): "asterism.Event",
            "/tf": "foxglove.FrameTransforms",
            keys.calibration(CAMERA): "foxglove.CameraCalibration",
            ANNOTATIONS: "foxglove.ImageAnnotations",
            IMAGE: "foxglove.CompressedImage",
        }


def test_what_is_published_is_what_is_shown(outlet: FoxgloveOutlet, port: int, rig: Rig, told: Told) -> None:
    with FoxgloveClient(port) as client:
        heard = subscribed(client, outlet)
        for messages, frame in told:
            outlet.write(messages, frame)
            heard += client.until(ANNOTATIONS, frame.exposed_ns)
        bytes_heard = [one for one in heard if one.topic == FRAME or one.topic.endswith("/odometry")]
        assert bytes_heard == [Heard(m.key, m.log_ns, m.payload) for messages, _ in told for m in messages]
        assert len(bytes_heard) == FRAMES * (len(rig.robots) + 1)
        frames = {one.log_ns: client.decode(one) for one in heard if one.topic == FRAME}
        for one in heard:
            if one.topic.endswith("/odometry"):
                odometry = client.decode(one)
                robot = next(r for r in frames[one.log_ns].robots if r.id == odometry.body_frame_id)
                for field in ("x", "y", "z"):
                    assert getattr(odometry.pose.position, field) == getattr(robot.pose.position, field)


def test_events_come_as_they_were_told(outlet: FoxgloveOutlet, port: int) -> None:
    told = Message(keys.event(CAMERA), EVENT, to_bytes(pb.Event(robot="alpha", reason="hidden")), 7, 7, 0)
    with FoxgloveClient(port) as client:
        subscribed(client, outlet)
        outlet.between([told])
        assert client.until(told.key, told.log_ns)[-1].payload == told.payload


def test_transforms_annotations_and_calibration_are_of_the_same_frame(
    outlet: FoxgloveOutlet, port: int, rig: Rig, told: Told
) -> None:
    messages, frame = told[-1]
    with FoxgloveClient(port) as client:
        first = {one.topic: client.decode(one) for one in subscribed(client, outlet)}
        outlet.write(messages, frame)
        heard = {one.topic: client.decode(one) for one in client.until(ANNOTATIONS, frame.exposed_ns)}
    np.testing.assert_array_equal(first[keys.calibration(CAMERA)].K, rig.camera.matrix.ravel())
    children = {t.child_frame_id: t for t in heard["/tf"].transforms}
    points = {f"{robot.id}/{name}" for robot in rig.robots for name in robot.points}
    assert children.keys() == {robot.id for robot in rig.robots} | points
    for robot in heard[FRAME].robots:
        assert children[robot.id].parent_frame_id == heard[FRAME].frame_id == "world"
        assert children[robot.id].translation.x == robot.pose.position.x
    circles, spots = heard[ANNOTATIONS].circles, heard[FRAME].spots
    np.testing.assert_array_equal([c.position.x for c in circles], spots.x)
    names = {text.text.split()[0] for text in heard[ANNOTATIONS].texts if " " in text.text}
    assert names == {robot.id for robot in rig.robots}


def test_the_image_is_the_frames_but_for_what_jpeg_takes(outlet: FoxgloveOutlet, port: int, told: Told) -> None:
    messages, frame = told[0]
    with FoxgloveClient(port) as client:
        subscribed(client, outlet)
        outlet.write(messages, frame)
        image = client.decode(client.until(IMAGE)[-1])
    assert (image.frame_id, image.format, image.timestamp.nanos) == (CAMERA, "jpeg", frame.exposed_ns % 10**9)
    shown = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown.shape == frame.image.shape
    assert np.abs(shown.astype(int) - frame.image).mean() < 2.0


def test_a_client_that_never_reads_holds_up_nobody(outlet: FoxgloveOutlet, port: int, told: Told) -> None:
    with FoxgloveClient(port) as stuck, FoxgloveClient(port) as client:
        subscribed(stuck, outlet)
        subscribed(client, outlet)
        for k in range(FLOOD):
            messages, frame = told[k % FRAMES]
            later = [replace(message, log_ns=10 + k) for message in messages]
            outlet.write(later, frame)
            if k % FRAMES_BEHIND == 0:
                client.until(FRAME, 10 + k)
        last = client.until(FRAME, 10 + k)[-1]
        assert last.payload == told[k % FRAMES][0][-1].payload
        # What the one that was stuck finds, once it reads: the newest, and not all that there was.
        missed = FLOOD - sum(one.topic == FRAME for one in stuck.until(FRAME, 10 + k))
        assert missed > 0


def test_another_rig_has_its_own_robots(outlet: FoxgloveOutlet, port: int, rig: Rig, told: Told) -> None:
    gone, *left = rig.robots
    new = replace(gone, id="new")
    with FoxgloveClient(port) as client:
        subscribed(client, outlet)
        outlet.take_rig(replace(rig, robots=(*left, new)))
        messages = [message for message in told[0][0] if message.kind in (ODOMETRY, FRAME_REPORT)]
        outlet.write([message for message in messages if not message.key.endswith(f"/{gone.id}/odometry")], told[0][1])
        key = keys.odometry(CAMERA, new.id)
        client.wait_for(lambda: key in client.topics and keys.odometry(CAMERA, gone.id) not in client.topics)


def test_it_listens_on_loopback_only_and_a_port_in_use_is_refused(outlet: FoxgloveOutlet, port: int, rig: Rig) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.2", port))  # free: not all addresses are listened on
    with pytest.raises(InputError, match=rf"--foxglove {port}: .*expected a free port") as refused:
        FoxgloveOutlet(rig, port)
    assert "\n" not in str(refused.value)


def test_who_connects_and_is_no_client_is_nobodys_trouble(
    outlet: FoxgloveOutlet, port: int, told: Told, rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(5):
        with socket.create_connection(("127.0.0.1", port), timeout=5.0) as stranger, contextlib.suppress(OSError):
            stranger.sendall(b"GET / HTTP/1.1\r\n\r\n" + rng.bytes(1000))
            while stranger.recv(4096):
                pass
    assert [record.getMessage() for record in caplog.records] == []
    with FoxgloveClient(port) as client:
        subscribed(client, outlet)
        outlet.write(*told[0])
        assert client.until(FRAME, told[0][1].exposed_ns)
