"""zenoh sessions and the publisher, in one process on loopback."""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from asterism.protocol.codec import decode_rig, encode_rig
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.messages import PROTOCOL, TRANSFORMS, Message
from asterism.protocol.network import check_endpoint, client_config, open_server, server_config, short_of_buffer
from tests.clients.serving import Server, until
from tests.protocol.make_golden import RIG
from tests.servers import free_endpoint


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server(free_endpoint())
    yield made
    made.close()


def value(config: zenoh.Config, key: str) -> object:
    return json.loads(config.get_json(key))


def test_by_default_everything_stays_on_loopback_and_nobody_is_scouted() -> None:
    server, client = server_config(), client_config()
    assert value(server, "mode") == "peer"
    assert value(server, "listen/endpoints") == ["tcp/127.0.0.1:7447"]
    assert value(client, "mode") == "client"
    assert value(client, "connect/endpoints") == ["tcp/127.0.0.1:7447"]
    assert value(client, "listen/endpoints") == []
    for config in (server, client):
        assert value(config, "scouting/multicast/enabled") is False
        assert value(config, "transport/link/tx/queue/size/data") == 16


def test_arguments_say_where() -> None:
    assert value(server_config(listen="tcp/0.0.0.0:9"), "listen/endpoints") == ["tcp/0.0.0.0:9"]
    joined = server_config(connect="tcp/10.0.0.1:7447")
    assert (value(joined, "mode"), value(joined, "listen/endpoints")) == ("client", [])
    assert value(joined, "connect/endpoints") == ["tcp/10.0.0.1:7447"]


def test_sockets_hold_little_unless_the_endpoint_says_so() -> None:
    assert short_of_buffer("tcp/10.0.0.1:7447") == "tcp/10.0.0.1:7447#so_sndbuf=32768"
    assert short_of_buffer("tls/10.0.0.1:7447#iface=eth0") == "tls/10.0.0.1:7447#iface=eth0;so_sndbuf=32768"
    for own in ("tls/10.0.0.1:7447#so_sndbuf=1000000", "udp/10.0.0.1:7447"):
        assert short_of_buffer(own) == own


def test_a_users_file_holds_unless_an_argument_says_otherwise(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(
        "{mode: 'router', listen: {endpoints: ['tcp/127.0.0.1:9']}, scouting: {multicast: {enabled: true}}}"
    )
    config = server_config(options=file)
    assert value(config, "mode") == "router"
    assert value(config, "listen/endpoints") == ["tcp/127.0.0.1:9"]
    assert value(config, "scouting/multicast/enabled") is True
    assert value(server_config(listen="tcp/127.0.0.1:8", options=file), "listen/endpoints") == ["tcp/127.0.0.1:8"]
    # A file that says nothing of endpoints leaves the server on loopback.
    file.write_text("{mode: 'router'}")
    assert value(server_config(options=file), "listen/endpoints") == ["tcp/127.0.0.1:7447"]
    # Access control of the file's own replaces ours as a whole.
    file.write_text("{access_control: {enabled: false, default_permission: 'allow'}}")
    assert value(server_config(options=file), "access_control/rules") is None
    assert value(server_config(), "access_control/enabled") is True


@pytest.mark.parametrize("text", ["{mode: ", "{no_such_option: 1}", "\xff"])
def test_a_file_that_is_no_zenoh_configuration_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"zenoh\.json5: (is no zenoh configuration|is no text in UTF-8)"):
        server_config(options=file)
    with pytest.raises(InputError, match=r"nowhere\.json5: no such file"):
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


def test_the_rig_answers_and_only_what_belongs_on_the_wire_is_published(server: Server) -> None:
    session = zenoh.open(client_config(server.endpoint))
    (reply,) = [reply.ok for reply in session.get("asterism/*/rig")]
    assert reply is not None
    assert str(reply.encoding) == "application/protobuf;asterism.RigReport"
    told = decode_rig(reply.payload.to_bytes())
    assert (told.camera, told.rig_yaml, told.pid) == ("cam", RIG.rig_text, os.getpid())
    assert (told.session, told.protocol, told.rate) == (server.clock.session, PROTOCOL, 1.0)
    assert 0 <= server.clock.now_ns() - told.time_ns < 60e9
    arrived: list[tuple[str, str]] = []
    session.declare_subscriber("**", lambda sample: arrived.append((str(sample.key_expr), str(sample.encoding))))
    inside = Message("/tf", TRANSFORMS, b"x", 0, 0, 0)
    until(lambda: [server.publisher.publish([inside]), server.tell()] and len(set(arrived)) > 1)
    assert set(arrived) == {
        ("asterism/cam/robot/alpha/odometry", "application/protobuf;foxglove.Odometry"),
        ("asterism/cam/beat", "application/protobuf;asterism.Beat"),
    }
    session.close()


def test_a_rig_report_tells_the_whole_rig() -> None:
    told = decode_rig(encode_rig(RIG))
    assert (told.camera, told.frame_id, told.width, told.height) == ("cam", "world", 1280, 1024)
    assert [len(robot.leds) for robot in told.robots] == [6]
    assert told.robots[0].points["tool"].z == -0.03
    assert told.rig_yaml == RIG.rig_text
