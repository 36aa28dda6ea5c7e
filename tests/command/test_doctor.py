"""asterism doctor: a table for 80 columns, an exit code, a live page, and one sentence for bad input."""

import gc
import io
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from asterism.protocol.messages import Clock
from asterism.protocol.rig import load_rig
from asterism.server import Frame
from asterism.server.__main__ import main
from asterism.server.command import doctor
from asterism.server.doctor import host
from asterism.server.doctor.calibration import check_calibration
from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.doctor.live import Now, page, watch
from asterism.server.doctor.page import summary, table_of
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from asterism.server.sources.camera import Camera, Taken
from tests.command.test_command_line import nonsense, refused
from tests.doctor.drawn import gathered, nobody
from tests.rigs import make_camera, make_rig
from tests.servers import asterism

CHECKS = (
    *("robots seen", "focus", "exposure", "bright areas", "motion streaks", "rolling shutter", "hot pixels", "clutter"),
    *("spot sizes", "LEDs lit", "LED positions", "calibration", "camera's place", "frame rate", "lost frames"),
    *("time stamps", "stamp delay", "network", "disk"),
)
DAY_S = 86_400.0


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a rig and a few frames of it."""
    folder = tmp_path_factory.mktemp("film") / "film"
    assert asterism("simulate", DEMO_RIG, folder, "--frames", "14").returncode == 0
    return folder


def test_a_healthy_film_is_exit_code_0_and_its_table_fits_80_columns(
    film: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", str(film / "rig.yaml"), str(film / "frames")]) == 0
    told = capsys.readouterr().out
    assert all(len(line) <= 80 for line in told.splitlines()[:-1])
    for check in CHECKS:
        assert f"\n{check}  " in told, check
    assert "5 of 5" in told
    assert f"14 frames of {film / 'frames'}: " in told.splitlines()[-1]
    assert "wrong" not in told


STRANGER = """camera: camera.yaml
range: [0.9, 1.6]
robots:
  stranger:
    leds: [[0, 0, 0], [0.05, 0.01, 0], [0.031, 0.044, 0], [-0.02, 0.052, 0], [-0.048, 0.013, 0], [-0.029, -0.033, 0]]
    led: {radius: 0.0025}
