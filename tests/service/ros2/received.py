"""What the servers of these tests tell of `alpha` in the namespace /lab, as a node of ROS 2 has received it."""

from collections.abc import Sequence
from typing import Any

import pytest

from asterism.protocol.messages import RobotPose
from asterism.protocol.ros2 import types

TOPICS = {
    "/lab/alpha/pose": types.POSE_WITH_COVARIANCE_STAMPED,
    "/lab/alpha/odom": types.ODOMETRY,
    "/tf": types.TF_MESSAGE,
    "/tf_static": types.TF_MESSAGE,
    "/diagnostics": types.DIAGNOSTIC_ARRAY,
}
DYNAMIC = list(TOPICS)[:3]


def check_received(received: dict[str, list[dict[str, Any]]], told: Sequence[RobotPose]) -> None:
    """Of every pose the three messages at the ends of their topics; what never moves, once; that the disk is full."""
    for one, at, odom, tf in zip(told, *(received[topic][-len(told) :] for topic in DYNAMIC), strict=True):
        for message in (at, odom):
            _check_header(message["header"], one)
            _check_pose(message, one)
        assert one.velocity is not None
        assert odom["child_frame_id"] == "alpha"
        assert _xyz(odom["twist"]["twist"]["linear"]) == one.velocity.linear.tolist()
        assert _xyz(odom["twist"]["twist"]["angular"]) == one.velocity.angular.tolist()
        assert odom["twist"]["covariance"] == one.velocity.covariance.ravel().tolist()
        (transform,) = tf["transforms"]
        _check_header(transform["header"], one)
        assert transform["child_frame_id"] == "alpha"
        assert _xyz(transform["transform"]["translation"]) == one.position.tolist()
    (never_moves,) = received["/tf_static"]
    assert [one["child_frame_id"] for one in never_moves["transforms"]] == ["cam", "alpha/tool"]
    (health,) = received["/diagnostics"]
    assert (health["status"][0]["level"], health["status"][0]["message"]) == (1, "the disk is full")


def _xyz(value: dict[str, float]) -> list[float]:
    return [value["x"], value["y"], value["z"]]


def _check_header(header: dict[str, Any], told: RobotPose) -> None:
    assert header["frame_id"] == "world"
    assert header["stamp"]["sec"] * 10**9 + header["stamp"]["nanosec"] == told.exposed_ns


def _check_pose(message: dict[str, Any], told: RobotPose) -> None:
    pose = message["pose"]["pose"]
    assert _xyz(pose["position"]) == told.position.tolist()
    quaternion = [*_xyz(pose["orientation"]), pose["orientation"]["w"]]
    assert quaternion == pytest.approx(told.orientation.tolist(), abs=1e-15)  # made unit once more
    assert message["pose"]["covariance"] == told.covariance.ravel().tolist()
