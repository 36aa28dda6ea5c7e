"""What nodes of ROS 2 get: the right fields of every message, also late joiners, on topics that they find."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import STATUS, Message, RobotPose
from asterism.protocol.ros2 import types
from asterism.protocol.ros2.names import RosPlace
from tests.clients.serving import until
from tests.protocol.make_golden import RIG
from tests.service.ros2.independent import FRAME, SdkNode, frame_of, need_sdk, pose, telling

COUNT = 50  # 1000 in python -m tests.measure.ros2
TOGETHER = 5  # frames without a pause: more than a camera makes, less than the short queue drops
TOPICS = {
    "/lab/alpha/pose": types.POSE_WITH_COVARIANCE_STAMPED,
    "/lab/alpha/odom": types.ODOMETRY,
    "/tf": types.TF_MESSAGE,
    "/tf_static": types.TF_MESSAGE,
    "/diagnostics": types.DIAGNOSTIC_ARRAY,
}

DYNAMIC = list(TOPICS)[:3]


def xyz(value: dict[str, float]) -> list[float]:
    return [value["x"], value["y"], value["z"]]


def check_header(header: dict[str, Any], told: RobotPose) -> None:
    assert header["frame_id"] == "world"
    assert header["stamp"]["sec"] * 10**9 + header["stamp"]["nanosec"] == told.exposed_ns


def check_pose(message: dict[str, Any], told: RobotPose) -> None:
    pose = message["pose"]["pose"]
    assert xyz(pose["position"]) == told.position.tolist()
    quaternion = [*xyz(pose["orientation"]), pose["orientation"]["w"]]
    assert quaternion == pytest.approx(told.orientation.tolist(), abs=1e-15)  # made unit once more
    assert message["pose"]["covariance"] == told.covariance.ravel().tolist()


def test_a_node_receives_everything(rng: np.random.Generator) -> None:
    need_sdk()
    told = [pose(number, rng) for number in range(COUNT)]
    with telling(RosPlace(7, "/lab")) as (endpoint, outlet, _):
        node = SdkNode(endpoint, 7, TOPICS, late=("/tf_static",))
        for sent, one in enumerate(told, start=1):
            outlet.write(frame_of([one]), FRAME)
            if sent % TOGETHER == 0:
                until(lambda at_least=sent: min(node.counts()[topic] for topic in DYNAMIC) >= at_least)
        status = pb.Status(time_ns=5, rate_hz=60.0, problem="the disk is full")
        outlet.status([Message("asterism/cam/status", STATUS, to_bytes(status), 5, 5, 0)])
        until(lambda: node.counts()["/diagnostics"])
        found = node.finish()
    received = found["received"]
    assert {topic: len(messages) for topic, messages in received.items()} == {
        "/lab/alpha/pose": COUNT,
        "/lab/alpha/odom": COUNT,
        "/tf": COUNT,
        "/tf_static": 1,
        "/diagnostics": 1,
    }
    for one, at, odom, tf in zip(told, *(received[topic] for topic in DYNAMIC), strict=True):
        check_header(at["header"], one)
        check_pose(at, one)
        check_header(odom["header"], one)
        check_pose(odom, one)
        assert one.velocity is not None
        assert odom["child_frame_id"] == "alpha"
        assert xyz(odom["twist"]["twist"]["linear"]) == one.velocity.linear.tolist()
        assert xyz(odom["twist"]["twist"]["angular"]) == one.velocity.angular.tolist()
        assert odom["twist"]["covariance"] == one.velocity.covariance.ravel().tolist()
        (transform,) = tf["transforms"]
        check_header(transform["header"], one)
        assert transform["child_frame_id"] == "alpha"
        assert xyz(transform["transform"]["translation"]) == one.position.tolist()
    (never_moves,) = received["/tf_static"]
    assert [one["child_frame_id"] for one in never_moves["transforms"]] == ["cam", "alpha/tool"]
    (health,) = received["/diagnostics"]
    assert (health["status"][0]["level"], health["status"][0]["message"]) == (1, "the disk is full")
    assert {topic: [kind.ros] for topic, kind in TOPICS.items()}.items() <= dict(found["seen"]).items()


def test_another_rig_has_other_topics_and_transforms(rng: np.random.Generator) -> None:
    need_sdk()
    (alpha,) = RIG.robots
    bravo = replace(alpha, id="bravo", points={"nose": np.array([0.1, 0.0, 0.0])})
    with telling(RosPlace(0, "")) as (endpoint, outlet, _):
        outlet.take_rig(replace(RIG, robots=(bravo, replace(alpha, id="never-mind"))))
        topics = {"/bravo/odom": types.ODOMETRY, "/tf_static": types.TF_MESSAGE, "/tf": types.TF_MESSAGE}
        node = SdkNode(endpoint, 0, topics, late=("/tf_static",))
        outlet.write(frame_of([pose(0, rng, "bravo"), pose(0, rng, "never-mind")]), FRAME)
        until(lambda: min(node.counts().values()) > 0)
        found = node.finish()
    received = found["received"]
    assert [one["child_frame_id"] for one in received["/bravo/odom"]] == ["bravo"]
    assert [one["child_frame_id"] for one in received["/tf"][0]["transforms"]] == ["bravo", "never-mind"]
    children = [one["child_frame_id"] for one in received["/tf_static"][0]["transforms"]]
    assert children == ["cam", "bravo/nose", "never-mind/tool"]
    assert {topic for topic, _ in found["seen"] if topic.count("/") == 2} == {"/bravo/pose", "/bravo/odom"}