"""


@pytest.mark.parametrize(
    ("rig", "measured", "advice"),
    [
        (STRANGER, "robots seen wrong 0 of 1", "is it another rig"),
        (
            DEMO_RIG.read_text().replace("-0.0265, -0.0340", "-0.0265, -0.0345"),
            "LED positions wrong bravo: LED 0 is 0.",
            "--robot bravo",
        ),
    ],
)
def test_what_is_wrong_is_exit_code_1_and_says_what_to_do(
    rig: str, measured: str, advice: str, film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rig.yaml").write_text(rig)
    (tmp_path / "camera.yaml").write_text((film / "camera.yaml").read_text())
    assert main(["doctor", str(tmp_path / "rig.yaml"), str(film / "frames")]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert measured in told
    assert advice in told


def test_the_live_page_follows_a_film_to_its_end(film: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(film / "rig.yaml"), str(film / "frames"), "--watch"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines
    assert all(line.startswith("0.8") and line.endswith("robots seen: 5 of 5") for line in lines)


def test_the_live_page_shows_the_blur_in_large_figures_and_the_least_so_far() -> None:
    rig = make_rig(1, 2, make_camera(480, 400, 900.0), range_m=(0.6, 1.0))
    scene = Scene(rig, 3)
    frames = (Frame(scene.render(k, scene.truth(k, k / 60.0)), 1 + round(k * 1e9 / 20.0), k) for k in range(11))
    shown = list(watch(rig, frames))
    assert len(shown) == 2
    assert shown[-1].best_px == min(now.blur_px for now in shown)
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(page(shown[-1]))
    told = console.export_text()
    assert all(len(line) <= 80 for line in told.splitlines())
    assert told.count("██") > 20
    assert "robots seen: 1 of 1" in told
    console.print(page(shown[-1]._replace(blur_px=float("nan"))))


def test_bad_input_gets_one_sentence_and_exit_code_2(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, frames = film / "rig.yaml", film / "frames"
    for arguments, words in (
        (("none.yaml", frames), "none.yaml: no such file"),
        ((rig, tmp_path / "none"), "there is no such source"),
        ((rig, frames, "--seconds", "0"), "argument --seconds: 0, expected a number above 0"),
        ((rig, frames, "--blink", "x"), "argument --blink: 'x', expected a number"),
        ((rig, frames, "--watch", "--blink", "3"), "--watch and --blink exclude each other"),
    ):
        assert words in refused(capsys, "doctor", *arguments), arguments
    for file in nonsense(tmp_path):
        refused(capsys, "doctor", file, frames)
        refused(capsys, "doctor", rig, file)


class Steady:
    """A camera that delivers one image again and again, 10 ms later each by its own clock."""

    def __init__(self, image: NDArray[np.uint8]) -> None:
        self._image, self._start_ns, self._count, self.closed = image, time.monotonic_ns(), 0, False

    def read(self) -> Taken:
        """The next; every tenth is lost."""
        threading.Event().wait(0.005)
        self._count += 2 if self._count % 10 == 8 else 1
        return Taken(self._image, self._start_ns + 10_000_000 * self._count, Clock.CAMERA)

    def close(self) -> None:
        """Let go."""
        self.closed = True


def steady_camera(monkeypatch: pytest.MonkeyPatch) -> Steady:
    """Whatever source the command is given, it finds this one."""
    rig = load_rig(DEMO_RIG)
    scene = Scene(rig, 1)
    device = Steady(scene.render(0, scene.truth(0, 0.0)))
    camera = Camera("camera", lambda: device, rig, lambda _: None)
    monkeypatch.setattr(doctor, "open_fitting", lambda *_: (rig, camera))
    return device


def test_a_live_camera_is_looked_at_for_its_time_and_let_go_of(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    device = steady_camera(monkeypatch)
    assert main(["doctor", str(DEMO_RIG), "0", "--seconds", "0.5"]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert device.closed
    assert "frame rate wrong 100.00 Hz of 60 asked for" in told
    assert "lost frames wrong" in told
    assert "time stamps good CAMERA's jitter 0.00 ms" in told


def test_the_live_page_lets_go_of_the_camera_at_ctrl_c(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    device = steady_camera(monkeypatch)
    shown = doctor.watch

    def once(*arguments: Any) -> Iterator[Now]:
        yield next(shown(*arguments))
        raise KeyboardInterrupt

    monkeypatch.setattr(doctor, "watch", once)
    assert main(["doctor", str(DEMO_RIG), "0", "--watch"]) == 0
    assert "robots seen: 5 of 5" in capsys.readouterr().out
    gc.collect()
    assert device.closed


def test_a_camera_that_is_not_there_is_exit_code_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert "does not open" in refused(capsys, "doctor", DEMO_RIG, "/dev/video97", code=1)


def test_the_table_says_what_to_do_below_what_was_measured_in_80_columns() -> None:
    findings = [Finding("focus", verdict, "m" * 70, "a " * 60) for verdict in Verdict]
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(table_of(findings))
    told = console.export_text()
    assert all(len(line) <= 80 for line in told.splitlines())
    assert told.count("> a") == 4
    assert summary(findings) == "1 wrong, 1 to look at, 1 good, 1 cannot be told"


def test_a_taken_port_and_a_small_disk_are_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        monkeypatch.setattr(host, "DEFAULT_ENDPOINT", f"tcp/127.0.0.1:{taken.getsockname()[1]}")
        assert host.check_port().verdict == Verdict.LOOK
    assert host.check_port().verdict == Verdict.GOOD
    rig = load_rig(DEMO_RIG)
    huge = replace(rig, capture=replace(rig.capture, rate_hz=1e9))
    assert host.check_disk(huge, tmp_path).verdict == Verdict.LOOK


def test_an_old_calibration_is_told_by_its_files_date(tmp_path: Path) -> None:
    camera = tmp_path / "camera.yaml"
    camera.touch()
    rig = load_rig(DEMO_RIG)
    told = gathered(rig, nobody(rig))
    now_s = camera.stat().st_mtime
    assert check_calibration(told, camera, now_s + 10 * DAY_S, None).verdict == Verdict.UNTOLD
    old = check_calibration(told, camera, now_s + 800 * DAY_S, None)
    assert old.verdict == Verdict.LOOK
    assert "2.2 years old" in old.measured
