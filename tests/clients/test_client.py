"""PoseClient and a publisher, in one process on loopback."""

import itertools
import threading
import time
from dataclasses import replace

import pytest

from asterism.clients import LinkState, PoseClient
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry
from asterism.protocol.errors import InputError
from asterism.protocol.network import open_server
from asterism.server.sources.session_clock import SessionClock
from tests.clients.serving import COVARIANCE, Server, until
from tests.protocol.make_golden import ROBOT_POSE


def test_a_pose_arrives_with_everything_it_was_sent_with(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        until(lambda: robots.alive)
        arrived = threading.Event()
        feed.on_pose(lambda _: arrived.set())
        until(lambda: server.tell() or arrived.wait(0.05))
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
        assert pose.covariance.tolist() == COVARIANCE.tolist()
        assert pose.session == server.clock.session


def test_other_robots_poses_do_not_arrive(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        alpha, bravo = robots["alpha"], robots["bravo"]
        until(lambda: server.tell() or alpha.latest(10.0) is not None)
        assert bravo.latest(10.0) is None
    with PoseClient(endpoint) as robots, pytest.raises(InputError, match=r"robot id 'a/b' holds '/'"):
        robots["a/b"]


def test_iteration_gives_the_newest_in_order_and_ends_with_the_client(endpoint: str, server: Server) -> None:
    robots = PoseClient(endpoint)
    feed = robots["alpha"]
    until(lambda: server.tell() or feed.latest(10.0) is not None)
    stop = threading.Event()

    def tell_many() -> None:
        for sequence in itertools.count(100):
            if stop.wait(0.001):
                return
            server.tell(sequence=sequence)

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


def test_iteration_begins_with_what_is_new_and_ends_when_nothing_comes(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        numbers = itertools.count()
        until(lambda: server.tell(sequence=next(numbers)) or feed.latest(10.0) is not None)
        last = next(numbers)
        server.tell(sequence=last)
        until(lambda: (p := feed.latest(10.0)) and p.sequence == last)
        assert list(feed.poses(timeout_s=0.01)) == []
        assert feed.wait(0.01) is None
        poses = feed.poses(timeout_s=20.0)
        server.tell(sequence=last + 1)
        assert next(poses).sequence == last + 1


def test_a_client_may_start_first_and_finds_its_server_again(endpoint: str) -> None:
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        assert feed.latest(1.0) is None
        assert not robots.alive
        assert robots.link.state is LinkState.WAITING
        for sequence in (1, 2):
            server = Server(endpoint)
            until(lambda: robots.alive)
            until(lambda s=server, n=sequence: s.tell(sequence=n) or ((p := feed.latest(10.0)) and p.sequence == n))
            server.close()
            until(lambda: not robots.alive)
            assert robots.link.state is LinkState.GONE
            # The pose is still there, as old as it is.
            assert feed.latest(60.0) is not None


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
        until(lambda: server.tell() or viewers["alpha"].latest(10.0) is not None)
        assert robots["alpha"].latest(10.0) is None
        assert viewers.alive
        assert not robots.alive
    server.close()


def test_all_robots_come_through_one_feed(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        everyone = robots.all()
        poses = everyone.poses(timeout_s=20.0)

        def tell() -> None:
            for robot in ("alpha", "bravo"):
                server.tell(robot=robot)

        until(lambda: tell() or len(everyone.latest(10.0)) == 2)
        assert {robot: pose.robot for robot, pose in everyone.latest(10.0).items()} == {
            "alpha": "alpha",
            "bravo": "bravo",
        }
        assert {next(poses).robot, next(poses).robot} == {"alpha", "bravo"}
        assert robots.all() is everyone


def test_a_publisher_that_answers_for_no_rig_is_aged_by_its_least_delay(endpoint: str) -> None:
    # A stranger's program, or a server of version 0.1: no beat, no session, no clock.
    stranger, clock = open_server(endpoint), SessionClock()
    pose = replace(ROBOT_POSE, covariance=COVARIANCE, session=0)

    def put(exposed_s: float, published_s: float) -> None:
        now_ns = clock.now_ns() - 10 * 365 * 86_400 * 10**9  # its clock is ten years late
        told = replace(pose, exposed_ns=now_ns - round(exposed_s * 1e9), published_ns=now_ns - round(published_s * 1e9))
        stranger.put(keys.odometry("cam", "alpha"), encode_odometry(told))

    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        until(lambda: put(0.005, 0.001) or feed.latest(0.1))
        # What went out three seconds ago, and comes only now, is old.
        until(lambda: put(3.1, 3.0) or (feed.latest(60.0) and not feed.latest(2.9)))
        until(lambda: put(3.1, 3.0) or feed.late)
        until(lambda: put(0.005, 0.001) or feed.latest(0.1))
        assert feed.late > 0
        assert not feed.refused
    stranger.close()
