"""`asterism calibrate leds`: a rendered film through the command, a wrong start, films that leave the LEDs open."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import Rig, load_rig
from asterism.server.__main__ import main
from asterism.server.budget.uncertainty import read_uncertainty
from asterism.server.calibration.leds.gauge import rigid_fit
from asterism.server.calibration.leds.tolerant import TolerantSearch
from asterism.server.chain.frame import Frame
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.calibration.leds.films import hand_poses, off_by, write_film
from tests.command.test_command_line import refused


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Rig]:
    folder = tmp_path_factory.mktemp("film") / "film"
    return folder, write_film(folder, 40, 3, look=Look(hidden=0.02, glints=4))


def distance(rig: Rig, first: int = 1, second: int = 4) -> str:
    leds = rig.robots[0].leds
    return f"{first},{second}={np.linalg.norm(leds[first] - leds[second]):.6f}"


def rms_m(rig: Rig, true: Rig) -> float:
    turn, shift = rigid_fit(rig.robots[0].leds, true.robots[0].leds)
    off = rig.robots[0].leds @ turn.T + shift - true.robots[0].leds
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def test_a_film_gives_the_positions(film: tuple[Path, Rig], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, true = film
    out = tmp_path / "rig.yaml"
    arguments = ["leds", str(folder / "rig.yaml"), str(folder / "frames"), "--robot", "alpha"]
    assert main(["calibrate", *arguments, "--distance", distance(true), "-o", str(out)]) == 0
    told = capsys.readouterr().out
    found = load_rig(out)
    assert rms_m(load_rig(folder / "rig.yaml"), true) > 0.5e-3
    assert rms_m(found, true) <= 0.02e-3
    assert "(off the plane: " in told
    assert "frame: the best fit to the positions that stood here before, which were off by " in told
    # The frame is the old one's, comments and other numbers are as they were.
    turn, shift = rigid_fit(found.robots[0].leds, load_rig(folder / "rig.yaml").robots[0].leds)
    np.testing.assert_allclose(turn, np.eye(3), atol=1e-5)
    np.testing.assert_allclose(shift, np.zeros(3), atol=1e-7)
    new, old = out.read_text().splitlines(), (folder / "rig.yaml").read_text().splitlines()
    own = [line for line in new if line.startswith("    # asterism calibrate leds: ")]
    assert len(own) == 3
    assert "; scale: LEDs 1 and 4 are " in own[0]
    bare = [[re.sub(r"\[.*\]", "", line) for line in lines if line not in own] for lines in (new, old)]
    assert bare[0][3:] == bare[1][3:]
    assert "range: [0.70, 1.8]" in new
    assert new[-1] == "    led: {radius: 2.5e-3}"
    # What is not known exactly stands beside the rig, of this robot alone.
    beside = read_uncertainty(out, "edge-model")
    assert beside.file == tmp_path / "rig.uncertainty.yaml"
    assert list(beside.robots) == ["alpha"]
    known = beside.leds_of("alpha")
    assert 0.3e-6 < known.position_m < 20e-6
    assert known.size_relative == pytest.approx(0.1e-3 / float(distance(true).partition("=")[2]), rel=0.01)
    assert 0.2e-3 < known.frame_m < 0.6e-3
    assert known.by == "measured: calibrate leds"
    assert beside.leds_of("bravo").by == "assumed"
    # Nothing is overwritten unasked.
    assert "exists; choose another name" in refused(
        capsys, "calibrate", *arguments, "--distance", distance(true), "-o", out
    )


def test_two_leds_hold_the_frame_and_the_rig_says_so_once(
    film: tuple[Path, Rig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, true = film
    given, out = load_rig(folder / "rig.yaml"), tmp_path / "rig.yaml"
    arguments = [str(folder / "frames"), "--robot", "alpha", "--distance", distance(true), "--frame", "2,5"]
    assert main(["calibrate", "leds", str(folder / "rig.yaml"), *arguments, "-o", str(out)]) == 0
    assert "frame: LED 2 stays where it stood, LED 5 in its direction" in capsys.readouterr().out
    found = load_rig(out)
    np.testing.assert_allclose(found.robots[0].leds[2], given.robots[0].leds[2], atol=1e-7)
    assert main(["calibrate", "leds", str(out), *arguments, "-o", str(out), "--force"]) == 0
    assert out.read_text().count("# asterism calibrate leds: ") == 3
    np.testing.assert_allclose(load_rig(out).robots[0].leds, found.robots[0].leds, atol=2e-7)
    capsys.readouterr()
    said = refused(capsys, "calibrate", "leds", out, *arguments[:-1], "2,2", "-o", tmp_path / "no.yaml")
    assert "'2,2', expected I,J: two LEDs from 0 to 5" in said


def test_a_robot_off_by_a_millimetre_is_found_where_the_chain_gives_up(rng: np.random.Generator) -> None:
    """At the near end, where a millimetre is most pixels; with glints, each labelled right."""
    from asterism.protocol.geometry import Pose
    from tests.rigs import make_rig

    true = make_rig(1, seed=4)
    robot = true.robots[0]
    scene = Scene(true, look=Look(glints=8))
    found = 0
    for index, pose in enumerate(hand_poses(30, 9, depths_m=(0.8, 0.9))):
        image = scene.render(index, [Truth(robot.id, pose @ robot.T_robot_plane.inverse(), (True,) * 6)])
        off = replace(robot, leds=robot.leds + off_by(rng, 1e-3))
        search = TolerantSearch(replace(true, robots=(off,)), robot.id)
        answer = search.find(Frame(image, 0, index))
        if answer is None:
            continue
        found += 1
        centres, rough = answer
        pixels = true.camera.project((pose @ robot.T_robot_plane.inverse()).map(robot.leds))
        seen = np.isfinite(centres.centres_px[:, 0])
        assert np.linalg.norm((centres.centres_px - pixels)[seen], axis=1).max() < 0.5
        assert isinstance(rough, Pose)
        assert np.linalg.norm(rough.position - pose.position) < 0.05
    assert found >= 27


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ("shifted", "tilt the robot by 20 degrees and more in at least two directions"),
        ("turned flat", "tilt the robot by 20 degrees and more in at least two directions"),
        ("one axis", "or turn it about its normal while it is tilted"),
    ],
)
def test_films_without_the_motion_are_refused_with_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], motion: str, words: str
) -> None:
    folder, out = tmp_path / "film", tmp_path / "rig.yaml"
    true = write_film(folder, 16, 3, motion)
    arguments = ("leds", folder / "rig.yaml", folder / "frames", "--robot", "alpha", "--distance", distance(true))
    assert words in refused(capsys, "calibrate", *arguments, "-o", out)
    assert not out.exists()


def test_bad_input_gets_one_sentence(
    film: tuple[Path, Rig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, true = film
    rig, frames, out = folder / "rig.yaml", folder / "frames", tmp_path / "out.yaml"
    metres = distance(true).split("=")[1]
    for source, robot, measured, words in (
        (frames, "bravo", distance(true), "--robot bravo: is not in"),
        (frames, "alpha", f"1,4={1e3 * float(metres)}", "is that mm?"),
        (frames, "alpha", f"1,4={2 * float(metres)}", "LEDs count from 0"),
        (f"{frames}/0000*.png", "alpha", distance(true), "frames show all six LEDs of alpha, expected at least 12"),
        ("sim", "alpha", distance(true), "sim: has no end; calibrate leds takes"),
        (tmp_path / "none", "alpha", distance(true), "there is no such source"),
    ):
        told = refused(capsys, "calibrate", "leds", rig, source, "--robot", robot, "--distance", measured, "-o", out)
        assert words in told
    assert "there is no folder" in refused(
        capsys, "calibrate", "leds", rig, frames, "--robot", "alpha", "--distance", distance(true), "-o", out / "x"
    )
    assert not out.exists()
