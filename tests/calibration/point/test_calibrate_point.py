"""`asterism calibrate point`: a simulated film through the command, what the rig says then, bad arguments."""

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.geometry import Pose
from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.report import frame_report
from asterism.server.pose.track import Tracks
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.open_source import open_source
from tests.command.test_command_line import refused

FRAMES = 40
TRUE = np.array([0.0, 0.0, -0.03])
DRAWN = "[0.0010, 0.0, -0.0290]"  # the tool, as its drawing has it


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film of the demonstration's alpha, and its rig alone with another tool and a file of uncertainties."""
    folder = tmp_path_factory.mktemp("point") / "film"
    with contextlib.redirect_stdout(io.StringIO()):
        pivot = ("simulate", str(DEMO_RIG), str(folder), "--pivot", "alpha:tool", "--frames", str(FRAMES))
        assert main(list(pivot)) == 0
    text = (folder / "rig.yaml").read_text()
    alone = text[: text.index("  bravo:")].replace("[0.0, 0.0, -0.03]", DRAWN)
    (folder / "alone.yaml").write_text(alone)
    (folder / "uncertainty.yaml").write_text("led_position_m: 2e-6\noffset_m: 0.0\nfocal_relative: 1e-4\n")
    return folder


def test_a_simulated_robot_pivots_about_its_point(folder: Path) -> None:
    T_world_robot = [json.loads(line)["robots"][0] for line in (folder / "truth.jsonl").read_text().splitlines()]
    rig = load_rig(folder / "rig.yaml")
    poses = [Pose(np.array(one["position"]), np.array(one["orientation"])) for one in T_world_robot]
    tips = np.array([pose.map(rig.robot("alpha").points["tool"]) for pose in poses])
    np.testing.assert_allclose(tips, tips[:1].repeat(FRAMES, axis=0), atol=1e-9)
    leans = np.degrees([np.arccos(pose.rotation[2, 2]) for pose in poses])
    assert 27.0 < leans.max() < 30.0 + 1e-6
    assert {one["id"] for one in T_world_robot} == {"alpha"}


def test_a_film_gives_the_point(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rig2.yaml"
    words = ["calibrate", "point", str(folder / "alone.yaml"), str(folder / "frames"), "--robot", "alpha"]
    assert main([*words, "--name", "tool", "-o", str(out)]) == 0
    told = capsys.readouterr().out
    point = load_rig(out).robot("alpha").points["tool"]
    assert np.abs(point - TRUE).max() <= 0.02e-3
    assert f"alpha is located in {FRAMES} of {FRAMES} frames; its point rests at one place in " in told
    row = next(line.split() for line in told.splitlines() if line.split()[:2] == ["moved", "by"])
    np.testing.assert_allclose([float(value) for value in row[2:]], [-1.0, 0.0, -1.0], atol=0.02)
    assert "LEDs 0.002 mm off an axis (given), the lens (by " in told
    # The rest of the rig is as it was, but for paths, and one line above the point says what it is worth.
    new, old = out.read_text().splitlines(), (folder / "alone.yaml").read_text().splitlines()
    own = [line for line in new if line.startswith("    # asterism calibrate point tool: +- 0.0")]
    assert len(own) == 1
    assert new[new.index(own[0]) + 1].startswith("    points: {tool: [")
    rest = [line for line in new if line not in own]
    assert [a for a, b in zip(rest, old, strict=True) if a != b and "points:" not in a] == [rest[1]]
    assert rest[1].startswith("camera: ")
    # A second point, and the first once more: each has its own line.
    again = tmp_path / "rig3.yaml"
    words[2:4] = str(out), str(folder / "frames" / "*[0369].png")
    assert main([*words, "--name", "probe", "-o", str(again)]) == 0
    assert main([*words[:2], str(again), *words[3:], "--name", "tool", "-o", str(again), "--force"]) == 0
    assert again.read_text().count("# asterism calibrate point") == 2
    points = load_rig(again).robot("alpha").points
    assert list(points) == ["tool", "probe"]
    np.testing.assert_allclose(points["probe"], TRUE, atol=0.05e-3)
    assert (tmp_path / "rig3.yaml.old-1").exists()
    capsys.readouterr()
    refused(capsys, *words, "--name", "tool", "-o", again)
    # Frames are reported with it.
    rig = load_rig(again)
    frame: Frame = next(iter(open_source(str(folder / "frames"), rig, lambda _: None).frames()))
    (robot,) = frame_report(frame, localize(frame, rig, Tracks.none())[0], rig, 0).robots
    tip = robot.points["probe"]
    pose = robot.pose.position
    away = np.array([tip.x - pose.x, tip.y - pose.y, tip.z - pose.z])
    assert np.linalg.norm(away) == pytest.approx(np.linalg.norm(points["probe"]), abs=1e-9)


def test_bad_arguments_are_refused_before_the_work(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, out = folder / "rig.yaml", tmp_path / "out.yaml"

    def told(*words: object, rig: Path = rig, source: object = folder / "frames") -> str:
        return refused(capsys, "calibrate", "point", rig, source, "-o", out, *words)

    assert "--robot zulu: is not in " in (sentence := told("--robot", "zulu", "--name", "tool"))
    assert "expected one of alpha, bravo, charlie, delta, echo" in sentence
    assert "--name '': is empty" in told("--robot", "alpha", "--name", "")
    assert "--name 'a/b': holds '/'" in told("--robot", "alpha", "--name", "a/b")
    assert "/dev/video0: has no end" in told("--robot", "alpha", "--name", "tool", source="/dev/video0")
    shared = folder / "shared.yaml"
    first, second, *others = rig.read_text().split("points: {tool: [0.0, 0.0, -0.03]}")
    shared.write_text(first + "points: &same {tool: [0, 0, 0]}" + second + "points: *same".join(["", *others]))
    assert "robots.alpha.points: is shared by an anchor" in told("--robot", "alpha", "--name", "tool", rig=shared)
    assert not out.exists()
    for argument, sentence in (
        ("zulu:tool", "--pivot zulu:tool: 'zulu' is not in the rig, expected one of alpha, "),
        ("alpha:tip", "--pivot alpha:tip: alpha has no point 'tip', expected one of tool"),
        ("alpha", "--pivot alpha: '' is not in the rig"),
    ):
        assert sentence in refused(capsys, "simulate", rig, tmp_path / "new", "--pivot", argument)


def test_a_film_without_the_robot_is_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = tmp_path / "few"
    few.mkdir()
    for name in sorted((folder / "frames").iterdir())[:3]:
        (few / name.name).write_bytes(name.read_bytes())
    for robot, found in (("alpha", "3"), ("bravo", "none")):
        sentence = refused(
            capsys, "calibrate", "point", folder / "rig.yaml", few, "--robot", robot, "--name", "tip", "-o",
            tmp_path / "out.yaml",
        )  # fmt: skip
        assert f"{robot} is located in {found} of its frames, expected 12 at least" in sentence
