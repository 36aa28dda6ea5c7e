"""`asterism router`: servers and clients meet there, it listens where it was told, and what went away comes back."""

import logging
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh

from asterism.clients import LinkState, PoseClient
from asterism.protocol.errors import InputError
from asterism.protocol.network import endpoints_of, open_router, router_config
from asterism.server.service.on_air import OnAir, Place, on_air
from asterism.server.service.router import Visitors, remark
from asterism.server.service.say import SAID
from asterism.server.sources.session_clock import SessionClock
from tests.clients.serving import tell, until
from tests.listening import family, listening
from tests.protocol.make_golden import RIG
from tests.servers import asterism, free_endpoint, running, wait_for_line


@contextmanager
def router(*listen: str, connect: tuple[str, ...] = ()) -> Iterator[zenoh.Session]:
    with open_router(router_config(listen, connect)) as session:
        yield session


@contextmanager
def served(place: Place, camera: str = "cam") -> Iterator[OnAir]:
    rig = replace(RIG, camera=replace(RIG.camera, name=camera))
    with on_air(place, rig, SessionClock(), lambda: None) as air:
        yield air


def hears(client: PoseClient, air: OnAir) -> bool:
    """Tell a pose, and look whether one is there that is of now."""
    tell(air)
    return client["alpha"].latest(1.0) is not None


def test_killed_and_started_again_it_brings_everything_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, SAID)
    endpoint, systemd = free_endpoint(), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    systemd.bind(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    with running("router", "--listen", endpoint) as first:
        wait_for_line(first, f"router at {endpoint}")
        port = int(endpoint.rpartition(":")[2])
        assert listening(family(first.pid)) == {("0100007F", port)}
        with served(Place(connect=endpoint)) as air, PoseClient(endpoint) as client:
            until(lambda: hears(client, air))
            assert "client" in wait_for_line(first, "connected: tcp/127.0.0.1:")
            wait_for_line(first, "camera 'cam': its server is there")
            first.kill()
            first.wait()
            until(lambda: tell(air) or client.link.state in (LinkState.GONE, LinkState.SILENT))
            with running("router", "--listen", endpoint) as again:
                until(lambda: hears(client, air))
                wait_for_line(again, "camera 'cam': its server is there")
                again.send_signal(signal.SIGINT)
                told = again.communicate(timeout=30)[1]
    gone, back, *_ = (text for text in caplog.messages if text.startswith("the router at"))  # the server says so
    assert gone == f"the router at {endpoint} is gone: nobody hears what is published until it is back"
    assert back.startswith(f"the router at {endpoint} is back, after ")
    with systemd:
        assert [systemd.recv(100) for _ in range(3)] == [b"READY=1", b"READY=1", b"STOPPING=1"]
    assert again.returncode == 0
    assert "stopped after 0:00:0" in told
    assert "cameras heard: cam" in told


def test_two_that_are_linked_pass_on_to_each_other() -> None:
    hall, office = free_endpoint(), free_endpoint()
    with router(hall), router(office, connect=(hall,)) as session, served(Place(connect=hall)) as air:
        said: list[str] = []
        visitors = Visitors(session, (hall,), said.append)
        with PoseClient(office) as client:
            until(lambda: (visitors.step(), hears(client, air))[1])
            until(lambda: (visitors.step(), len(said) >= 3)[1])
        visitors.close()
    assert any(f"{hall} (router)" in line for line in said)
    assert "camera 'cam': its server is there" in said


def test_a_router_to_link_to_may_come_later_and_that_is_said() -> None:
    hall, office = free_endpoint(), free_endpoint()
    said: list[str] = []
    with router(office, connect=(hall,)) as session:
        visitors = Visitors(session, (hall,), said.append, iter(range(0, 10_000, 10)).__next__)
        visitors.step()
        assert said == [f"not linked yet to every router of {hall}; it is tried on and on ..."]
        with router(hall):
            until(lambda: (visitors.step(), len(said) == 2)[1])
            assert said[1] == f"connected: {hall} (router)"
        until(lambda: (visitors.step(), len(said) == 3)[1])
        assert said[2].startswith(f"gone: {hall} (router), after 0:")
        visitors.close()
        assert visitors.summary() == ["1 connections came, at most 1 at once; 0 are there at the end"]


def test_it_listens_on_loopback_unless_told_otherwise_and_says_what_that_means(tmp_path: Path) -> None:
    assert endpoints_of(router_config(), "listen") == ["tcp/127.0.0.1:7447"]
    options = tmp_path / "router.json5"
    options.write_text('{listen: {endpoints: {router: ["tcp/127.0.0.1:1", "tcp/[::1]:2"]}}}')
    assert endpoints_of(router_config(options=options), "listen") == ["tcp/127.0.0.1:1", "tcp/[::1]:2"]
    for here in ("tcp/127.0.0.1:7447", "tls/localhost:1", "tcp/[::1]:7447", "unixsock-stream//run/asterism"):
        assert remark([here], False) == ""
    assert "whoever reaches tcp/0.0.0.0:7447 may publish" in remark(["tcp/127.0.0.1:1", "tcp/0.0.0.0:7447"], False)
    assert remark(["tcp/0.0.0.0:7447"], True) == ""


def test_what_cannot_be_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        done = asterism("router", "--listen", where)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        f"asterism: {where}: the endpoint is already in use (a server, or another router?); expected a free one: "
        "--listen tcp/ADDRESS:PORT\n"
    )
    for listen, words in (
        ("tcp/192.0.2.1:7447", "this machine does not have that address"),
        ("tcp/7447", "expected tcp/HOST:PORT"),
        ("tcp/no-such-host.invalid:7447", "zenoh cannot be a router there: failed to lookup"),
        ("tls/127.0.0.1:7447", "zenoh cannot be a router there: .* Missing TLS private key"),
    ):
        with pytest.raises(InputError, match=f"{words}"):
            open_router(router_config([listen]))
    with pytest.raises(InputError, match="expected PROTOCOL/ADDRESS"):
        router_config(connect=["nonsense"])
    options = tmp_path / "client.json5"
    options.write_text('{mode: "client"}')
    with pytest.raises(InputError, match=r'client\.json5: mode is "client", expected "router", or none'):
        router_config(options=options)
