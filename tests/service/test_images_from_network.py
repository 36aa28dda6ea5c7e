"""A camera on another host: a stranger's program publishes images, a server localizes them, a client has the poses."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from asterism.server.__main__ import main
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.helpers import REPOSITORY
from tests.servers import Subscriber, asterism, free_endpoint, running, wait_for_line

FRAMES, KEY = 6, "cell/cam"


class PlainCamera:
    """tests/sources/foreign/plain_camera.py in a process of its own."""

    def __init__(self, *arguments: object) -> None:
        command = [sys.executable, "tests/sources/foreign/plain_camera.py", *map(str, arguments)]
        self._process = subprocess.Popen(
            command, cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def run(self) -> None:
        """Publish all."""
        self._process.communicate("\n", timeout=60)
        assert self._process.returncode == 0


def test_a_camera_on_another_host_is_served_and_waited_for(tmp_path: Path) -> None:
    done = asterism("simulate", DEMO_RIG, tmp_path / "sim", "--frames", FRAMES, "--seed", 4)
    assert done.returncode == 0, done.stderr
    rig, frames, endpoint = tmp_path / "sim" / "rig.yaml", tmp_path / "sim" / "frames", free_endpoint()
    truth = [json.loads(line) for line in (tmp_path / "sim" / "truth.jsonl").read_text().splitlines()]
    with running("serve", rig, f"zenoh:{KEY}", "--listen", endpoint) as server:
        wait_for_line(server, "serving 5 robots")
        wait_for_line(server, f"zenoh:{KEY}: no images for 1.0 s; waiting for them")
        subscriber = Subscriber(endpoint, tmp_path / "received.jsonl")
        # Its clock is a minute behind.
        PlainCamera(endpoint, KEY, frames, 3 * FRAMES, 20, "raw", -60).run()
        wait_for_line(server, f"zenoh:{KEY}: images come")
        wait_for_line(server, f"zenoh:{KEY}: no images for")
        PlainCamera(endpoint, KEY, frames, FRAMES, 20, "png").run()
        wait_for_line(server, f"zenoh:{KEY}: images come")
        server.terminate()
        received = subscriber.finish()
        assert server.wait(timeout=60) == 0
    poses = [entry for entry in received if "robot" in entry]
    assert {entry["robot"] for entry in poses} == {robot["id"] for robot in truth[0]["robots"]}
    numbers = {int(entry["metadata"]["sequence"]) for entry in poses}
    assert max(numbers) >= 3 * FRAMES  # of the second camera
    for entry in poses:
        place = truth[int(entry["metadata"]["sequence"]) % FRAMES]
        (true,) = [robot for robot in place["robots"] if robot["id"] == entry["robot"]]
        assert np.linalg.norm(np.array(entry["position"]) - true["position"]) < 0.01
        assert 0 <= entry["received_ns"] - entry["exposed_ns"] < 20e9


def test_a_key_under_which_nobody_is_heard_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", str(DEMO_RIG), "zenoh:asterism/cam/image", "--listen", free_endpoint()]) == 2
    assert "nobody else speaks under asterism/**; publish under another key" in capsys.readouterr().err
