"""What systemd is told, and the unit that comes with the pages."""

import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import load_rig
from asterism.server.service.serve import Outlets, Run
from asterism.server.service.stop import Stop
from asterism.server.service.systemd import OFTENER, Systemd
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.camera import Camera, Taken
from tests.helpers import REPOSITORY
from tests.service.nobody import Nobody

TIMEOUT_S = 20.0
UNIT = REPOSITORY / "docs" / "asterism.service"


class Manager:
    """As much of systemd as listens."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.settimeout(TIMEOUT_S)

    def next(self) -> str:
        return self.socket.recv(4096).decode()

    def heard(self) -> list[str]:
        """What has come by now."""
        told = []
        self.socket.setblocking(False)
        while True:
            try:
                told.append(self.socket.recv(4096).decode())
            except BlockingIOError:
                self.socket.settimeout(TIMEOUT_S)
                return told


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    made = Manager(str(tmp_path / "notify"))
    yield made
    made.socket.close()


def test_it_is_told_in_its_own_words(tmp_path: Path, manager: Manager) -> None:
    systemd = Systemd({"NOTIFY_SOCKET": str(tmp_path / "notify")})
    systemd.ready()
    systemd.alive()  # no watchdog was asked for
    systemd.reloading()
    systemd.stopping()
    first, (reloading, monotonic), last = manager.next(), manager.next().split("\n"), manager.next()
    assert (first, reloading, last) == ("READY=1", "RELOADING=1", "STOPPING=1")
    assert monotonic.startswith("MONOTONIC_USEC=")
    assert int(monotonic.partition("=")[2]) > 0


def test_abstract_sockets_are_named_with_an_at() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind("")  # the kernel draws an abstract name
        name: bytes = listener.getsockname()
        Systemd({"NOTIFY_SOCKET": f"@{name[1:].decode()}"}).ready()
        listener.settimeout(TIMEOUT_S)
        assert listener.recv(100) == b"READY=1"


def test_nobody_is_told_without_a_socket_or_where_there_is_none_any_more(tmp_path: Path) -> None:
    for environment in ({}, {"NOTIFY_SOCKET": str(tmp_path / "gone")}, {"NOTIFY_SOCKET": "x" * 300}):
        systemd = Systemd(environment)
        for tell in (systemd.ready, systemd.alive, systemd.stopping):
            tell()
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("watchdog", "beats"),
    [({"WATCHDOG_USEC": "4000000"}, 10), ({"WATCHDOG_USEC": "x"}, 0), ({"WATCHDOG_USEC": "4", "WATCHDOG_PID": "1"}, 0)],
)
def test_the_watchdog_hears_a_few_times_as_often_as_it_asks(
    tmp_path: Path, manager: Manager, watchdog: dict[str, str], beats: int
) -> None:
    now = [100.0]
    systemd = Systemd({"NOTIFY_SOCKET": str(tmp_path / "notify"), **watchdog}, lambda: now[0])
    for _ in range(600):
        systemd.alive()
        now[0] += 1 / 60
    assert manager.heard() == ["WATCHDOG=1"] * beats
    assert beats in (0, round(10.0 / (4.0 / OFTENER)))


class Device:
    """A camera that gives one image; then it waits for ``hang``, and is gone."""

    def __init__(self, hang: threading.Event) -> None:
        self.hang = hang
        self.images = 1

    def read(self) -> Taken | None:
        if self.images:
            self.images -= 1
            return Taken(np.zeros((1024, 1280), np.uint8))
        self.hang.wait(TIMEOUT_S)
        return None

    def close(self) -> None:
        """Nothing to let go of."""


def test_the_watchdog_hears_nothing_while_the_camera_hangs_and_something_while_it_is_away(
    tmp_path: Path, manager: Manager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "4000")
    hang, said = threading.Event(), threading.Event()
    devices = iter([Device(hang)])
    rig = load_rig(DEMO_RIG)
    camera = Camera("cam", lambda: next(devices, None), rig, lambda _: said.set())
    camera.retry_s = 0.01
    stop = Stop()
    run = Run(rig, camera, Outlets(Nobody()), stop, camera.clock)
    serving = threading.Thread(target=run.serve)
    serving.start()
    assert manager.next() == "READY=1"
    assert manager.next() == "WATCHDOG=1"  # of the frame
    # It hangs for longer than the loop waits for a frame.
    manager.socket.settimeout(1.2)
    with pytest.raises(TimeoutError):
        manager.next()
    assert not said.is_set()
    manager.socket.settimeout(TIMEOUT_S)
    hang.set()
    assert said.wait(TIMEOUT_S)  # it vanished
    assert manager.next() == "WATCHDOG=1"
    stop.set()
    serving.join(TIMEOUT_S)
    assert manager.heard()[-1] == "STOPPING=1"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed (systemd)")
def test_the_unit_is_one(tmp_path: Path) -> None:
    unit = tmp_path / UNIT.name
    text = UNIT.read_text()
    assert "ExecStart=/opt/asterism/bin/asterism serve " in text
    unit.write_text(text.replace("/opt/asterism/bin/asterism", "/bin/true"))
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
