"""`asterism example --surface`: a mould as it is and as it was drawn, and a README.md that can be followed."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.calibration.result_file import holds_truth
from asterism.server.command.parser import parser
from asterism.server.simulation.measured_mould import DENT_M, SAG_M, draw_mould
from asterism.server.simulation.simulate import Scene
from tests.command.pasting import commands_of, paste
from tests.command.test_command_line import refused

FEWER = {"250": "60"}  # frames


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("example") / "mould"
    assert main(["example", str(out), "--surface", "--seed", "3"]) == 0
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_seed_is_a_folder_whose_truth_is_marked(folder: Path, tmp_path: Path) -> None:
    main(["example", str(tmp_path / "again"), "--surface", "--seed", "3"])
    assert contents(tmp_path / "again") == contents(folder)
    assert {path.name for path in folder.iterdir() if holds_truth(path)} == {"true.yaml", "true-mould.csv"}
    true, rig = load_rig(folder / "true.yaml"), load_rig(folder / "rig.yaml")
    assert true.surface is not None
    assert rig.surface is None
    assert all(robot.stands is None for robot in rig.robots)
    assert [robot.id for robot in rig.robots] == [robot.id for robot in true.robots]


def test_its_readme_names_what_is_there(folder: Path) -> None:
    text, whole = (folder / "README.md").read_text(), parser()
    assert "$" not in text
    for words in commands_of(folder):
        assert whole.parse_args(words)
    made = {"rig2.yaml", "rig2.surface.csv"}
    assert set(re.findall(r"`([\w.-]+\.(?:yaml|csv|stl))`", text)) - made <= contents(folder).keys()


@pytest.mark.parametrize("seed", [0, 3])
def test_the_drawing_is_a_closed_block_that_the_mould_differs_from_by_tenths(folder: Path, seed: int) -> None:
    mould = draw_mould(seed)
    assert mould.true.surface is not None
    off = mould.true.surface.shape.values - mould.drawing.values  # type: ignore[union-attr]
    assert -SAG_M - DENT_M - 1e-6 <= off.min() < -0.5e-3
    assert off.max() <= 0.0
    triangles = np.frombuffer((folder / "mould.stl").read_bytes()[84:], _facets())["corners"].round(6)
    sides: dict[tuple, int] = {}
    for corners in triangles.tolist():
        for one, other in zip(corners, corners[1:] + corners[:1], strict=True):
            side = (tuple(one), tuple(other))
            sides[side] = sides.get(side, 0) + 1
    assert all(count == 1 and sides.get(side[::-1]) == 1 for side, count in sides.items())
    volume = np.einsum("ni,ni->n", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6.0
    assert volume == pytest.approx(np.mean(draw_mould(3).drawing.values) * 0.48 * 0.36, rel=0.02)  # outwards


def _facets() -> np.dtype:
    return np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


@pytest.mark.parametrize("seed", range(3))
def test_its_camera_sees_the_robots_always(seed: int) -> None:
    scene = Scene(draw_mould(seed).true, 0)
    for time_s in np.arange(0.0, 20.0, 2.5):
        assert all(sum(scene.visible(k, entry)) == 6 for k, entry in enumerate(scene.truth(0, time_s)))


def test_a_mould_is_under_one_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "not allowed with" in refused(capsys, "example", tmp_path / "out", "--surface", "--cameras", 2)


def test_its_readme_can_be_pasted(folder: Path) -> None:
    """With fewer frames: the surface comes out as it is, who is lifted is known, and tools are where they were."""
    for words in commands_of(folder):
        if "--frames" in words:
            at = words.index("--frames") + 1
            words[at] = FEWER[words[at]]
        if words[0] in ("simulate", "calibrate", "locate") and not {"tuesday", "tuesday/frames"} & set(words):
            paste(words, folder)
    true, found = load_rig(folder / "true.yaml").surface, load_rig(folder / "rig2.yaml").surface
    assert true is not None
    assert found is not None
    grid = np.stack(np.meshgrid(np.linspace(-0.22, 0.22, 40), np.linspace(-0.16, 0.16, 30)), axis=-1).reshape(-1, 2)
    feet = true.touch(np.column_stack([grid, np.full(len(grid), 0.08)]))
    touch = found.touch(feet.points)
    there = touch.inside & feet.inside
    assert there.mean() > 0.05
    assert np.sqrt(np.mean(touch.distances[there] ** 2)) < 0.15e-3
    assert np.mean(np.abs(touch.distances[there]) < 2.0 * touch.sigmas[there]) > 0.85
    lifted = [
        robot["surface"]["standing"] == "LIFTED"
        for line in map(json.loads, (folder / "monday.jsonl").read_text().splitlines())
        for robot in line["robots"]
        if robot["id"] == "bravo" and robot["surface"]["standing"] != "BEYOND"
    ]
    assert 10 < sum(lifted) <= 20
