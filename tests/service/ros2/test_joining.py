"""Nodes of ROS 2 that join a server's listener: it is the router they expect, and nobody speaks for its robots."""

import contextlib
import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import zenoh
import zenoh.ext

from asterism.clients import LinkState, PoseClient
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry
from asterism.protocol.messages import ODOMETRY as ODOMETRY_KIND
from asterism.protocol.messages import Message
from asterism.protocol.network import client_config, server_config
from asterism.protocol.ros2 import types
from asterism.protocol.ros2.names import RosPlace
from asterism.protocol.ros2.wire import End, NodeName, Quality, topic_key
from asterism.server.service.on_air import OnAir
from asterism.server.service.ros2.outlet import Ros2
from tests.clients.serving import COVARIANCE, until
from tests.protocol.make_golden import ROBOT_POSE
from tests.servers import open_router
from tests.service.ros2.independent import FRAME, frame_of, pose, telling

PLACE = RosPlace(7, "/lab")
ODOM = topic_key(7, "/lab/alpha/odom", types.ODOMETRY)
POSE = topic_key(7, "/lab/alpha/pose", types.POSE_WITH_COVARIANCE_STAMPED)
TF_STATIC = topic_key(7, "/tf_static", types.TF_MESSAGE)
TF = topic_key(7, "/tf", types.TF_MESSAGE)


@contextlib.contextmanager
def node(endpoint: str) -> Iterator[zenoh.Session]:
    """A session as rmw_zenoh opens it by its default configuration: a peer that connects to a router."""
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("connect/endpoints", [endpoint]),
        ("listen/endpoints", ["tcp/127.0.0.1:0"]),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/target", {"router": ["router", "peer"], "peer": ["router"]}),
        ("scouting/gossip/autoconnect_strategy", {"peer": {"to_router": "always", "to_peer": "greater-zid"}}),
        ("timestamping/enabled", True),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


Server = tuple[str, Ros2, OnAir]


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """One for all: nothing that nodes do changes it."""
    with telling(PLACE) as opened:
        yield opened


def test_nodes_find_the_router_that_they_wait_for_and_one_another(server: Server) -> None:
    with node(server[0]) as talker, node(server[0]) as listener:
        heard: list[str] = []
        with listener.declare_subscriber("7/chatter/*/*", lambda sample: heard.append(str(sample.key_expr))):
            assert list(talker.info.routers_zid())

            def reaches() -> bool:
                talker.put("7/chatter/std_msgs::msg::dds_::String_/h", b"")
                return bool(heard)

            until(reaches)


def test_a_router_of_others_carries_everything_to_their_nodes(rng: np.random.Generator) -> None:
    with open_router() as (endpoint, _), telling(PLACE, router=endpoint) as (_, outlet, _), node(endpoint) as listener:
        heard: list[str] = []

        def hear(sample: zenoh.Sample) -> None:
            heard.append(str(sample.key_expr))

        def told() -> bool:
            outlet.write(frame_of([pose(0, rng)]), FRAME)
            return {ODOM, TF_STATIC} <= set(heard)

        with (
            listener.declare_subscriber(ODOM, hear),
            zenoh.ext.declare_advanced_subscriber(
                listener, TF_STATIC, hear, history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            ),
        ):
            until(told)
        assert heard.count(TF_STATIC) == 1  # what was told before it came


def test_robots_hear_a_server_that_is_a_router_as_any_other(server: Server) -> None:
    endpoint, _, air = server
    with PoseClient(endpoint) as robots:
        feed, clock = robots["alpha"], air.publisher.clock

        def told() -> bool:
            now = replace(
                ROBOT_POSE,
                covariance=COVARIANCE,
                exposed_ns=clock.now_ns(),
                published_ns=0,
                session=clock.session,
            )
            air.publisher.publish(
                [Message(keys.odometry("cam", "alpha"), ODOMETRY_KIND, encode_odometry(now), 0, 0, 42)]
            )
            return feed.wait(0.02) is not None

        until(told)
        until(lambda: robots.link.state is LinkState.LIVE)  # its beat and its rig are heard, its token is seen


