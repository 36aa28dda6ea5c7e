"""The viewer beside a server: it shows what a review shows, holds up nobody, and ends with the server."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rerun", reason="rerun-sdk is not installed (pip install '.[review]')")

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig
from asterism.server.chain.frame import Frame
from asterism.server.service.drawer import draw
from asterism.server.service.live_view import LiveView
from asterism.server.service.loopback import free_port
from asterism.server.service.pictures import Picture
from asterism.server.service.rerun_program import Rerun
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.helpers import REPOSITORY
from tests.listening import LOOPBACK, family, free_ports, listening, wait_until_gone
from tests.service.published import published

PIPE = 60_000  # bytes, or a little more: then it is full
linux = pytest.mark.skipif(sys.platform != "linux", reason="processes and sockets are read from /proc")
SERVER = """
import sys, time
from asterism.protocol.rig import load_rig
from asterism.server.service.live_view import LiveView
with LiveView(load_rig(sys.argv[1])):
    print("shown", flush=True)
    time.sleep(600)
"""


@pytest.fixture(autouse=True)
def _no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(DEMO_RIG)


@pytest.fixture(scope="module")
def told(rig: Rig) -> list[tuple[list[Any], Frame]]:
    return list(published(rig, 2))


def test_what_is_drawn_is_what_a_review_draws_with_each_rig_in_turn(
    rig: Rig, told: list[tuple[list[Any], Frame]], tmp_path: Path
) -> None:
    viewer = Rerun(free_port(), "--save", str(tmp_path / "shown.rrd"))
    robots = {f"/world/robots/{robot.id}" for robot in rig.robots}
    wanted = robots | {"/world/camera/image", "/world/camera/image/spots", "/robots", "/plots/latency/solving"}
    new = replace(rig, robots=(*rig.robots[1:], replace(rig.robots[0], id="new")))
    wanted.add("/world/robots/new/plate")
    try:
        draw(iter([rig, picture(*told[0]), new, picture(*told[1])]), viewer)
        until = time.monotonic() + 30.0
        while not wanted <= (entities := in_file(tmp_path / "shown.rrd")):
            assert time.monotonic() < until, wanted - entities
            time.sleep(0.05)
    finally:
        viewer.close()


@linux
def test_a_viewer_that_takes_nothing_holds_up_nobody_and_ends(rig: Rig, told: list[tuple[list[Any], Frame]]) -> None:
    port = free_ports(2)
    with LiveView(rig, str(port)) as view:
        processes, until = family(view.pid), time.monotonic() + 30.0
        while not {port, port + 1} < {p for _, p in listening(processes)}:  # and where the page's files come from
            assert time.monotonic() < until
            processes = family(view.pid)
        assert {address for address, _ in listening(processes)} <= LOOPBACK
        os.kill(view.pid, signal.SIGSTOP)
        pipe = view._process.stdin
        assert pipe is not None
        while waiting(pipe.fileno()) < PIPE:
            view.write(*told[0])
    wait_until_gone(processes)


@linux
def test_ctrl_c_does_not_reach_it_and_it_ends_with_a_server_that_is_killed() -> None:
    server = subprocess.Popen([sys.executable, "-c", SERVER, DEMO_RIG], stdout=subprocess.PIPE, cwd=REPOSITORY)
    assert server.stdout is not None
    with server.stdout:
        assert server.stdout.readline() == b"shown\n"
        started = family(server.pid) - {server.pid}
        assert len(started) >= 2  # what draws, and the viewer
        assert not any(os.getpgid(pid) == os.getpgid(server.pid) for pid in started)
        server.kill()
        server.wait()
    wait_until_gone(started)


def test_a_port_in_use_is_refused_before_anything_is_shown(rig: Rig) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"--web {port}: port {port} cannot be listened on") as refused:
            LiveView(rig, str(port))
    assert "\n" not in str(refused.value)


def waiting(pipe: int) -> int:
    """Bytes that nobody has read."""
    import fcntl
    import termios

    return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)


def in_file(path: Path) -> set[str]:
    """Entities of a file that is being written; none while its last message is cut off."""
    import rerun as rr

    with (
        contextlib.suppress(OSError, RuntimeError, ValueError),
        warnings.catch_warnings(action="ignore", category=rr.error_utils.RerunWarning),
    ):
        return {chunk.entity_path for chunk in rr.chunk.RrdReader(path).stream()}
    return set()


def picture(messages: list[Any], frame: Frame) -> Picture:
    return Picture(frame.image, frame.exposed_ns, frame.index, messages[-1].payload)
