"""zenoh sessions, publisher and PoseClient, in one process on loopback."""

import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh

from asterism.clients import PoseClient
from asterism.protocol import keys
from asterism.protocol.codec import decode_rig, encode_odometry, encode_rig
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.messages import ODOMETRY, TRANSFORMS, Message, RobotPose
from asterism.protocol.network import check_endpoint, client_config, open_server, server_config
from asterism.server.service.publish import Publisher
from asterism.server.sources.session_clock import SessionClock
from tests.protocol.make_golden import RIG, ROBOT_POSE
from tests.servers import free_endpoint


def value(config: zenoh.Config, key: str) -> object:
    return json.loads(config.get_json(key))


def test_by_default_everything_stays_on_loopback_and_nobody_is_scouted() -> None:
    server, client = server_config(), client_config()
    assert value(server, "mode") == "peer"
    assert value(server, "listen/endpoints") == ["tcp/127.0.0.1:7447#so_sndbuf=32768"]
    assert value(client, "mode") == "client"
    assert value(client, "connect/endpoints") == ["tcp/127.0.0.1:7447"]
    assert value(client, "listen/endpoints") == []
    for config in (server, client):
        assert value(config, "scouting/multicast/enabled") is False
        assert value(config, "transport/link/tx/queue/size/data") == 16


def test_arguments_say_where() -> None:
    assert value(server_config(listen="tcp/0.0.0.0:9"), "listen/endpoints") == ["tcp/0.0.0.0:9#so_sndbuf=32768"]
    joined = server_config(connect="tcp/10.0.0.1:7447")
    assert (value(joined, "mode"), value(joined, "listen/endpoints")) == ("client", [])
    assert value(joined, "connect/endpoints") == ["tcp/10.0.0.1:7447#so_sndbuf=32768"]
    own = "tls/10.0.0.1:7447#so_sndbuf=1000000"
    assert value(server_config(listen=own), "listen/endpoints") == [own]


def test_a_users_file_holds_unless_an_argument_says_otherwise(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(
        "{mode: 'router', listen: {endpoints: ['tcp/127.0.0.1:9']}, scouting: {multicast: {enabled: true}}}"
    )
    config = server_config(options=file)
    assert value(config, "mode") == "router"
    assert value(config, "listen/endpoints") == ["tcp/127.0.0.1:9"]
    assert value(config, "scouting/multicast/enabled") is True
    assert value(server_config(listen="tcp/127.0.0.1:8", options=file), "listen/endpoints")[0].startswith(
        "tcp/127.0.0.1:8#"
    )
    # A file that says nothing of endpoints leaves the server on loopback.
    file.write_text("{mode: 'router'}")
    assert value(server_config(options=file), "listen/endpoints") == ["tcp/127.0.0.1:7447#so_sndbuf=32768"]
    # Access control of the file's own replaces ours as a whole.
    file.write_text("{access_control: {enabled: false, default_permission: 'allow'}}")
    assert value(server_config(options=file), "access_control/rules") is None
    assert value(server_config(), "access_control/enabled") is True


@pytest.mark.parametrize("text", ["{mode: ", "{no_such_option: 1}", "\xff"])
def test_a_file_that_is_no_zenoh_configuration_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"zenoh\.json5: (is no zenoh configuration|cannot be read)"):
        server_config(options=file)
    with pytest.raises(InputError, match=r"nowhere\.json5: cannot be read"):
        client_config(options=tmp_path / "nowhere.json5")


@pytest.mark.parametrize(
    "endpoint", ["127.0.0.1:7447", "tcp", "tcp/", "tcp/127.0.0.1", "tcp/127.0.0.1:x", "tcp/:7", ""]
)
def test_malformed_endpoints_are_refused(endpoint: str) -> None:
    with pytest.raises(InputError, match=r"expected .* such as tcp/127.0.0.1:7447"):
        check_endpoint(endpoint)


def test_an_endpoint_in_use_is_refused_with_what_to_do() -> None:
    endpoint = free_endpoint()
    first = open_server(endpoint)
    with pytest.raises(InputError, match=r"is already in use .* expected a free one: --listen .* or --connect"):
        open_server(endpoint)
    first.close()


