"""`asterism calibrate surface`: poses of a drive through the command, what the rig says then, and bad input."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.geometry import Pose
from asterism.protocol.rig import load_rig
from asterism.protocol.surface import Heights, within
from asterism.server.__main__ import main
from asterism.server.calibration.surface.visited import Visited
from tests.calibration.surface.driven import Driven, Ground, bowl, bumps, drive, located, upright, ways
from tests.command.test_command_line import refused
from tests.on_surface import TOOL
from tests.several_files import write_rigs

RATE_HZ = 8.0


def written(folder: Path, driven: Driven, tool: bool = True) -> tuple[Path, Path]:
    """The rig as a file that a person commented, and the drive's poses as lines."""
    (path,) = write_rigs(folder, [driven.rig])
    robots = ""
    for robot in driven.rig.robots:
        robots += f"  {robot.id}:\n    leds: {robot.leds.tolist()}\n    led: {{radius: {robot.led_radius}}}\n"
        robots += f"    points: {{tool: {TOOL.tolist()}}}  # drawn\n" if tool else ""
    path.write_text("# mine\n" + path.read_text().replace("robots: robots.yaml\n", f"robots:\n{robots}"))
    path.with_name("uncertainty.yaml").write_text("led_position_m: 0.0\n")
    lines = folder / "poses.jsonl"
    found = located(driven, 0)
    with lines.open("w") as out:
        for time_s in np.unique(found.times_s):
            robots = []
            for k in np.flatnonzero(found.times_s == time_s):
                pose = Pose.from_matrix(found.rotations[k, 0], found.ts[k, 0])
                told = {"position": pose.position.tolist(), "orientation": pose.orientation.tolist()}
                covariance = found.covariances[k].ravel().tolist()
                robots.append({"id": found.ids[found.robots[k]], **told, "covariance": covariance})
            out.write(json.dumps({"frame": "f", "exposed_ns": round(time_s * 1e9), "robots": robots}) + "\n")
    return path, lines


def test_a_bumpy_surface_is_written_with_what_it_is_worth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, lines = written(tmp_path, drive(bumps, rate_hz=RATE_HZ))
    out = tmp_path / "new" / "rig2.yaml"
    out.parent.mkdir()
    assert main(["calibrate", "surface", str(rig), str(lines), "-o", str(out)]) == 0
    told = capsys.readouterr().out
    assert "the surface is a spline" in told
    assert max(len(line) for line in told.splitlines() if not line.startswith("written")) <= 80
    new = load_rig(out)
    assert new.surface is not None
    assert isinstance(new.surface.shape, Heights)
    places = np.random.default_rng(5).uniform([-0.24, -0.17], [0.24, 0.17], (500, 2))
    ground = new.surface.ground(places)
    inside = ground.inside
    assert inside.mean() > 0.9
    off = (ground.heights - bumps(places)[0])[inside]
    assert np.sqrt((off**2).mean()) < 0.06e-3  # a 60 s drive at 8 Hz
    assert (np.abs(off) < 2.0 * ground.sigmas[inside]).mean() >= 0.9
    assert not new.surface.ground(np.array([[0.4, 0.0], [0.0, -0.3]])).inside.any()
    for robot in new.robots:
        assert robot.stands is not None
        assert robot.stands.point == "tool"
        assert robot.stands.sigma_m < 0.1e-3
    # What a person wrote stays, and a second time replaces the surface.
    assert out.read_text().startswith("# mine\n")
    assert out.read_text().count("# drawn") == len(new.robots)
    assert main(["calibrate", "surface", str(out), str(lines), "-o", str(out), "--force"]) == 0
    assert out.read_text().count("# asterism calibrate surface: ") == 1
    assert load_rig(out).surface is not None


def test_a_quadric_keeps_its_edge_and_holes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, lines = written(tmp_path, drive(bowl, seconds=40.0, rate_hz=5.0))
    out = tmp_path / "rig2.yaml"
    assert main(["calibrate", "surface", str(rig), str(lines), "-o", str(out)]) == 0
    assert "the surface is a paraboloid" in capsys.readouterr().out
    surface = load_rig(out).surface
    assert surface is not None
    places = np.random.default_rng(5).uniform([-0.24, -0.17], [0.24, 0.17], (500, 2))
    ground = surface.ground(places)
    assert np.abs(ground.heights - bowl(places)[0])[ground.inside].max() < 0.05e-3
    assert ground.inside.mean() > 0.7  # ways are 24 mm from touch to touch
    assert not surface.ground(np.array([[0.4, 0.0], [0.0, -0.3]])).inside.any()
    # What no polygon goes about is told by a table.
    assert isinstance(surface.shape, Heights) == (tmp_path / "rig2.surface.csv").exists()


def ground_of(kind: str) -> tuple[Ground, Driven]:
    """Drives that tell no surface."""
    driven = drive(bowl, seconds=15.0, rate_hz=RATE_HZ)
    moved = ways(5, driven.times_s, 0)
    rng = np.random.default_rng(3)
    poses = {}
    for k, robot in enumerate(driven.rig.robots):
        lift = 0.03 * rng.uniform(size=len(driven.times_s)) if kind == "carried" else 0.0
        if kind == "line":
            moved[k, :, 1] = 0.3 * moved[k, :, 0]
        if kind == "still":
            moved[k, :] = moved[k, 0]
        poses[robot.id] = upright(bowl, moved[k], lift)
    return bowl, replace(driven, poses=poses)


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        ("carried", "robots do not touch one surface: places that it was not fitted to are "),
        ("line", "robots drove along one line only ("),
        ("still", "expected 60 at least; drive all over the surface"),
    ],
)
def test_a_drive_that_tells_no_surface_is_refused(
    kind: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, lines = written(tmp_path, ground_of(kind)[1])
    out = tmp_path / "rig2.yaml"
    assert sentence in refused(capsys, "calibrate", "surface", rig, lines, "-o", out)
    assert not out.exists()


def test_bad_arguments_are_refused_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    driven = drive(bowl, seconds=1.0, rate_hz=RATE_HZ)
    rig, lines = written(tmp_path, driven, tool=False)

    def told(*words: object) -> str:
        return refused(capsys, "calibrate", "surface", rig, lines, "-o", tmp_path / "out.yaml", *words)

    assert "no robot has `points`, expected the one by which it stands" in told()
    rig.write_text(rig.read_text().replace("  r00:\n", "  r00:\n    points: {foot: [0, 0, -0.03]}\n"))
    assert "no robot has a point 'tool' by which it stands, expected --point with one of foot" in told()
    assert "no robot has a point 'leg'" in told("--point", "leg")
    text = lines.read_text()
    lines.write_text(text.replace('"r01"', '"zulu"'))
    assert "'zulu': is not in the rig, expected one of r00, r01" in told("--point", "foot")
    rig.write_text("".join(line for line in rig.read_text().splitlines(True) if not line.startswith("world")))
    assert "has no `world`, the pose of the camera in the world" in told("--point", "foot")


def test_a_polygon_goes_about_what_is_in_one_piece() -> None:
    places = np.stack(np.meshgrid(np.arange(0.0, 0.2, 0.004), np.arange(0.0, 0.1, 0.004)), axis=-1).reshape(-1, 2)
    edge = Visited.by(places).outline()
    assert edge is not None
    assert within(edge, places).all()
    assert not within(edge, np.array([[0.23, 0.05], [0.1, -0.03]])).any()
    assert Visited.by(places[np.linalg.norm(places - [0.1, 0.05], axis=1) > 0.03]).outline() is None  # a hole
    assert Visited.by(np.concatenate([places, places + 0.5])).outline() is None  # two parts
