"""How much is told and where: --quiet, --verbose, --log; what Ctrl-C left; and the disk before the work."""

import logging
import re
import signal
import sys
import warnings
from pathlib import Path

import pytest

from asterism.server.__main__ import main
from asterism.server.command import check, design, locate, simulated_film
from asterism.server.command.progress import progress, working
from asterism.server.service.say import complain, say
from asterism.server.service.telling import LOGGER, shows_progress, telling
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.command.test_command_line import refused

UTC = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z"


def test_quiet_leaves_errors_and_verbose_adds_details(capsys: pytest.CaptureFixture[str]) -> None:
    said = {}
    for name, quiet, verbose in (("quiet", True, False), ("plain", False, False), ("verbose", False, True)):
        with telling() as told:
            told.choose(quiet, verbose, None)
            say("on my way")
            complain("it failed")
            logging.getLogger("asterism.clients.client").debug("a detail")
        said[name] = capsys.readouterr().err.splitlines()
    assert said["quiet"] == ["asterism: it failed"]
    assert said["plain"] == ["asterism: on my way", "asterism: it failed"]
    assert said["verbose"] == [*said["plain"], "asterism: clients.client: a detail"]


def test_the_log_holds_what_was_said_with_utc_times_and_what_was_there_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log"
    for _ in range(2):
        assert main(["check", "nowhere.yaml", "--quiet", "--log", str(log)]) == 2
    capsys.readouterr()
    lines = log.read_text().splitlines()
    assert len(lines) == 2
    for line in lines:
        assert re.fullmatch(rf"{UTC} ERROR asterism.said: nowhere.yaml: no such file", line)
    assert main(["check", "nowhere.yaml", "--verbose", "--log", str(log)]) == 2
    assert "InputError" in capsys.readouterr().err
    assert "asterism check nowhere.yaml --verbose" in log.read_text()
    assert not LOGGER.handlers


def test_a_log_that_cannot_be_written_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in (tmp_path, tmp_path / "none" / "x", tmp_path / ("x" * 300)):
        assert "cannot be written" in refused(capsys, "check", DEMO_RIG, "--log", name)


def test_libraries_warnings_are_details(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for verbose in (False, True):
        with telling() as told, warnings.catch_warnings():
            warnings.simplefilter("always")
            told.choose(False, verbose, tmp_path / "log")
            logging.captureWarnings(True)
            warnings.warn("overflow in multiply", RuntimeWarning, stacklevel=1)
        assert ("overflow" in capsys.readouterr().err) == verbose
    assert (tmp_path / "log").read_text().count("RuntimeWarning: overflow in multiply") == 2


def test_what_foxgloves_sdk_logs_is_told_like_the_rest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with telling() as told:
        told.choose(quiet=False, verbose=False, log=tmp_path / "log")
        logging.getLogger("foxglove.websocket.server").error("dropped")
    assert capsys.readouterr().err == "asterism: foxglove.websocket.server: dropped\n"
    assert "ERROR foxglove.websocket.server: dropped" in (tmp_path / "log").read_text()


def test_progress_is_for_terminals_and_not_for_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(progress(range(3), 3, "counting")) == [0, 1, 2]
    with working("thinking") as now:
        now("harder")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with telling() as told:
        assert shows_progress()
        told.choose(quiet=True, verbose=False, log=None)
        assert not shows_progress()


def interrupted(*_: object) -> None:
    signal.raise_signal(signal.SIGINT)


def test_ctrl_c_says_what_it_left_and_the_rerun_is_not_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    film, poses = tmp_path / "film", tmp_path / "poses.jsonl"
    made, found = ("simulate", DEMO_RIG, film, "--frames", "3"), ("locate", film / "rig.yaml", film / "frames")
    with monkeypatch.context() as patch:
        patch.setattr(simulated_film, "_told", interrupted)
        assert refused(capsys, *made, code=130) == "asterism: interrupted; nothing was written"
        assert not film.exists()
    assert main([str(word) for word in made]) == 0
    with monkeypatch.context() as patch:
        lines, line = iter((True, False)), locate.line
        patch.setattr(locate, "line", lambda *of: line(*of) if next(lines) else interrupted())
        assert main([str(word) for word in (*found, "-o", poses)]) == 130
        told = capsys.readouterr().err.splitlines()
        assert "asterism: 2 frames of 3" in told
        assert told[-1] == f"asterism: interrupted; what was done so far is in {poses}.partial"
        assert not poses.exists()
        assert len(Path(f"{poses}.partial").read_text().splitlines()) == 2
    assert main([str(word) for word in (*found, "-o", poses)]) == 0
    capsys.readouterr()
    assert len(poses.read_text().splitlines()) == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film", "poses.jsonl"]
    with monkeypatch.context() as patch:
        patch.setattr(design, "design", interrupted)
        asked = ("--robots", 1, "--disc", 0.1, "--spacing", 0.02, "--distance", 1, "--sigma", 0.05)
        told = refused(capsys, "design", *asked, "-o", tmp_path / "plates", code=130)
        assert told == "asterism: interrupted; nothing was written"
        patch.setattr(check, "check_rig", interrupted)
        assert refused(capsys, "check", DEMO_RIG, code=130) == "asterism: interrupted"


def test_locate_replaces_with_force_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = tmp_path / "poses.jsonl"
    poses.write_text("mine\n")
    assert "exists; choose another name, or --force" in refused(capsys, "locate", "nowhere", "nowhere", "-o", poses)
    film = tmp_path / "film"
    assert main(["simulate", str(DEMO_RIG), str(film), "--frames", "1"]) == 0
    assert main(["locate", str(film / "rig.yaml"), str(film / "frames"), "-o", str(poses), "--force"]) == 0
    assert f"the old one is kept as {poses}.old-1" in capsys.readouterr().err
    assert Path(f"{poses}.old-1").read_text() == "mine\n"
    assert poses.read_text().startswith('{"frame":"00000.png"')


def test_outputs_are_looked_at_before_anything_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every command's own: the rig and the frames that are named are not there either."""
    none, out = "nowhere", tmp_path / "none" / "x.rrd"
    plates = ("--robots", 1, "--disc", 0.1, "--spacing", 0.02, "--distance", 1, "--sigma", 0.05)
    for arguments in (
        ("locate", none, none, "-o", out),
        ("review", none, "-o", out),
        ("report", none, "-o", out),
        ("simulate", none, out),
        ("design", *plates, "-o", out),
        ("serve", none, none, "--record", out),
        ("demo", "--record", out),
        ("calibrate", "camera", none, "--target", "chessboard:9x6:0.02", "-o", out),
        ("calibrate", "leds", none, none, "--robot", "a", "--distance", "0,1=0.1", "-o", out),
        ("calibrate", "world", none, none, "--target", "chessboard:9x6:0.02", "-o", out),
        ("calibrate", "offset", none, none, "--truth", none, "-o", out),
        ("calibrate", "z", none, none, "--truth", none, "-o", out),
    ):
        assert f"{out}: there is no folder {out.parent}" in refused(capsys, *arguments)
