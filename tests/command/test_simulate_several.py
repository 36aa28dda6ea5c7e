"""`asterism simulate` of several rigs: cameras of one world."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.command.test_command_line import refused
from tests.several import facing_pair, looking_at

RIG, CAMERA = DEMO_RIG.read_text(), (DEMO_RIG.parent / "camera.yaml").read_text()
DOWN = "position: [0.0, 0.0, 1.3]\n  orientation: [1.0, 0.0, 0.0, 0.0]"


def write(folder: Path, name: str, text: str = RIG, place: int = 0) -> Path:
    """A rig whose camera looks at the floor from one of two sides."""
    T = facing_pair()[place]
    world = f"position: {T.position.tolist()}\n  orientation: {T.orientation.tolist()}"
    (folder / f"camera-{name}.yaml").write_text(CAMERA.replace("camera_name: demo", f"camera_name: {name}"))
    path = folder / f"{name}.yaml"
    path.write_text(text.replace("camera.yaml", f"camera-{name}.yaml").replace(DOWN, world))
    return path


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("rigs")
    return [write(folder, "left"), write(folder, "right", place=1)]


def lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_every_camera_has_its_folder_and_the_world_one_truth(rigs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "films"
    words = [*map(str, rigs), str(out), "--frames", "3", "--rate", "10", "--seed", "2"]
    assert main(["simulate", *words, "--stagger", "--hide", "0.2"]) == 0
    world = {line["exposed_ns"]: line for line in lines(out / "truth.jsonl")}
    assert list(world) == [0, 50_000_000, 100_000_000, 150_000_000, 200_000_000, 250_000_000]
    for name, first_ns in (("left", 0), ("right", 50_000_000)):
        rig = load_rig(out / name / "rig.yaml")
        assert rig.camera.name == name
        with (out / name / "frames" / "times.csv").open() as file:
            times = [int(row["exposed_ns"]) for row in csv.DictReader(file)]
        assert times == [first_ns + k * 100_000_000 for k in range(3)]
        for line, exposed_ns in zip(lines(out / name / "truth.jsonl"), times, strict=True):
            assert (out / name / "frames" / line["frame"]).exists()
            assert line["exposed_ns"] == exposed_ns
            told = {robot["id"]: robot for robot in world[exposed_ns]["robots"]}
            assert len(told) == len(line["robots"]) == 5
            for robot in line["robots"]:
                np.testing.assert_allclose(robot["position"], told[robot["id"]]["position"], atol=1e-12)
                assert told[robot["id"]]["visible"] == {name: robot["visible"]}
    assert {seen for line in world.values() for robot in line["robots"] for seen in robot["visible"].values()} > {5, 6}


def test_each_rig_by_itself_shows_what_all_together_show(rigs: list[Path], tmp_path: Path) -> None:
    main(["simulate", *map(str, rigs), str(tmp_path / "both"), "--frames", "1"])
    for rig in rigs:
        main(["simulate", str(rig), str(tmp_path / rig.stem), "--frames", "1"])
        for name in ("frames/00000.png", "frames/times.csv", "truth.jsonl", "rig.yaml"):
            assert (tmp_path / rig.stem / name).read_bytes() == (tmp_path / "both" / rig.stem / name).read_bytes()
    world = lines(tmp_path / "both" / "truth.jsonl")
    assert len(world) == 1
    assert all(robot["visible"].keys() == {"left", "right"} for robot in world[0]["robots"])


def test_what_does_not_go_together_is_refused(
    rigs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    away = looking_at(np.array([9.0, 0.0, 1.3]), np.array([9.1, 0.0, 0.0]))
    elsewhere = f"position: {away.position.tolist()}\n  orientation: {away.orientation.tolist()}"
    moved = RIG.replace("[-0.0240, -0.0285, 0.012]", "[-0.0240, -0.0280, 0.012]")
    nowhere = RIG.replace("world:  ", "#world:  ").replace("  position: [0.0", "#").replace("  orientation: [1.0", "#")
    nowhere = nowhere.replace("    normal: {world: [0, 0, 1], within_deg: 40}\n", "")
    others = {
        "twin": (write(tmp_path, "left"), "its camera is called 'left' as that of"),
        "moved": (write(tmp_path, "moved", moved), "its robot alpha is not that of"),
        "nowhere": (write(tmp_path, "nowhere", nowhere), "has no `world`, expected where its camera stands"),
        "away": (write(tmp_path, "away", RIG.replace(DOWN, elsewhere)), "does not look at the floor about the world's"),
        "fewer": (
            write(tmp_path, "fewer", RIG[: RIG.index("  echo:")]),
            "robots that drive: alpha, bravo, charlie, delta; expected those of",
        ),
    }
    for other, told in others.values():
        assert told in refused(capsys, "simulate", rigs[0], other, out)
    assert "expected one RIG" in refused(capsys, "simulate", *rigs, out, "--hand", "alpha")
    assert "expected one RIG" in refused(capsys, "simulate", *rigs, out, "--pivot", "alpha:tool")
    assert "--stagger is for several cameras" in refused(capsys, "simulate", rigs[0], out, "--stagger")
    assert not out.exists()
