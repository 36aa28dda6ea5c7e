"""asterism export as a user meets it: what it writes, what it refuses, and what Ctrl-C leaves."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import load_rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.__main__ import main
from asterism.server.command import export
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.command.test_command_line import refused
from tests.recordings.exported import RELOADED, record

LINE = {
    "frame": "0.png",
    "exposed_ns": 1_795_398_896_123_456_789,
    "robots": [{"id": "alpha", "state": "TRACKED", "position": [0.1, 0.2, 1.3], "orientation": [0, 0, 0, 1]}],
    "lost": {"bravo": "too few spots"},
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recording"), np.random.default_rng(13))[0].path


def lines(folder: Path, *told: object, name: str = "poses.jsonl") -> Path:
    path = folder / name
    path.write_text("".join(f"{json.dumps(line)}\n" for line in told))
    return path


@pytest.mark.parametrize(
    ("to", "out", "files"),
    [
        ("csv", "out", {f"{name}.csv" for name in ("alpha", "bravo", "charlie", "delta", "zulu", "echo")}),
        ("tum", "out", {f"{name}.tum" for name in ("alpha", "bravo", "charlie", "delta", "zulu", "echo")}),
        ("rosbag2", "out", {"out.mcap", "metadata.yaml"}),
        ("parquet", "out.parquet", None),
    ],
)
def test_every_format_of_a_recording(
    tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str], to: str, out: str, files: set[str] | None
) -> None:
    path = tmp_path / out
    assert main(["export", str(recording), "--to", to, "-o", str(path)]) == 0
    told = capsys.readouterr()
    assert told.out.startswith(f"{path}: 26 poses of 6 robots, 6 frames")
    assert f"at frame {RELOADED} the time steps back" in told.err
    assert [entry.name for entry in tmp_path.iterdir()] == [out]
    assert files is None or {entry.name for entry in path.iterdir()} == files
    assert f"{path}: exists" in refused(capsys, "export", recording, "--to", to, "-o", path)
    assert main(["export", str(recording), "--to", to, "-o", str(path), "--force", "--quiet"]) == 0
    assert f"the old one is kept as {path}.old-1" in capsys.readouterr().out


def test_lines_of_locate_are_taken_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = lines(tmp_path, LINE)
    assert main(["export", str(path), "--to", "csv", "-o", str(tmp_path / "csv")]) == 0
    assert "1 pose of 1 robot, 1 frame in 2 files; never located: bravo" in capsys.readouterr().out
    assert "LOST,too few spots" in (tmp_path / "csv" / "bravo.csv").read_text()
    assert main(["export", str(path), "--to", "tum", "-o", str(tmp_path / "tum")]) == 0
    last = (tmp_path / "tum" / "alpha.tum").read_text().splitlines()[-1]
    assert last == "1795398896.123456789 0.1 0.2 1.3 0.0 0.0 0.0 1.0"


def test_what_is_wrong_is_refused_and_leaves_nothing(
    tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, good = tmp_path / "out", lines(tmp_path, LINE)
    none = lines(tmp_path, LINE | {"robots": []}, name="none.jsonl")
    bad = lines(tmp_path, LINE, LINE | {"exposed_ns": "now"}, name="bad.jsonl")
    twice = lines(tmp_path, LINE | {"lost": {"alpha": "why"}}, name="twice.jsonl")
    untimed = lines(tmp_path, {"frame": "0.png", "robots": []}, name="untimed.jsonl")
    survey = tmp_path / "survey.csv"
    survey.write_text("robot,frame,x_m,y_m\n")
    before = set(tmp_path.iterdir())
    for words, text in (
        ((recording, "--to", "xlsx"), "invalid choice: 'xlsx' (choose from"),
        (("--to", "csv"), "expected either a RECORDING or --from SURVEY.csv"),
        ((recording, "--from", survey, "--to", "truth"), "expected either a RECORDING or --from SURVEY.csv"),
        (("--from", survey, "--to", "csv"), "--to csv: expected --to truth with --from"),
        ((recording, "--to", "truth"), "--to truth: expected --to truth with --from, --to csv|tum|parquet|rosbag2"),
        ((recording, "--to", "csv", "--images"), "--images: csv holds no images, expected --to rosbag2"),
        ((recording, "--to", "parquet"), "out: expected a file name ending in .parquet"),
        ((good, "--to", "rosbag2"), "lines tell no frames and no rig, expected a recording's folder"),
        ((none, "--to", "csv"), "holds no pose of any robot (1 frames), nothing to export"),
        ((bad, "--to", "tum"), "bad.jsonl: line 2: Expected `int`, got `str` - at `$.exposed_ns`"),
        ((untimed, "--to", "tum"), "untimed.jsonl: line 1: tells no exposed_ns, expected one in every line"),
        ((twice, "--to", "tum"), "twice.jsonl: line 1: 'alpha' is told of twice"),
        ((survey, "--to", "tum"), "expected a recording's folder, or JSON lines as a file that ends in .jsonl"),
        ((tmp_path / "gone", "--to", "tum"), "there is no such recording"),
        (("--from", survey, "--to", "truth"), "survey.csv: column z is missing, expected z_m or z_mm or z_cm"),
    ):
        assert text in refused(capsys, "export", *words, "-o", out), words
    assert set(tmp_path.iterdir()) == before


def test_a_recording_without_poses_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = load_rig(DEMO_RIG)
    recorder = Recorder(tmp_path, rig, "test", FramesKept(), wait=True)
    recorder.write([], np.zeros((rig.camera.height, rig.camera.width), np.uint8), 10**18, 1)
    recorder.close({})
    for to in ("csv", "rosbag2"):
        words = refused(capsys, "export", recorder.folder, "--to", to, "-o", tmp_path / "out")
        assert f"{recorder.folder}: holds no pose of any robot (0 frames)" in words
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("module", "to", "extra"), [("pyarrow", "parquet", "parquet"), ("rosbags", "rosbag2", "ros")])
def test_a_missing_extra_is_one_sentence(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    module: str, to: str, extra: str,
) -> None:  # fmt: skip
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [_Without(module), *sys.meta_path])
    words = refused(capsys, "export", recording, "--to", to, "-o", tmp_path / "out.parquet")
    assert f"install it with: pip install 'asterism-localization[{extra}]'" in words


class _Without:
    """As if a module were not installed."""

    def __init__(self, module: str) -> None:
        self._module = module

    def find_spec(self, name: str, *_: object) -> None:
        if name.partition(".")[0] == self._module:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


@pytest.mark.parametrize("to", ["csv", "tum", "rosbag2", "parquet"])
def test_ctrl_c_leaves_nothing(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, to: str
) -> None:
    whole = export.frames_of

    def interrupted(*arguments: object) -> Iterator[object]:
        for number, frame in enumerate(whole(*arguments)):  # type: ignore[arg-type]
            if number == 3:
                raise KeyboardInterrupt
            yield frame

    monkeypatch.setattr(export, "frames_of", interrupted)
    assert main(["export", str(recording), "--to", to, "-o", str(tmp_path / "out.parquet")]) == 130
    assert "interrupted; nothing was written" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_spreadsheet_becomes_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    survey, truth = tmp_path / "survey.csv", tmp_path / "truth.jsonl"
    survey.write_text("robot;frame;x_mm;y_mm;z_mm\nalpha;0.png;100,5;2;3\nbravo;0.png;1;2;3\nalpha;1.png;4;5;6\n")
    assert main(["export", "--from", str(survey), "--to", "truth", "-o", str(truth)]) == 0
    assert f"{truth}: 3 poses of 2 robots, 2 frames" in capsys.readouterr().out
    told = [json.loads(line) for line in truth.read_text().splitlines()]
    assert [(line["frame"], [robot["id"] for robot in line["robots"]]) for line in told] == [
        ("0.png", ["alpha", "bravo"]), ("1.png", ["alpha"])
    ]  # fmt: skip
    assert told[0]["robots"][0]["position"] == [0.1005, 0.002, 0.003]


def test_what_was_exported_is_a_survey_again(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(recording), "--to", "csv", "-o", str(tmp_path / "csv")]) == 0
    bravo, truth = tmp_path / "csv" / "bravo.csv", tmp_path / "truth.jsonl"
    assert main(["export", "--from", str(bravo), "--to", "truth", "-o", str(truth)]) == 0
    assert "columns not looked at: 'time_s'" in capsys.readouterr().err
    back = {robot["id"]: robot for line in truth.read_text().splitlines() for robot in json.loads(line)["robots"]}
    assert main(["export", str(truth), "--to", "tum", "-o", str(tmp_path / "tum")]) == 0
    assert main(["export", str(recording), "--to", "tum", "-o", str(tmp_path / "tum2")]) == 0
    one, two = ((tmp_path / name / "bravo.tum").read_text().splitlines()[2:] for name in ("tum", "tum2"))
    numbers = [[[float(word) for word in line.split()] for line in of] for of in (one, two)]
    np.testing.assert_allclose(*numbers, rtol=0, atol=1e-15)
    assert back.keys() == {"bravo"}
