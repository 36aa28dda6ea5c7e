"""Images on a topic of ROS 2: messages as ROS writes them, whatever hash they tell, and the calibration beside them."""

import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
import zenoh

from asterism.protocol.camera import Camera
from asterism.protocol.errors import InputError
from asterism.protocol.messages import Clock
from asterism.protocol.network import client_config, open_server
from asterism.protocol.ros2 import types
from asterism.protocol.ros2.wire import topic_key
from asterism.server.chain.frame import Frame
from asterism.server.service.ros2.told_camera import apart, difference
from asterism.server.sources.foreign.ros_images import RosImages, info_topic
from asterism.server.sources.foreign.ros_messages import CameraInfoTold
from asterism.server.sources.open_source import open_source, refuse_endless
from tests.clients.serving import until
from tests.rigs import make_camera, make_rig
from tests.servers import free_endpoint
from tests.sources.foreign.foreign_files import ROS2, camera_info, ros_compressed, ros_image

RIG = make_rig(2, camera=make_camera(64, 48, 80.0))
TOPIC, DOMAIN = "/front/image_raw", 5
IMAGE = np.random.default_rng(3).integers(0, 256, (48, 64)).astype(np.uint8)
S = 10**9


def written(message: object) -> bytes:
    return bytes(ROS2.serialize_cdr(message, message.__msgtype__))  # type: ignore[attr-defined]


def image(stamp_ns: int) -> bytes:
    return written(ros_image(IMAGE, stamp_ns))


def info(camera: Camera, sec: int = 0) -> bytes:
    told = camera_info(camera.matrix.ravel().tolist(), camera.distortion.tolist(), (camera.width, camera.height))
    payload = written(told)
    return payload[:4] + sec.to_bytes(4, "little") + payload[8:]


class Topic:
    """A server's session with a source in it, and a node's that publishes."""

    def __init__(self, topic: str = TOPIC) -> None:
        endpoint = free_endpoint()
        self.topic = topic
        self.server = open_server(endpoint)
        self.said: list[str] = []
        source = open_source(f"ros2:{topic}", RIG, self.said.append, ros_domain=DOMAIN)
        assert isinstance(source, RosImages)
        self.source = source
        source.compare = partial(difference, RIG.camera)
        source.join(self.server, listens=True)
        self.node = zenoh.open(client_config(endpoint))
        self.frames: list[Frame] = []
        self._thread = threading.Thread(target=self._take)
        self._thread.start()

    def _take(self) -> None:
        for frame in self.source.frames():
            self.frames.append(frame)

    def put(self, kind: types.RosType, payload: bytes, domain: int = DOMAIN, told_hash: str | None = None) -> None:
        topic = info_topic(self.topic) if kind is types.CAMERA_INFO else self.topic
        key = topic_key(domain, topic, kind)
        self.node.put(key if told_hash is None else f"{key.rpartition('/')[0]}/{told_hash}", payload)

    def close(self) -> None:
        self.source.close()
        self._thread.join()
        self.node.close()
        self.server.close()


@pytest.fixture
def topic() -> Iterator[Topic]:
    opened = Topic()
    yield opened
    opened.close()


def test_images_of_both_types_and_any_hash(topic: Topic) -> None:
    topic.put(types.IMAGE, image(10 * S), domain=DOMAIN + 1)
    topic.put(types.IMAGE, image(10 * S))
    png = cv2.imencode(".png", IMAGE)[1].tobytes()
    topic.put(types.COMPRESSED_IMAGE, written(ros_compressed(png, 10 * S + 20_000_000, "png")))
    topic.put(types.IMAGE, image(10 * S + 40_000_000), told_hash="TypeHashNotSupported")
    until(lambda: len(topic.frames) == 3)
    for frame in topic.frames:
        np.testing.assert_array_equal(frame.image, IMAGE)
        assert frame.clock == Clock.CAMERA


def test_what_is_no_image_is_counted_and_said(topic: Topic) -> None:
    good = image(10 * S)
    for bad in (b"", b"\x00\x01\x00\x00", good[:-1], good[:30], b"\x09" + good[1:]):
        topic.put(types.IMAGE, bad)
    topic.put(types.COMPRESSED_IMAGE, good)
    until(lambda: topic.source.unreadable + topic.source.missed >= 6)
    assert any("message 0: is no plain CDR" in text or "ends too early" in text for text in topic.said)
    topic.put(types.IMAGE, good)
    until(lambda: len(topic.frames) == 1)


