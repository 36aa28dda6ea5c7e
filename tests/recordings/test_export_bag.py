"""ROS 2 bags, read back by rosbags, which nobody here wrote: types, hashes, values, stamps, images."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from asterism.protocol.errors import InputError
from asterism.protocol.messages import RobotPose
from asterism.recordings.export.frames import frames_of
from asterism.recordings.export.ros_bag import write_bag
from asterism.recordings.reader import Recording
from asterism.server.sources.open_source import open_source
from tests.recordings.exported import FRAMES, exposed_ns, record

STORE = get_typestore(Stores.ROS2_JAZZY)
Bag = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, dict[tuple[int, str], RobotPose]]:
    return record(tmp_path_factory.mktemp("recording"), np.random.default_rng(12))


@pytest.fixture(scope="module")
def bag(recorded: tuple[Recording, dict[tuple[int, str], RobotPose]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, (recording, _) = tmp_path_factory.mktemp("bag"), recorded
    frames = frames_of(recording.messages(), recording.path)
    write_bag(frames, folder, "poses", recording.rigs(), recording.frames())
    return folder


@pytest.fixture(scope="module")
def messages(bag: Path) -> Bag:
    found: Bag = {}
    with AnyReader([bag]) as reader:  # decodes by the definitions in the bag
        for connection, time_ns, data in reader.messages():
            assert connection.digest == STORE.hash_rihs01(connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, reader.deserialize(data, connection.msgtype)))
    return found


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def test_it_is_a_bag_and_nothing_else(bag: Path) -> None:
    assert {path.name for path in bag.iterdir()} == {"poses.mcap", "metadata.yaml"}
    with Reader(bag) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
    assert types["/alpha/pose"] == "geometry_msgs/msg/PoseWithCovarianceStamped"
    assert types["/alpha/odom"] == "nav_msgs/msg/Odometry"
    assert types["/tf"] == types["/tf_static"] == "tf2_msgs/msg/TFMessage"
    assert types["/demo/image_raw"] == "sensor_msgs/msg/Image"
    assert types["/demo/camera_info"] == "sensor_msgs/msg/CameraInfo"


def test_every_pose_is_there_as_it_was_recorded(
    messages: Bag, recorded: tuple[Recording, dict[tuple[int, str], RobotPose]]
) -> None:
    _, poses = recorded
    odometry = {topic: told for topic, told in messages.items() if topic.endswith("/odom")}
    assert sum(map(len, odometry.values())) == len(poses) == sum(
        len(told) for topic, told in messages.items() if topic.endswith("/pose")
    )  # fmt: skip
    for pose in poses.values():
        (odom,) = (told for time_ns, told in messages[f"/{pose.robot}/odom"] if time_ns == pose.exposed_ns)
        (alone,) = (told for time_ns, told in messages[f"/{pose.robot}/pose"] if time_ns == pose.exposed_ns)
        for told in (odom, alone):
            p, q = told.pose.pose.position, told.pose.pose.orientation
            assert (stamp_ns(told), told.header.frame_id) == (pose.exposed_ns, "world")
            assert [p.x, p.y, p.z] == pose.position.tolist()
            np.testing.assert_allclose([q.x, q.y, q.z, q.w], pose.orientation, rtol=0, atol=1e-15)
            assert told.pose.covariance.tolist() == pose.covariance.ravel().tolist()
        assert pose.velocity is not None
        linear, angular = odom.twist.twist.linear, odom.twist.twist.angular
        assert odom.child_frame_id == pose.robot
        assert [linear.x, linear.y, linear.z] == pose.velocity.linear.tolist()
        assert [angular.x, angular.y, angular.z] == pose.velocity.angular.tolist()


def test_transforms_hold_who_is_located_and_both_rigs_what_never_moves(
    messages: Bag, recorded: tuple[Recording, dict[tuple[int, str], RobotPose]]
) -> None:
    recording, poses = recorded
    moving = {(time_ns, transform.child_frame_id) for time_ns, told in messages["/tf"] for transform in told.transforms}
    assert moving == {(pose.exposed_ns, pose.robot) for pose in poses.values()}
    for (first, rig), (time_ns, told) in zip(recording.rigs(), sorted_by_rig(messages["/tf_static"]), strict=True):
        assert time_ns == exposed_ns(max(first, 1))
        children = [transform.child_frame_id for transform in told.transforms]
        points = [f"{robot.id}/{name}" for robot in rig.robots for name in robot.points]
        assert children == ["demo", *points]
        camera = told.transforms[0]
        assert camera.header.frame_id == "world"
        assert rig.T_world_camera is not None
        assert camera.transform.translation.z == rig.T_world_camera.position[2]


def sorted_by_rig(told: list[tuple[int, Any]]) -> list[tuple[int, Any]]:
    """A bag is read by time, and the clock was set back with the second rig."""
    return told[::-1]


def test_images_come_with_the_camera_s_calibration(
    messages: Bag, recorded: tuple[Recording, dict[tuple[int, str], RobotPose]]
) -> None:
    recording, _ = recorded
    camera = recording.rig().camera
    images = dict(messages["/demo/image_raw"])
    assert len(images) == FRAMES
    for image, time_ns, _ in recording.frames():
        told = images[time_ns]
        assert (stamp_ns(told), told.header.frame_id, told.encoding) == (time_ns, "demo", "mono8")
        np.testing.assert_array_equal(told.data.reshape(told.height, told.step), image)
    for _, info in messages["/demo/camera_info"]:
        assert (info.width, info.height, info.distortion_model) == (camera.width, camera.height, camera.model)
        np.testing.assert_array_equal(info.k.reshape(3, 3), camera.matrix)
        np.testing.assert_array_equal(info.p.reshape(3, 4)[:, :3], camera.matrix)
        np.testing.assert_array_equal(info.d, camera.distortion)


def test_it_is_a_source_of_the_same_images(
    bag: Path, recorded: tuple[Recording, dict[tuple[int, str], RobotPose]]
) -> None:
    recording, _ = recorded
    said: list[str] = []
    source = open_source(str(bag), recording.rig(), said.append, topic="/demo/image_raw")
    played = {frame.exposed_ns: frame.image for frame in source.frames()}
    assert len(played) == FRAMES
    for image, time_ns, _ in recording.frames():
        np.testing.assert_array_equal(played[time_ns], image)
    assert not [sentence for sentence in said if "CameraInfo" in sentence], "the calibration is the rig's"


def test_names_that_ros_has_no_topic_for_are_told(
    tmp_path: Path, recorded: tuple[Recording, dict[tuple[int, str], RobotPose]]
) -> None:
    recording, _ = recorded
    frames = list(frames_of(recording.messages(), recording.path))
    called = {"alpha": "1-alpha", "bravo": "brävo"}
    renamed = [
        replace(frame, robots=tuple(replace(robot, id=called.get(robot.id, robot.id)) for robot in frame.robots))
        for frame in frames
    ]
    rigs = [
        (first, replace(rig, robots=tuple(replace(robot, id=called.get(robot.id, robot.id)) for robot in rig.robots)))
        for first, rig in recording.rigs()
    ]
    written = write_bag(renamed, tmp_path / "one", "bag", rigs, None)
    assert written.renamed == {"1-alpha": "id_1_alpha", "brävo": "br_vo"}
    with Reader(tmp_path / "one") as reader:
        topics = {connection.topic for connection in reader.connections}
    assert {"/id_1_alpha/odom", "/br_vo/odom"} < topics
    robots = tuple(replace(robot, id=name) for robot, name in zip(rigs[0][1].robots, ("a-b", "a+b"), strict=False))
    alike = [(0, replace(rigs[0][1], robots=robots))]
    with pytest.raises(InputError, match="robots 'a-b' and 'a\\+b' would both be /a_b in a bag"):
        write_bag(renamed, tmp_path / "two", "bag", alike, None)
