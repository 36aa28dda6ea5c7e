"""Left running: a terminal that closes, a start after kill -9 while other servers record into the same folder."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from asterism.clients import PoseClient
from asterism.recordings.held import WRITER, hold
from asterism.recordings.reader import Recording
from asterism.recordings.room import RESERVE
from asterism.server.__main__ import main
from asterism.server.service.recovery import LOWEST, Recovery
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.servers import free_endpoint, running, wait_for_line

TIMEOUT_S = 60.0
HEAD_BYTES = 10_000  # a file that has more holds messages


def test_a_terminal_that_closes_does_not_end_it(tmp_path: Path) -> None:
    """Nor does a log on a full disk: SIGHUP has the rig read again, what is written to the terminal is lost."""
    endpoint, log = free_endpoint(), tmp_path / "serve.log"
    master, terminal = os.openpty()
    words = ["serve", DEMO_RIG, "sim", "--listen", endpoint, "--record", tmp_path, "--log", log]
    # A session of its own, of which this is the terminal.
    code = (
        "import fcntl, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
        "from asterism.server.__main__ import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", code, *map(str, words)]
    with subprocess.Popen(command, stdin=terminal, stdout=terminal, stderr=terminal, start_new_session=True) as server:
        try:
            os.close(terminal)
            with PoseClient(endpoint) as robots:
                assert robots["alpha"].wait(TIMEOUT_S) is not None
                os.close(master)
                wait_for(lambda: "the rig was read again; it is in force" in log.read_text())
                for _ in range(20):
                    assert robots["alpha"].wait(TIMEOUT_S) is not None
            server.send_signal(signal.SIGTERM)
            assert server.wait(TIMEOUT_S) == 0
        finally:
            server.kill()
    folder = next(tmp_path.glob("demo-*"))
    assert not {RESERVE, WRITER} & {path.name for path in folder.iterdir()}
    assert f"stopped after {Recording(folder).count_frames()} frames" in log.read_text()
    assert "Traceback" not in log.read_text()


def wait_for(true: Callable[[], object]) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_start_after_kill_9_recovers_what_nobody_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with running("serve", DEMO_RIG, "sim", "--listen", free_endpoint(), "--record", tmp_path) as killed:
        wait_for_line(killed, "recording to")
        cut = next(tmp_path.glob("demo-*"))
        poses = cut / "poses-0001.mcap"
        wait_for(lambda: poses.exists() and poses.stat().st_size > HEAD_BYTES)
        killed.kill()
        killed.wait()
    # Others of the folder: of a server that lives, of another camera, and what a process left that was no recording.
    for name in ("demo-living", "other-1", "demo-empty"):
        (tmp_path / name).mkdir()
    living = hold(tmp_path / "demo-living", "demo")
    hold(tmp_path / "other-1", "other").release(whole=False)
    hold(tmp_path / "demo-empty", "demo").release(whole=False)
    with running("serve", DEMO_RIG, "sim", "--listen", free_endpoint(), "--record", tmp_path) as again:
        said = wait_for_line(again, f"{cut}: recovered in")
        assert "poses-0001.mcap: " in said
        assert "messages over" in said
        assert "demo-empty: could not be recovered" in wait_for_line(again, "demo-empty: could not")
        own = next(path.parent for path in tmp_path.glob(f"*/{WRITER}") if path.parent.name[5:7] == "20")
        assert main(["recover", str(own)]) == 2
        assert f"is being written by process {again.pid}" in capsys.readouterr().err
        again.send_signal(signal.SIGINT)
        assert again.wait(TIMEOUT_S) == 0
    assert {path.parent.name for path in tmp_path.glob(f"*/{WRITER}")} == {"demo-living", "other-1", "demo-empty"}
    for folder in (cut, own):
        recording = Recording(folder)
        assert recording.count_frames() > 0
        assert recording.count_messages() > 0
    assert not (cut / RESERVE).exists()
    living.release()


def test_recovery_waits_for_the_camera_and_is_of_the_lowest_priority(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cam-1").mkdir()
    hold(tmp_path / "cam-1", "cam").release(whole=False)
    nice: list[tuple[int, int, int]] = []
    monkeypatch.setattr(os, "setpriority", lambda *of: nice.append(of))
    said: list[str] = []
    with Recovery(tmp_path, "cam", said.append):
        pass
    assert said == []
    with Recovery(tmp_path, "cam", said.append) as recovery:
        recovery.begin()
        recovery.begin()
        wait_for(lambda: nice)
    assert [(which, priority) for which, _, priority in nice] == [(os.PRIO_PROCESS, LOWEST)]
    assert said[0] == f"{tmp_path / 'cam-1'}: was cut off; recovering it ..."
