"""What is fused, as messages that clients take."""

from dataclasses import replace

import numpy as np

from asterism.clients.accept import problem
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_frame_report, decode_odometry, report_pose, stamped
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY
from asterism.protocol.rig import parse_rig
from asterism.server.fusing.fitting import unlike, view_of
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.fused import Fused, FusedPose
from asterism.server.fusing.report import Told, report, rig_report
from asterism.server.pose.solve import Alternative, Lost
from tests.helpers import assert_poses_close, random_pose
from tests.several import facing_pair, rigs_at


def a_fleet() -> Fleet:
    rigs = rigs_at(facing_pair())
    robots = (replace(rigs[0].robots[0], points={"tool": np.array([0.0, 0.01, 0.02])}), *rigs[0].robots[1:])
    return Fleet.of([view_of(replace(rig, robots=robots), "here") for rig in rigs])


def test_poses_and_what_they_rest_on_arrive_as_they_are(rng: np.random.Generator) -> None:
    fleet = a_fleet()
    first, second = fleet.robots
    pose, other = random_pose(rng), random_pose(rng)
    alternative = Alternative(other.position, other.orientation, 7.0)
    answer = FusedPose(pose, np.eye(6) * 1e-8, ("left", "right"), 3, 0.02, alternative, {"third": "5 mm off"})
    fused = Fused(10**18, ("left",), {first: answer, second: Lost("no camera finds it")})
    messages = [stamped(told, 10**18 + 10**7) for told in report(fused, fleet, Told(5, 77, 10**18 + 1, 10**18 + 2))]
    assert [message.kind for message in messages] == [ODOMETRY, FRAME_REPORT]
    assert [message.key for message in messages] == [f"asterism/fused/robot/{first}/odometry", "asterism/fused/frame"]
    told = decode_odometry(messages[0].payload)
    assert (told.cameras, told.leds, told.session, told.sequence, told.frame_id) == (
        ("left", "right"),
        3,
        77,
        5,
        "world",
    )
    assert problem(told, first) is None  # three LEDs of two cameras are a pose
    assert problem(replace(told, cameras=()), first) is not None
    assert_poses_close(told.pose, pose)
    frame = decode_frame_report(messages[1].payload)
    assert list(frame.cameras) == ["left"]
    assert [entry.state for entry in frame.robots] == [pb.TILT_AMBIGUOUS, pb.LOST]
    assert dict(frame.robots[0].left_out) == {"third": "5 mm off"}
    assert frame.robots[0].alternative.odds == 7.0
    tool = frame.robots[0].points["tool"]
    assert np.allclose([tool.x, tool.y, tool.z], pose.map(np.array([0.0, 0.01, 0.02])))
    assert frame.robots[1].reason == "no camera finds it"
    assert_poses_close(report_pose(frame.robots[0].pose), pose)


def test_the_rig_that_is_answered_with_reads_as_one_with_the_same_robots() -> None:
    fleet = a_fleet()
    told = rig_report(fleet)
    assert not told.camera_matrix
    assert told.frame_id == "world"
    rig = parse_rig(told.rig_yaml, told.camera_yaml, "here", told.offset_yaml, told.files)
    assert (rig.camera.name, rig.parent_frame) == ("fused", "world")
    assert [robot.id for robot in rig.robots] == [robot.id for robot in told.robots] == list(fleet.robots)
    assert not any(unlike(robot, fleet.robots[robot.id]) for robot in rig.robots)
