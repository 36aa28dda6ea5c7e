"""Bytes on the wire: golden files both ways, round trips, refusals, and the .proto beside the code made of it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.json_format import Parse

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.annotations import encode_annotations
from asterism.protocol.codec import (
    decode_frame_report,
    decode_image,
    decode_odometry,
    decode_rig,
    decode_status,
    encode_image,
    encode_odometry,
    in_session,
    stamped,
    to_bytes,
)
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message
from asterism.protocol.schemas import descriptor_set
from tests.helpers import REPOSITORY, assert_poses_close
from tests.protocol import make_golden


@pytest.mark.parametrize("name", make_golden.golden())
def test_golden_bytes(name: str) -> None:
    payload, kind = make_golden.golden()[name]
    assert payload == (make_golden.GOLDEN / f"{name}.bin").read_bytes()
    # And from what the JSON says, the same bytes again.
    told = (make_golden.GOLDEN / f"{name}.json").read_text()
    assert to_bytes(Parse(told, kind())) == payload


def test_messages_of_the_first_version_are_read() -> None:
    golden = make_golden.GOLDEN.parent / "1"
    pose = decode_odometry((golden / "odometry.bin").read_bytes())
    assert (pose.robot, pose.sequence, pose.session) == ("alpha", 42, 0)
    assert pose.published_ns == make_golden.ROBOT_POSE.published_ns
    report = decode_frame_report((golden / "frame_report.bin").read_bytes())
    assert (report.published_ns, report.session, report.clock) == (pose.published_ns, 0, pb.CLOCK_UNSPECIFIED)
    assert decode_rig((golden / "rig_report.bin").read_bytes()).protocol == 0
    assert decode_status((golden / "status.bin").read_bytes()).frames == 600


def test_stamping_changes_nothing_but_the_stamp() -> None:
    unstamped = replace(make_golden.ROBOT_POSE, published_ns=0)
    message = Message("key", ODOMETRY, encode_odometry(unstamped), 1, 0, 42)
    out = stamped(message, make_golden.ROBOT_POSE.published_ns)
    assert out.payload == encode_odometry(make_golden.ROBOT_POSE)
    assert out.publish_ns == make_golden.ROBOT_POSE.published_ns
    again = decode_odometry(in_session(out, 9).payload)
    assert (again.session, again.published_ns) == (9, out.publish_ns)
    report = make_golden.frame_report()
    published_ns, report.published_ns = report.published_ns, 0
    out = stamped(Message("key", FRAME_REPORT, to_bytes(report), 1, 0, 42), published_ns)
    assert decode_frame_report(out.payload) == make_golden.frame_report()
    assert decode_frame_report(in_session(out, 9).payload).session == 9


def test_odometry_round_trip() -> None:
    told = make_golden.ROBOT_POSE
    back = decode_odometry(encode_odometry(told))
    assert_poses_close(back.pose, told.pose, 0.0, 1e-12)
    np.testing.assert_array_equal(back.covariance, told.covariance)
    for name in ("robot", "frame_id", "state", "leds", "rms_px", "sequence", "exposed_ns", "published_ns", "session"):
        assert getattr(back, name) == getattr(told, name), name


def test_the_cameras_of_a_joined_pose_round_trip_and_no_list_is_refused() -> None:
    joined = replace(make_golden.ROBOT_POSE, cameras=("left", 'the "other", ü'), leds=3)
    payload = encode_odometry(joined)
    assert decode_odometry(payload).cameras == joined.cameras
    for wrong in ("left", '{"left": 1}', "[1]", "[" * 100_000):
        more = Odometry()
        more.metadata.add(key="cameras", value=wrong)
        with pytest.raises(InputError, match="cameras are no list of names"):
            decode_odometry(payload + to_bytes(more))


def test_a_velocity_round_trips_and_half_of_one_is_refused() -> None:
    told = make_golden.SMOOTHED_POSE.velocity
    back = decode_odometry(encode_odometry(make_golden.SMOOTHED_POSE)).velocity
    assert told is not None
    assert back is not None
    for name in ("linear", "angular", "covariance"):
        np.testing.assert_array_equal(getattr(back, name), getattr(told, name))
    assert back.accelerations == told.accelerations
    assert decode_odometry(encode_odometry(make_golden.ROBOT_POSE)).velocity is None
    half = Odometry()
    half.ParseFromString(encode_odometry(make_golden.SMOOTHED_POSE))
    del half.velocity_covariance[30:]
    with pytest.raises(InputError, match="no pose of Asterism"):
        decode_odometry(half.SerializeToString())


@pytest.mark.parametrize(
    "payload", [b"", b"\x00\x01\x02", b"not protobuf at all", encode_odometry(make_golden.ROBOT_POSE)[:200]]
)
def test_bytes_that_are_no_odometry_are_refused(payload: bytes) -> None:
    with pytest.raises(InputError, match="bytes that are no pose of Asterism"):
        decode_odometry(payload)


@pytest.mark.parametrize(
    ("decode", "name"),
    [(decode_frame_report, "FrameReport"), (decode_status, "Status"), (decode_rig, "RigReport")],
)
def test_bytes_that_are_no_report_are_refused(decode: object, name: str) -> None:
    with pytest.raises(InputError, match=f"7 bytes that are no asterism.{name}"):
        decode(b"\xff\xff\xff\xff\xff\xff\xff")  # type: ignore[operator]


def test_image_round_trip_and_refusals(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (1024, 1280)).astype(np.uint8)
    payload = encode_image(5, make_golden.CAMERA, image)
    np.testing.assert_array_equal(decode_image(payload), image)
    message = RawImage()
    message.ParseFromString(payload)
    message.encoding = "rgb8"
    with pytest.raises(InputError, match="encoding 'rgb8', expected mono8"):
        decode_image(message.SerializeToString())
    message.encoding, message.data = "mono8", message.data[:-1]
    with pytest.raises(InputError, match="image message: 1310719 bytes, expected 1280 x 1024"):
        decode_image(message.SerializeToString())


def test_annotations_draw_every_spot_and_name_each_robot_once() -> None:
    drawn = ImageAnnotations()
    drawn.ParseFromString(encode_annotations(7, make_golden.frame_report()))
    assert len(drawn.circles) == 3
    assert [text.text for text in drawn.texts] == ["alpha 3"]


def test_the_proto_and_the_code_made_of_it_agree() -> None:
    text = (REPOSITORY / "protocol" / "asterism.proto").read_text()
    text = re.sub(r"//[^\n]*", "", text)
    told = set()
    for block, name, body in re.findall(r"(message|enum) (\w+) \{(.*?)\n\}", text, flags=re.DOTALL):
        pattern = r"(\w+)\s*=\s*(\d+);"
        told |= {(block, name, field, int(number)) for field, number in re.findall(pattern, body)}
    compiled = set()
    for name, message in pb.DESCRIPTOR.message_types_by_name.items():
        compiled |= {("message", name, field.name, field.number) for field in message.fields}
    for name, enum in pb.DESCRIPTOR.enum_types_by_name.items():
        compiled |= {("enum", name, value.name, value.number) for value in enum.values}
    assert told == compiled


def test_a_schema_brings_everything_it_depends_on() -> None:
    found = FileDescriptorSet()
    found.ParseFromString(descriptor_set("foxglove.Odometry"))
    seen: set[str] = set()
    for file in found.file:
        assert set(file.dependency) <= seen, "dependencies must come first"
        seen.add(file.name)
    assert any("Odometry" in name for name in seen)


def test_keys_and_their_robots() -> None:
    key = keys.odometry("cam", "alpha")
    assert key == "asterism/cam/robot/alpha/odometry"
    assert keys.robot_of(key) == "alpha"
    assert keys.robot_of(f"replay/{keys.visible('cam', 'alpha')}") == "alpha"
    assert keys.robot_of(keys.frame("cam")) is None
    for name in ("", "a/b", "a*", "$x", "a?b", "a#b", "@a", "a\nb"):
        assert keys.key_problem(name), name
    for name in ("alpha", "robot 7", "röb-1.2_x"):
        assert keys.key_problem(name) is None, name


@pytest.mark.parametrize("count", [0, 1, 60])
@pytest.mark.parametrize("time_ns", [0, 7, 1_795_398_896_000_000_007])
def test_annotations_are_encoded_as_protobuf_does(count: int, time_ns: int, rng: np.random.Generator) -> None:
    report = pb.FrameReport()
    for robot in ("alpha", "b" * 140, "\u00fc"):
        report.robots.add(id=robot)
    report.spots.x.extend(rng.uniform(0.0, 1280.0, count))
    report.spots.y.extend(rng.uniform(0.0, 1024.0, count))
    report.spots.radius.extend(rng.uniform(0.5, 40.0, count))
    report.spots.fate.extend(rng.integers(1, 10, count))
    report.spots.robot.extend(rng.integers(-1, 3, count))
    report.spots.led.extend(rng.integers(0, 6, count))
    told = encode_annotations(time_ns, report)
    drawn = ImageAnnotations.FromString(told)
    assert len(drawn.circles) == count
    assert [text.position.y for text in drawn.texts] == [
        y for y, robot in zip(report.spots.y, report.spots.robot, strict=True) if robot >= 0
    ]
    assert drawn.SerializeToString(deterministic=True) == told