def test_a_calibration_that_is_not_the_rigs_is_said_once(topic: Topic) -> None:
    assert "images of /front/image_raw from nodes with rmw_zenoh" in topic.said.pop()
    topic.put(types.CAMERA_INFO, info(RIG.camera))
    assert topic.said == []
    moved = RIG.camera.matrix.copy()
    moved[0, 0] *= 1.02
    for sec in range(3):
        topic.put(types.CAMERA_INFO, info(replace(RIG.camera, matrix=moved), sec))
    topic.put(types.CAMERA_INFO, info(replace(RIG.camera, width=128, height=96)))
    topic.put(types.CAMERA_INFO, info(RIG.camera)[:60])
    until(lambda: len(topic.said) >= 3)
    where = "ros2:/front/image_raw: /front/camera_info: "
    assert topic.said[0].startswith(f"{where}its calibration is not the rig's: up to ")
    assert f"fx {moved[0, 0]:.6g} instead of {RIG.camera.matrix[0, 0]:.6g}" in topic.said[0]
    assert topic.said[1:] == [
        f"{where}its calibration is for images of 128x96 px, the rig's for 64x48",
        f"{where}ends too early",
    ]


def test_drivers_of_lazy_cameras_see_that_somebody_listens(topic: Topic) -> None:
    found = topic.node.liveliness().get(f"@ros2_lv/{DOMAIN}/**")
    tokens = ["/".join(str(reply.ok.key_expr).split("/")[5:-1]) for reply in found if reply.ok is not None]
    node = "%/%/asterism_test_images"
    assert sorted(tokens) == [
        f"MS/{node}/%front%camera_info/{types.CAMERA_INFO.dds}/{types.CAMERA_INFO.hash}",
        f"MS/{node}/%front%image_raw/{types.IMAGE.dds}/{types.IMAGE.hash}",
        "NN/%/%",
    ]


@pytest.mark.parametrize(
    ("told", "info_at"),
    [
        ("/front/image_raw", "/front/camera_info"),
        ("/front/image_raw/compressed", "/front/camera_info"),
        ("/image", "/camera_info"),
    ],
)
def test_where_the_calibration_is_told(told: str, info_at: str) -> None:
    assert info_topic(told) == info_at


def test_how_far_calibrations_are_apart(rng: np.random.Generator) -> None:
    """Against the shift that a moved centre, or a longer focal length, makes of every pixel."""
    camera = make_camera()
    moved = camera.matrix.copy()
    moved[0, 2] += 3.0
    middle, most = apart(camera, replace(camera, matrix=moved))
    assert (middle, most) == pytest.approx((3.0, 3.0), abs=1e-9)
    longer = camera.matrix.copy()
    longer[:2] = 1.01 * longer[:2]
    longer[:2, 2] = camera.matrix[:2, 2]
    middle, most = apart(camera, replace(camera, matrix=longer))
    corners = np.array([[x, y] for x in (0, camera.width - 1) for y in (0, camera.height - 1)])
    assert most == pytest.approx(0.01 * np.linalg.norm(corners - camera.matrix[:2, 2], axis=1).max(), rel=1e-6)
    assert middle < 0.1


def test_a_driver_without_calibration_tells_nothing() -> None:
    nothing = CameraInfoTold("", 64, 48, "", np.zeros(0), np.zeros((3, 3)))
    assert difference(RIG.camera, nothing) is None


@pytest.mark.parametrize("bad", ["", "/", "front//image", "1st/image", "front/image raw", "front/*"])
def test_what_is_no_topic(bad: str) -> None:
    with pytest.raises(InputError, match="is no topic for ROS, expected a name such as /camera/image_raw"):
        open_source(f"ros2:{bad}", RIG, print)


def test_commands_for_films_refuse_it() -> None:
    with pytest.raises(InputError, match="ros2:/front: has no end; locate takes"):
        refuse_endless("ros2:/front", "locate")