def test_without_ros_the_server_is_a_peer_as_before() -> None:
    assert server_config().get_json("mode") == '"peer"'
    assert server_config(ros_keys=[]).get_json("mode") == '"router"'
    joined = server_config(connect="tcp/127.0.0.1:7447", ros_keys=[])
    assert (joined.get_json("mode"), joined.get_json("timestamping/enabled")) == ('"client"', "true")


def test_nobody_else_publishes_poses_through_the_listener(server: Server) -> None:
    endpoint, _, _ = server
    with zenoh.open(client_config(endpoint)) as stranger, zenoh.open(client_config(endpoint)) as robot:
        heard: list[str] = []

        def hear(sample: zenoh.Sample) -> None:
            heard.append(str(sample.key_expr))

        with robot.declare_subscriber("7/**", hear), robot.declare_subscriber("7/**/@adv/**", hear):

            def passes() -> bool:
                for key in (ODOM, POSE, f"{ODOM}/@adv/pub/1/2/_"):
                    stranger.put(key, b"false")
                    stranger.delete(key)
                stranger.put(TF, b"its own")  # as every node may
                return TF in heard

            until(passes)
        assert set(heard) == {TF}


def test_the_robots_hear_the_server(server: Server, rng: np.random.Generator) -> None:
    endpoint, outlet, _ = server
    with zenoh.open(client_config(endpoint)) as robot:
        heard: list[tuple[str, int]] = []

        def hear(sample: zenoh.Sample) -> None:
            assert sample.attachment is not None
            heard.append((str(sample.key_expr), len(sample.attachment)))

        with robot.declare_subscriber("7/**", hear):

            def told() -> bool:
                outlet.write(frame_of([pose(0, rng)]), FRAME)
                return {ODOM, POSE, TF} <= {key for key, _ in heard}

            until(told)
        assert {length for _, length in heard} == {33}


def test_nobody_else_holds_their_tokens_or_answers_for_them(server: Server) -> None:
    endpoint, _, air = server
    with zenoh.open(client_config(endpoint)) as stranger, zenoh.open(client_config(endpoint)) as robot:
        name = NodeName(7, "", "stranger", str(stranger.info.zid()))
        kind, quality = types.ODOMETRY, Quality()
        false = name.token_of(End.PUBLISHER, 1, "/lab/alpha/odom", kind, quality)
        listens = name.token_of(End.SUBSCRIBER, 2, "/lab/alpha/odom", kind, quality)
        own = name.token_of(End.PUBLISHER, 3, "/stranger/odom", kind, quality)
        tokens = [stranger.liveliness().declare_token(token) for token in (false, listens, own)]
        cache = stranger.declare_queryable(
            f"{ODOM}/@adv/pub/1/2/_", lambda query: query.reply(query.key_expr, b"false"), complete=True
        )

        def seen() -> set[str]:
            return {str(reply.ok.key_expr) for reply in robot.liveliness().get("@ros2_lv/7/**") if reply.ok is not None}

        until(lambda: {listens, own} <= seen())
        assert false not in seen()
        ours = {token for token in seen() if token.split("/")[2] == str(air.session.info.zid())}
        ends = [token.split("/") for token in ours]
        assert sorted(end[9].replace("%", "/") for end in ends if end[5] == "MP") == [
            "/diagnostics",
            "/lab/alpha/odom",
            "/lab/alpha/pose",
            "/tf",
            "/tf_static",
        ]
        assert ["/".join(end[5:]) for end in ends if end[5] == "NN"] == ["NN/%/%lab/asterism_cam"]
        assert not [reply for reply in robot.get(f"{ODOM}/@adv/**", timeout=0.5) if reply.ok is not None]
        for thing in (*tokens, cache):
            thing.undeclare()
