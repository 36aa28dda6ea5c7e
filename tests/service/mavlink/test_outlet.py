"""What a flight controller hears of its robot, by MAVLink's own parser, over real sockets."""

import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed (pip install '.[dev]')")

from pymavlink.dialects.v20 import common as theirs

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import encode_odometry, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, STATUS, Message, RobotPose, Velocity
from asterism.server.chain.frame import Frame
from asterism.server.service.mavlink.endpoint import Endpoint, endpoint
from asterism.server.service.mavlink.outlet import Mavlink
from asterism.server.sources.session_clock import SessionClock
from tests.helpers import random_pose
from tests.rigs import make_rig

RIG = make_rig(2, T_world_camera=Pose.identity())
SECOND_NS = 10**9
EXPOSED_NS = 1_800_000_000 * SECOND_NS
TIMEOUT_S = 20.0


class Stopped(SessionClock):
    """A clock at whose time everything happens."""

    def now_ns(self, session: int | None = None) -> int:  # noqa: ARG002
        return EXPOSED_NS


class FlightController:
    """A UDP socket that hears with MAVLink's own parser and answers where it was called from."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(TIMEOUT_S)
        self.port: int = self.socket.getsockname()[1]
        self._reader = theirs.MAVLink(None, srcSystem=1, srcComponent=1)

    def next(self, name: str) -> "theirs.MAVLink_message":
        while True:
            datagram, self._caller = self.socket.recvfrom(1000)
            (message,) = self._reader.parse_buffer(bytearray(datagram))
            if message.get_type() == name:
                return message

    def send(self, message: "theirs.MAVLink_message") -> None:
        self.socket.sendto(bytes(message.pack(self._reader)), self._caller)


@contextmanager
def flying(*robots: str, clock: SessionClock | None = None) -> Iterator[tuple[Mavlink, list[FlightController]]]:
    """The outlet to one flight controller for each of the robots."""
    controllers = [FlightController() for _ in robots]
    to = [Endpoint(robot, "127.0.0.1", one.port) for robot, one in zip(robots, controllers, strict=True)]
    outlet = Mavlink(RIG, to, clock or SessionClock())
    try:
        yield outlet, controllers
    finally:
        outlet.close()
        for one in controllers:
            one.socket.close()


def told_of(robot: str, pose: Pose, at_s: float = 0.0, **more: object) -> RobotPose:
    exposed_ns = EXPOSED_NS + round(at_s * SECOND_NS)
    told = RobotPose(robot, "world", pose, 1e-6 * np.eye(6), "TRACKED", 6, 0.1, 5, exposed_ns, 0, session=7)
    return replace(told, **more)  # type: ignore[arg-type]


def write(outlet: Mavlink, *told: RobotPose) -> None:
    messages = [Message(one.robot, ODOMETRY, encode_odometry(one), one.exposed_ns, 0, 5) for one in told]
    report = to_bytes(pb.FrameReport(sequence=5))
    messages.append(Message("frame", FRAME_REPORT, report, EXPOSED_NS, 0, 5))
    outlet.write(messages, Frame(np.zeros((4, 4), np.uint8), 5, EXPOSED_NS, session=7))


def test_every_robot_is_told_to_its_own_controller(rng: np.random.Generator) -> None:
    poses = {robot.id: random_pose(rng) for robot in RIG.robots}
    velocity = Velocity(rng.normal(size=3), rng.normal(size=3), np.eye(6))
    with flying("r01", "r00") as (outlet, (of_second, of_first)):
        write(outlet, told_of("r00", poses["r00"]), told_of("r01", poses["r01"], velocity=velocity))
        first, second = of_first.next("ODOMETRY"), of_second.next("ODOMETRY")
    assert (first.get_srcSystem(), second.get_srcSystem()) == (1, 2)  # as in the rig
    for message, pose in ((first, poses["r00"]), (second, poses["r01"])):
        assert message.time_usec == EXPOSED_NS // 1000
        np.testing.assert_allclose([message.x, -message.y, -message.z], pose.position, rtol=1e-6)
        w, x, y, z = message.q
        np.testing.assert_allclose([x, -y, -z, w], pose.orientation, rtol=1e-6, atol=1e-7)
        assert message.pose_covariance[0] == pytest.approx(1e-6)
    assert np.isnan([first.vx, first.yawspeed, first.velocity_covariance[0]]).all()
    np.testing.assert_allclose([second.vx, -second.vy, -second.vz], velocity.linear, rtol=1e-6)
    np.testing.assert_allclose([second.rollspeed, -second.pitchspeed, -second.yawspeed], velocity.angular, rtol=1e-6)


def test_jumps_are_counted_and_doubt_is_told(rng: np.random.Generator) -> None:
    pose = random_pose(rng)
    with flying("r00") as (outlet, (controller,)):

        def resets(**more: object) -> int:
            write(outlet, told_of("r00", pose, **more))  # type: ignore[arg-type]
            count: int = controller.next("ODOMETRY").reset_counter
            return count

        assert resets() == 0
        assert resets(at_s=0.02) == 0
        assert resets(at_s=0.9) == 0  # lost for a short while
        assert resets(at_s=2.0) == 1  # for a long one
        assert resets(at_s=2.02, session=8) == 2
        outlet.take_rig(make_rig(2, T_world_camera=Pose.identity()))
        assert resets(at_s=2.04, session=8) == 3
        assert resets(at_s=2.06, session=8) == 3
        write(outlet, told_of("r00", pose, at_s=2.08, session=8, state="TILT_AMBIGUOUS"))
        assert 0 < controller.next("ODOMETRY").quality < 50
        write(outlet, told_of("r00", pose, at_s=2.1, session=8, frame_id="test"))  # in the camera's frame: not told
        assert resets(at_s=2.12, session=8) == 3


def test_the_heart_beats_and_the_time_is_told_to_who_asks() -> None:
    clock = Stopped()
    with flying("r00", clock=clock) as (outlet, (controller,)):
        outlet.between([Message("status", STATUS, b"", 0, 0, 0)])
        assert controller.next("HEARTBEAT").get_srcSystem() == 1
        controller.send(theirs.MAVLink_timesync_message(5, 78))  # an answer of its own, no question
        controller.send(theirs.MAVLink_timesync_message(0, 79))
        answer = controller.next("TIMESYNC")
        assert answer.ts1 == 79
        assert answer.tc1 == clock.now_ns()


def test_a_rig_that_takes_a_robots_poses_away_is_said(caplog: pytest.LogCaptureFixture) -> None:
    with flying("r00", "r01") as (outlet, _):
        outlet.take_rig(RIG)
        assert "no pose goes out" not in caplog.text
        outlet.take_rig(make_rig(1, T_world_camera=Pose.identity()))
        assert "MAVLink: no pose goes out of r01: the rig has it no more" in caplog.text
        outlet.take_rig(make_rig(2))
        assert "MAVLink: no pose goes out of r00, r01: the rig has no `world` now" in caplog.text


def test_nobody_there_is_no_trouble(rng: np.random.Generator, caplog: pytest.LogCaptureFixture) -> None:
    controller = FlightController()
    controller.socket.close()
    outlet = Mavlink(RIG, [Endpoint("r00", "127.0.0.1", controller.port)], SessionClock())
    for k in range(5):
        write(outlet, told_of("r00", random_pose(rng), at_s=0.1 * k))
    outlet.close()
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("alpha=127.0.0.1:14550", Endpoint("alpha", "127.0.0.1", 14550)),
        ("a=b=drone.local:1", Endpoint("a=b", "drone.local", 1)),
        ("alpha=[::1]:14550", Endpoint("alpha", "::1", 14550)),
    ],
)
def test_endpoints_are_read(text: str, found: Endpoint) -> None:
    assert endpoint(text) == found
    assert str(found) == text


@pytest.mark.parametrize(
    "text", ["alpha", "alpha=", "=h:1", "alpha=:1", "alpha=h", "alpha=h:0", "alpha=h:65536", "alpha=h:١", "alpha=::1:5"]
)
def test_what_is_no_endpoint_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^--mavlink .*expected"):
        endpoint(text)


def test_robots_hosts_and_rigs_that_cannot_be_are_refused() -> None:
    clock = SessionClock()
    with pytest.raises(InputError, match=r"no robot 'nobody', expected one of r00, r01"):
        Mavlink(RIG, [Endpoint("nobody", "127.0.0.1", 1)], clock)
    with pytest.raises(InputError, match=r"--mavlink r00=no\.\.host:1: no such host"):
        Mavlink(RIG, [Endpoint("r01", "127.0.0.1", 1), Endpoint("r00", "no..host", 1)], clock)
    with pytest.raises(InputError, match="no `world`"):
        Mavlink(make_rig(1), [Endpoint("r00", "127.0.0.1", 1)], clock)
