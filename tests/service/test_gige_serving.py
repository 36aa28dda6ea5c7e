"""A GigE Vision camera (Aravis' emulated one) through the command line to a stranger's subscriber."""

import json
import signal
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from asterism.protocol.codec import decode_frame_report
from asterism.protocol.messages import Clock
from asterism.recordings.reader import Recording
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.servers import Subscriber, asterism, free_endpoint, running, wait_for_line
from tests.sources.genicam.fake_camera import ADDRESS, fake_camera
from tests.wire_bytes import received_bytes

FILM, FRAMES = 8, 24


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[dict[str, Any]], Path, Path]:
    """What a subscriber received of the simulator's frames over GigE Vision, the rig, and the recording."""
    folder, endpoint = tmp_path_factory.mktemp("gige"), free_endpoint()
    assert asterism("simulate", DEMO_RIG, folder / "sim", "--frames", FILM, "--seed", 4).returncode == 0
    files = sorted((folder / "sim" / "frames").glob("*.png"))
    film = np.stack([cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files])
    rig = folder / "sim" / "rig.yaml"
    command = ("serve", rig, f"genicam:{ADDRESS}", "--listen", endpoint, "--record", folder)
    with fake_camera(folder, film, "--packet", "9000") as emulator, running(*command) as server:
        wait_for_line(server, "recording to")
        listener = Subscriber(endpoint, folder / "received.jsonl")
        began = emulator.sent()
        poll = threading.Event()
        while emulator.sent() < began + FRAMES:
            poll.wait(0.05)
        server.send_signal(signal.SIGINT)
        received = listener.finish()
        assert server.wait(timeout=60) == 0
    return received, rig, next(folder.glob("demo-*"))


def test_poses_are_those_of_the_same_frames_with_the_same_times_from_files(
    served: tuple[list[dict[str, Any]], Path, Path], tmp_path: Path
) -> None:
    """Bit for bit. The frames that were solved are those of the recording, as images and a times.csv."""
    received, rig, recording = served
    lines = ["frame,exposed_ns"]
    (tmp_path / "frames").mkdir()
    for image, exposed_ns, index in Recording(recording).frames():
        name = f"{index:06d}.png"
        cv2.imwrite(str(tmp_path / "frames" / name), image)
        lines.append(f"{name},{exposed_ns}")
    (tmp_path / "frames" / "times.csv").write_text("\n".join(lines))
    done = asterism("locate", rig, tmp_path / "frames", "-o", tmp_path / "poses.jsonl")
    assert done.returncode == 0, done.stderr
    located = {
        (robot["id"], line["exposed_ns"]): robot
        for line in map(json.loads, (tmp_path / "poses.jsonl").read_text().splitlines())
        for robot in line["robots"]
    }
    told = [entry for entry in received if "robot" in entry]
    assert len(told) > 20
    for entry in told:
        robot = located[entry["robot"], entry["exposed_ns"]]
        assert robot["position"] == entry["position"]
        assert robot["orientation"] == entry["orientation"]


def test_the_frame_report_says_that_the_cameras_clock_told(served: tuple[list[dict[str, Any]], Path, Path]) -> None:
    received, _, _ = served
    reports = [decode_frame_report(payload) for payload in received_bytes(received)["asterism/demo/frame"]]
    assert len(reports) > 4
    assert {report.clock for report in reports} == {Clock.CAMERA}
    stamps = [report.exposed_ns for report in reports]
    assert stamps == sorted(set(stamps))