def test_nothing_to_connect_to_is_the_worlds_fault() -> None:
    with pytest.raises(WorldError, match="nothing answers there; start the zenoh router or server first"):
        open_server(connect=free_endpoint())


class Server:
    """A publisher on a free port."""

    def __init__(self, endpoint: str, prefix: str = "") -> None:
        self.session = open_server(endpoint)
        self.publisher = Publisher(self.session, "cam", encode_rig(RIG), SessionClock(), prefix)

    def tell(self, told: RobotPose) -> None:
        key = keys.odometry("cam", told.robot)
        self.publisher.publish([Message(key, ODOMETRY, encode_odometry(told), told.exposed_ns, 0, told.sequence)])

    def close(self) -> None:
        self.publisher.close()


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def server(endpoint: str) -> Iterator[Server]:
    made = Server(endpoint)
    yield made
    made.close()


def until(condition: object, timeout_s: float = 10.0) -> None:
    """Wait for a condition that another process' or thread's message brings about."""
    end = time.monotonic() + timeout_s
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.002)


def test_a_pose_arrives_with_everything_it_was_sent_with(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        until(lambda: robots.alive)
        arrived = threading.Event()
        feed.on_pose(lambda _: arrived.set())
        until(lambda: server.tell(ROBOT_POSE) or arrived.wait(0.05))
        pose = feed.latest(max_age_s=10.0)
        assert pose is not None
        assert (pose.robot, pose.camera, pose.state, pose.leds, pose.sequence) == (
            "alpha",
            "cam",
            "TILT_AMBIGUOUS",
            5,
            42,
        )
        assert pose.pose.position.tolist() == ROBOT_POSE.pose.position.tolist()
        assert pose.exposed_ns == ROBOT_POSE.exposed_ns


def test_age_counts_from_exposure_whatever_the_clocks_say(endpoint: str, server: Server) -> None:
    # The golden pose was exposed in another year and published 3 ms later: its age begins at 3 ms all the same.
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        until(lambda: server.tell(ROBOT_POSE) or feed.latest(10.0) is not None)
        pose = feed.latest(10.0)
        assert pose is not None
        first = pose.age_s
        assert 0.003 <= first < 5.0
        until(lambda: pose.age_s > first + 0.02)
        # Nothing that was exposed and published 3 ms apart is younger than that.
        assert feed.latest(max_age_s=0.0029) is None
        assert feed.latest(max_age_s=60.0) is not None
        # What took long before it was published is old on arrival.
        slow = replace(ROBOT_POSE, published_ns=ROBOT_POSE.exposed_ns + 2_000_000_000, sequence=43)
        until(lambda: server.tell(slow) or feed.latest(60.0).sequence == 43)  # type: ignore[union-attr]
        assert feed.latest(max_age_s=1.9) is None


def test_other_robots_poses_do_not_arrive(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        alpha, bravo = robots["alpha"], robots["bravo"]
        until(lambda: server.tell(ROBOT_POSE) or alpha.latest(10.0) is not None)
        assert bravo.latest(10.0) is None
    with PoseClient(endpoint) as robots, pytest.raises(InputError, match=r"robot id 'a/b' holds '/'"):
        robots["a/b"]


def test_a_program_that_does_not_close_its_client_ends_as_it_should(endpoint: str, server: Server) -> None:
    program = (
        "import sys, time\n"
        "from asterism.clients import PoseClient\n"
        "client = PoseClient(sys.argv[1])\n"
        "feed = client['alpha']\n"
        "while feed.latest(10.0) is None:\n"
        "    time.sleep(0.01)\n"
    )
    ending = subprocess.Popen([sys.executable, "-c", program, endpoint], stderr=subprocess.PIPE, text=True)
    until(lambda: server.tell(ROBOT_POSE) or ending.poll() is not None)
    assert (ending.returncode, ending.communicate()[1]) == (0, "")


def test_iteration_gives_the_newest_in_order_and_ends_with_the_client(endpoint: str, server: Server) -> None:
    robots = PoseClient(endpoint)
    feed = robots["alpha"]
    until(lambda: server.tell(ROBOT_POSE) or feed.latest(10.0) is not None)
    stop = threading.Event()

    def tell_many() -> None:
        for sequence in itertools.count(100):
            if stop.wait(0.001):
                return
            server.tell(replace(ROBOT_POSE, sequence=sequence))

    teller = threading.Thread(target=tell_many)
    teller.start()
    seen: list[int] = []
    for pose in feed:
        seen.append(pose.sequence)
        time.sleep(0.005)  # slower than they come: some are skipped
        if len(seen) == 20:
            stop.set()
            teller.join()
            robots.close()
    assert seen == sorted(seen)
    assert seen[-1] - seen[1] > 18


def test_a_client_may_start_first_and_finds_its_server_again(endpoint: str) -> None:
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        assert feed.latest(1.0) is None
        assert not robots.alive
        for sequence in (1, 2):
            server = Server(endpoint)
            until(lambda: robots.alive)
            told = replace(ROBOT_POSE, sequence=sequence)
            until(lambda told=told: server.tell(told) or (feed.wait(0.05) or told).sequence == told.sequence)  # noqa: B023
            until(lambda sequence=sequence: (p := feed.latest(10.0)) is not None and p.sequence == sequence)
            server.close()
            until(lambda: not robots.alive)


def test_visible_robots_are_shown_and_taken_back(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        alpha, bravo = robots["alpha"], robots["bravo"]
        server.publisher.show_visible(["alpha"])
        until(lambda: alpha.visible)
        assert not bravo.visible
        server.publisher.show_visible(["bravo"])
        until(lambda: bravo.visible and not alpha.visible)
        server.publisher.show_visible([])
        until(lambda: not bravo.visible)


def test_a_robot_does_not_follow_a_replay(endpoint: str) -> None:
    server = Server(endpoint, prefix="replay/")
    with PoseClient(endpoint) as robots, PoseClient(endpoint, prefix="replay/") as viewers:
        until(lambda: server.tell(ROBOT_POSE) or viewers["alpha"].latest(10.0) is not None)
        assert robots["alpha"].latest(10.0) is None
        assert viewers.alive
        assert not robots.alive
    server.close()


def test_the_rig_answers_and_only_what_belongs_on_the_wire_is_published(endpoint: str, server: Server) -> None:
    session = zenoh.open(client_config(endpoint))
    replies = [reply.ok for reply in session.get("asterism/*/rig")]
    assert [(r.payload.to_bytes(), str(r.encoding)) for r in replies if r is not None] == [
        (b"rig", "application/protobuf;asterism.RigReport")
    ]
    arrived: list[tuple[str, str]] = []
    session.declare_subscriber("**", lambda sample: arrived.append((str(sample.key_expr), str(sample.encoding))))
    told = Message("/tf", TRANSFORMS, b"x", 0, 0, 0)
    until(lambda: server.publisher.publish([told]) or server.tell(ROBOT_POSE) or len(arrived) > 2)
    assert set(arrived) == {("asterism/cam/robot/alpha/odometry", "application/protobuf;foxglove.Odometry")}
    session.close()


def test_a_rig_report_tells_the_whole_rig() -> None:
    from asterism.protocol.codec import encode_rig
    from tests.protocol.make_golden import RIG

    told = decode_rig(encode_rig(RIG))
    assert (told.camera, told.frame_id, told.width, told.height) == ("cam", "world", 1280, 1024)
    assert [len(robot.leds) for robot in told.robots] == [6]
    assert told.robots[0].points["tool"].z == -0.03
    assert told.rig_yaml == RIG.rig_text


def test_bytes_that_are_no_pose_are_said_and_ignored(
    endpoint: str, server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        until(lambda: server.tell(ROBOT_POSE) or feed.latest(10.0) is not None)
        key = keys.odometry("cam", "alpha")
        server.publisher.publish([Message(key, ODOMETRY, b"\x07no pose", 0, 0, 43)])
        until(lambda: caplog.messages)
        assert f"{key}: odometry message: 8 bytes that are no pose of Asterism" in caplog.text
        later = replace(ROBOT_POSE, sequence=44)
        until(lambda: server.tell(later) or feed.latest(10.0).sequence == 44)  # type: ignore[union-attr]
