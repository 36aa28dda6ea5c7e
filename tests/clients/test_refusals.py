"""What nobody should drive by does not reach a program."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.clients import PoseClient
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry, stamped, to_bytes
from asterism.protocol.messages import ODOMETRY, Message, RobotPose
from tests.clients.serving import COVARIANCE, Server, until


def payload(server: Server, pose: RobotPose) -> bytes:
    message = Message("", ODOMETRY, encode_odometry(pose), pose.exposed_ns, 0, 0)
    return stamped(message, server.clock.now_ns()).payload


def test_nonsense_is_counted_said_once_and_handed_to_nobody(
    endpoint: str, server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    with PoseClient(endpoint) as robots:
        feed, everyone = robots["alpha"], robots.all()
        taken: list[int] = []
        feed.on_pose(lambda pose: taken.append(pose.sequence))
        until(lambda: server.tell() or (taken and everyone.latest(10.0)))
        good = server.pose()
        for bad in (
            b"\x07no pose",
            payload(server, replace(good, robot="bravo", sequence=7)),
            payload(server, replace(good, leds=-6, sequence=7)),
            payload(server, replace(good, state="FLYING", sequence=7)),
            payload(server, replace(good, covariance=COVARIANCE * np.nan, sequence=7)),
            payload(server, replace(good, session=server.clock.session + 1, sequence=7)),
            payload(server, replace(good, exposed_ns=10**400 % 2**62, sequence=7)),
            encode_odometry(server.pose(age_s=-60.0, sequence=7, published_ns=good.exposed_ns + 61 * 10**9)),
            encode_odometry(replace(good, published_ns=10**400, sequence=7)),
        ):
            server.put(bad)
        until(lambda: feed.refused == 9 and everyone.refused == 9)
        server.tell(sequence=43)
        until(lambda: 43 in taken and "alpha" in everyone.latest(10.0))
        assert 7 not in taken
    key = keys.odometry("cam", "alpha")
    assert f"{key}: odometry message: 8 bytes that are no pose of Asterism" in caplog.text
    assert len(caplog.messages) < 18, "once a second at most, by each feed"


def test_a_beat_makes_no_pose_of_another_session_fresh(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        until(lambda: server.tell() or robots["alpha"].latest(0.1))
        beat = pb.Beat(session=99, sequence=1, time_ns=1, rate=2.0)
        server.publisher.put(Message(keys.beat("cam"), ODOMETRY, to_bytes(beat), 0, 0, 0))
        server.put(b"")
        until(lambda: robots["alpha"].refused)
        until(lambda: server.tell() or robots["alpha"].latest(0.1))
        pose = robots["alpha"].latest(10.0)
        assert pose is not None
        assert pose.session == server.clock.session
