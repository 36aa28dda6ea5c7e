"""`asterism example`: a folder whose README.md can be followed, the truth beside what was measured of it."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import load_rig, parse_rig
from asterism.server.__main__ import main
from asterism.server.budget import plots
from asterism.server.calibration.lens.targets import parse_target
from asterism.server.calibration.result_file import holds_truth
from asterism.server.command.parser import parser
from tests.command.pasting import commands_of, paste
from tests.command.test_command_line import refused
from tests.servers import asterism

FEWER = {"60": "24", "150": "40", "20": "6", "100": "24"}  # frames


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("example") / "try"
    assert main(["example", str(out), "--seed", "3"]) == 0
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_seed_is_a_folder(folder: Path, tmp_path: Path) -> None:
    main(["example", str(tmp_path / "again"), "--seed", "3"])
    main(["example", str(tmp_path / "other"), "--seed", "4"])
    assert contents(tmp_path / "again") == contents(folder)
    other = contents(tmp_path / "other")
    assert other.keys() == contents(folder).keys()
    assert [name for name, data in contents(folder).items() if other[name] == data] == ["board.yaml"]


def test_truth_and_measured_are_rigs_a_ruler_apart(folder: Path) -> None:
    true, board = load_rig(folder / "true.yaml"), load_rig(folder / "true-board.yaml")
    measured = parse_rig(
        (folder / "rig.yaml").read_text(), (folder / "true-camera.yaml").read_text(), str(folder / "rig.yaml")
    )
    assert [robot.id for robot in true.robots] == [robot.id for robot in measured.robots] == ["alpha"]
    off = np.abs(measured.robots[0].leds - true.robots[0].leds)
    assert 0.1e-3 < np.sqrt(np.square(off[:, :2]).mean()) < 0.8e-3
    assert off.max() < 2e-3
    drawn = parse_target(f"leds:{folder / 'board.yaml'}").points
    assert 5e-6 < np.abs(drawn - board.robots[0].leds).max() < 0.2e-3
    assert true.T_world_camera is not None
    assert measured.T_world_camera is None
    assert measured.range_m == true.range_m == board.range_m
    assert {path.name for path in folder.iterdir() if holds_truth(path)} == {
        *("true.yaml", "true-board.yaml", "true-camera.yaml")
    }


def test_its_readme_reads_what_is_there_and_writes_what_is_not(folder: Path) -> None:
    """In the order of its lines; nothing of the folder is in the way."""
    there = set(contents(folder))
    before = set(there)
    whole = parser()
    for words in commands_of(folder):
        options = whole.parse_args(words)
        needed = []
        for each in (getattr(options, name, None) for name in ("rig", "source", "truth")):
            needed += each if isinstance(each, list) else [each]
        if target := getattr(options, "target", None):
            needed.append(target.partition(":")[2])
        for name in filter(None, needed):
            assert str(name) in there, words
        out = str(options.out)
        assert out not in there, words
        there |= {out, f"{out}/frames", f"{out}/truth.jsonl"} if options.command == "simulate" else {out}
    assert len(there) > len(before) + 10
    text = (folder / "README.md").read_text()
    assert "$" not in text
    assert set(re.findall(r"`([\w-]+\.yaml)`", text)) <= there | {"rig4-camera.yaml"}


def test_it_writes_into_an_empty_folder_only(folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    before = contents(folder)
    assert "exists already, expected a new or empty folder" in refused(capsys, "example", folder)
    assert contents(folder) == before
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine").write_text("")
    assert main(["example", str(full), "--force"]) == 0
    assert contents(full).keys() == before.keys()
    assert [path.name for path in (tmp_path / "full.old-1").iterdir()] == ["mine"]
    (tmp_path / "file").write_text("")
    assert "expected a new or empty folder" in refused(capsys, "example", tmp_path / "file")
    assert "--seed: '-1', expected a whole number" in refused(capsys, "example", tmp_path / "new", "--seed", "-1")
    assert not (tmp_path / "new").exists()
    (tmp_path / "empty").mkdir()
    assert main(["example", str(tmp_path / "empty")]) == 0


def test_it_says_how_to_go_on_with_this_very_program(tmp_path: Path) -> None:
    """README.md says `asterism`; started by a path it is said how that name is found."""
    told = asterism("example", tmp_path / "my try").stdout
    assert f"export PATH={Path(sys.executable).parent}:$PATH" in told
    assert f"cd '{tmp_path / 'my try'}' and paste" in told


def test_nothing_measured_replaces_its_truth(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(folder)
    board, leds = f"leds:{folder / 'board.yaml'}", ["--robot", "alpha", "--distance", "4,5=0.0827"]
    for words in (
        ["camera", "film", "--target", board, "-o", folder / "true-camera.yaml"],
        ["leds", folder / "true.yaml", "film", *leds, "-o", folder / "true.yaml"],
        ["world", folder / "true.yaml", "film", "--truth", "truth.jsonl", "-o", folder / "true.yaml"],
        ["z", folder / "true.yaml", "film", "--truth", "truth.jsonl", "-o", folder / "true.yaml"],
        ["point", folder / "true.yaml", "film", "--robot", "alpha", "--name", "tool", "-o", folder / "true.yaml"],
    ):
        for force in ([], ["--force"]):
            assert "holds the truth of a simulation" in refused(capsys, "calibrate", *words, *force)
    assert contents(folder) == before


def test_its_readme_can_be_pasted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With fewer frames, and plots that tests/budget looks at not painted; the rig comes out right by its truth, and
    better by every step.
    """
    monkeypatch.setattr(plots, "_png", lambda *_: b"")
    told = {}
    for words in commands_of(folder):
        if "--frames" in words:
            at = words.index("--frames") + 1
            words[at] = FEWER[words[at]]
        if words[:2] != ["report", "rig3.yaml"] and words[0] != "example":  # once each is enough
            told[words[0]] = " ".join(paste(words, folder).split())
    assert "measured RMS beside predicted one sigma" in told["report"]
    honest = re.search(r"over the covariance published with each pose ([\d.]+) \(6 is honest\)", told["report"])
    assert honest is not None
    assert 3.0 < float(honest[1]) < 20.0
    assert len((folder / "poses.jsonl").read_text().splitlines()) == int(FEWER["60"])
    true = load_rig(folder / "true.yaml")
    off = {}
    for name in ("rig3", "rig4"):
        rig = load_rig(folder / f"{name}.yaml")
        assert rig.T_world_camera is not None
        assert true.T_world_camera is not None
        off[name] = np.array(
            [
                np.linalg.norm(rig.T_world_camera.position - true.T_world_camera.position),
                abs(rig.camera.focal_px - true.camera.focal_px),
                np.abs(rig.robots[0].leds - true.robots[0].leds).max(),
            ]
        )
    assert (off["rig4"] < [0.2e-3, 0.2, 0.02e-3]).all()
    assert (off["rig3"] < [5e-3, 3.0, 0.5e-3]).all()
    assert (off["rig4"] < off["rig3"]).all()
    before, after = (
        np.abs(load_rig(folder / f"{name}.yaml").robots[0].points["tool"] - true.robots[0].points["tool"]).max()
        for name in ("rig4", "rig5")
    )
    assert after < 0.06e-3
    assert before > 0.2e-3
