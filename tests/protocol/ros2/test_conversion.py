"""What ROS is told is what Asterism found: poses, twists, frames, covariances, health."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import set_report_pose
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.ros2 import conversion
from asterism.protocol.ros2.values import ERROR, OK, WARN, Header
from tests.protocol.make_golden import EXPOSED_NS, RIG, ROBOT_POSE, SMOOTHED_POSE

IN_THE_CAMERA = replace(RIG, T_world_camera=None)


def test_a_pose_keeps_its_numbers_and_its_time() -> None:
    told = conversion.pose_with_covariance(ROBOT_POSE)
    assert told.header == Header(EXPOSED_NS, "world")
    assert told.pose is ROBOT_POSE.pose
    np.testing.assert_array_equal(np.reshape(told.covariance, (6, 6)), ROBOT_POSE.covariance)


def test_a_twist_is_told_where_it_is_known_and_never_believed_where_not() -> None:
    told, velocity = conversion.odometry(SMOOTHED_POSE), SMOOTHED_POSE.velocity
    assert velocity is not None
    assert (told.header, told.child_frame_id) == (Header(EXPOSED_NS, "world"), "alpha")
    np.testing.assert_array_equal([told.linear, told.angular], [velocity.linear, velocity.angular])
    np.testing.assert_array_equal(np.reshape(told.twist_covariance, (6, 6)), velocity.covariance)
    alone = conversion.odometry(ROBOT_POSE)
    assert (alone.linear, alone.angular) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert fused(np.full(6, 0.3), np.full(6, 1e-4), alone.twist_covariance) == pytest.approx(np.full(6, 0.3), rel=1e-9)


def fused(known: Floats, variances: Floats, covariance: tuple[float, ...]) -> Floats:
    """What a Kalman filter makes of twists it knows, once it is told of zeros with that covariance."""
    P, R = np.diag(variances), np.reshape(covariance, (6, 6))
    joined: Floats = known - P @ np.linalg.inv(P + R) @ known
    return joined


def test_frames_of_a_rig() -> None:
    told = conversion.rig_transforms(RIG, 9).transforms
    assert [(one.header.frame_id, one.child_frame_id) for one in told] == [("world", "cam"), ("alpha", "alpha/tool")]
    assert all(one.header.stamp_ns == 9 for one in told)
    np.testing.assert_allclose(told[0].pose.map(np.array([0.0, 0.0, 1.25])), [0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(told[1].pose.position, [0.0, 0.0, -0.03])
    assert [one.child_frame_id for one in conversion.rig_transforms(IN_THE_CAMERA, 9).transforms] == ["alpha/tool"]
    followed = conversion.rig_transforms(replace(RIG, follows_world=True), 9).transforms
    assert [one.child_frame_id for one in followed] == ["alpha/tool"]


def test_a_camera_that_is_followed_is_where_the_frame_has_it() -> None:
    report = pb.FrameReport(exposed_ns=5, frame_id="world")
    assert conversion.camera_transform(report, "cam") is None
    place = Pose(np.array([0.0, 0.1, 1.2]), np.array([1.0, 0.0, 0.0, 0.0]))
    set_report_pose(report.camera.pose, place)
    told = conversion.camera_transform(report, "cam")
    assert told is not None
    assert (told.header, told.child_frame_id) == (Header(5, "world"), "cam")
    np.testing.assert_array_equal(told.pose.position, place.position)


def test_chained_transforms_put_a_point_where_the_server_has_it() -> None:
    robot = conversion.robot_transform(ROBOT_POSE)
    point = conversion.rig_transforms(RIG, 0).transforms[1]
    assert robot.child_frame_id == point.header.frame_id
    chained = robot.pose @ point.pose
    np.testing.assert_allclose(chained.position, ROBOT_POSE.pose.map(RIG.robots[0].points["tool"]), atol=1e-12)


@pytest.mark.parametrize(
    ("status", "level", "message"),
    [
        (pb.Status(rate_hz=59.94), OK, "59.9 frames a second"),
        (pb.Status(rate_hz=60, problem="the disk is full"), WARN, "the disk is full"),
        (pb.Status(problem="the camera is gone"), ERROR, "the camera is gone"),
        (pb.Status(), ERROR, "no frames"),
    ],
)
def test_health(status: pb.Status, level: int, message: str) -> None:
    status.time_ns = 3
    status.robots["LOST"] = 2
    status.frames = 600
    told = conversion.diagnostics(status, "cam")
    assert told.header.stamp_ns == 3
    (one,) = told.status
    assert (one.level, one.message, one.hardware_id) == (level, message, "cam")
    assert dict(one.values)["robots LOST"] == "2"
    assert dict(one.values)["frames"] == "600"
