"""`asterism example --cameras`: several cameras about one floor, whose README.md can be followed."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.calibration.result_file import holds_truth
from asterism.server.command.parser import parser
from asterism.server.pose.place import apart
from asterism.server.simulation.shared_floor import check_shared
from asterism.server.simulation.simulate import Scene
from tests.command.pasting import commands_of, paste
from tests.command.test_command_line import refused

FEWER = {"100": "10", "60": "4"}  # frames
CAMERAS = ("cam1", "cam2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("example") / "hall"
    assert main(["example", str(out), "--cameras", "2", "--seed", "3"]) == 0
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_its_rigs_are_cameras_of_one_world_a_tape_apart(folder: Path, tmp_path: Path) -> None:
    main(["example", str(tmp_path / "again"), "--cameras", "2", "--seed", "3"])
    assert contents(tmp_path / "again") == contents(folder)
    true, measured = ([load_rig(folder / f"{kind}{name}.yaml") for name in CAMERAS] for kind in ("true-", ""))
    check_shared(CAMERAS, true)
    assert {path.name for path in folder.iterdir() if holds_truth(path)} == {"true-cam1.yaml", "true-cam2.yaml"}
    for rig, told in zip(true, measured, strict=True):
        assert rig.T_world_camera is not None
        assert told.T_world_camera is not None
        off = apart(rig.T_world_camera, told.T_world_camera)
        assert 1e-3 < np.linalg.norm(off[:3]) < 25e-3
        assert 1e-3 < np.linalg.norm(off[3:]) < 0.1
        assert told.camera.name == rig.camera.name


@pytest.mark.parametrize("cameras", [2, 6])
def test_every_camera_sees_the_robots_nearly_always(cameras: int, tmp_path: Path) -> None:
    main(["example", str(tmp_path / "hall"), "--cameras", str(cameras)])
    for k in range(cameras):
        scene = Scene(load_rig(tmp_path / "hall" / f"true-cam{k + 1}.yaml"), 0)
        seen = [
            sum(scene.visible(robot, entry)) == 6
            for time_s in np.arange(0.0, 20.0, 0.5)
            for robot, entry in enumerate(scene.truth(0, time_s))
        ]
        assert np.mean(seen) > 0.9


def test_its_readme_names_what_is_there(folder: Path) -> None:
    text, whole = (folder / "README.md").read_text(), parser()
    assert "$" not in text
    for words in commands_of(folder):
        assert whole.parse_args(words)
    assert set(re.findall(r"`([\w-]+\.yaml)`", text)) <= contents(folder).keys()


def test_other_numbers_of_cameras_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in (1, 7):
        assert "expected 2 to 6" in refused(capsys, "example", tmp_path / "out", "--cameras", number)
    assert not (tmp_path / "out").exists()


def test_its_readme_can_be_pasted(folder: Path) -> None:
    """With fewer frames: the cameras come to stand where they are, and poses of both are as good as they say."""
    for words in commands_of(folder):
        if "--frames" in words:
            at = words.index("--frames") + 1
            words[at] = FEWER[words[at]]
        if words[0] not in ("example", "report", "review"):  # tested elsewhere
            paste(spread(words, folder), folder)
    for name in CAMERAS:
        before, after, true = (
            load_rig(folder / path).T_world_camera
            for path in (f"{name}.yaml", f"placed/{name}.yaml", f"true-{name}.yaml")
        )
        assert before is not None
        assert after is not None
        assert true is not None
        assert np.linalg.norm(apart(true, after)[:3]) < 0.2e-3 < np.linalg.norm(apart(true, before)[:3])
    truth = {line["exposed_ns"]: line["robots"] for line in lines(folder / "check" / "truth.jsonl")}
    squared = []
    for line in lines(folder / "fused.jsonl"):
        places = {robot["id"]: robot["position"] for robot in truth[line["exposed_ns"]]}
        for robot in line["robots"]:
            if len(robot["cameras"]) == 2:
                off = np.array(robot["position"]) - places[robot["id"]]
                covariance = np.reshape(robot["covariance"], (6, 6))[:3, :3]
                assert np.linalg.norm(off) < 1e-3
                squared.append(off @ np.linalg.solve(covariance, off))
    assert len(squared) >= 20
    assert 0.5 < np.mean(squared) < 10.0  # 3 is honest; cameras' places are off for all of them


def spread(words: list[str], folder: Path) -> list[str]:
    """As a shell does with `*`."""
    found = []
    for word in words:
        found += sorted(str(path.relative_to(folder)) for path in folder.glob(word)) if "*" in word else [word]
    return found


def lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]
