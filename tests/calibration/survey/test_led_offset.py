"""The LEDs' own optics: theory against rays traced by Snell's law, the pose loop, `asterism calibrate offset`."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, angle_between, exp_rotation
from asterism.protocol.led_offset import LedOffset, parse_offset
from asterism.protocol.rig import Rig, load_rig, parse_rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.__main__ import main
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.survey.offset import calibrate_offset, with_offset
from asterism.server.calibration.survey.surveyed_fit import errors_of
from asterism.server.pose.spot_shift import OPTICS, optics_of, spot_shifts
from asterism.server.simulation.simulate import Scene
from tests.calibration.survey.surveys import survey_pairs, write_frames, write_rig, write_survey
from tests.calibration.survey.traced_leds import DOME, seen_at
from tests.chain.frames import draw
from tests.command.test_command_line import refused
from tests.helpers import assert_poses_close, facing_pose
from tests.rigs import make_rig


def traced(led: Floats, axis: Floats) -> Floats:
    return seen_at(DOME, led, axis)


def test_the_compiled_shift_is_the_projection_of_the_moved_led(rng: np.random.Generator) -> None:
    values, per_metre = 1e-3 * rng.standard_normal((2, 9))
    offset = LedOffset(values, np.radians(40.0), per_metre, 0.9, np.zeros((0, 9)), float("nan"), 0.0)
    axis = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    robot = replace(make_rig(1, seed=2).robots[0], axis=axis, led_offset=offset, led_radius=None)
    for _ in range(20):
        plane = facing_pose(rng, (0.5, 1.5), (0.0, 60.0))
        pose = plane @ robot.T_robot_plane.inverse()
        shifts = np.empty((6, 2))
        spot_shifts(plane.rotation, plane.position, robot.leds_plane, optics_of(robot), shifts)
        leds = pose.map(robot.leds)
        facing = leds @ (pose.rotation @ axis) / np.linalg.norm(leds, axis=1)
        shifted = offset.shift(np.arccos(-facing), np.linalg.norm(leds, axis=1))
        seen = leds + shifted[:, None] * (pose.rotation @ axis)
        np.testing.assert_allclose(shifts, seen[:, :2] / seen[:, 2:] - leds[:, :2] / leds[:, 2:], atol=1e-12)
    assert optics_of(replace(robot, led_offset=None)).tolist() == [0.0] * OPTICS


def calibrated(rig: Rig, rng: np.random.Generator, count: int = 100) -> Rig:
    poses = [facing_pose(rng, (0.7, 1.2), (0.0, 55.0)) for _ in range(count)]
    pairs = survey_pairs(rig, rig, poses, rng, 0.01, traced)
    return with_offset(rig, calibrate_offset(rig, pairs, "film").offset)


def test_compensated_domes_are_as_good_as_leds_without_any_offset(rng: np.random.Generator) -> None:
    """At 0.8 m and 45 degrees, poses other than the surveyed ones."""
    rig = make_rig(1, seed=3)
    compensated = calibrated(rig, rng)
    poses = [facing_pose(rng, (0.8, 0.8), (45.0, 45.0)) for _ in range(150)]

    def errors(given: Rig, domes: bool) -> Floats:
        noise = np.random.default_rng(8)  # the same for all
        pairs = survey_pairs(rig, given, poses, noise, 0.01, traced if domes else None)
        away, turned = errors_of(pairs, given, [(s.pose, s.covariance) for s, _ in pairs])
        return np.append(np.sqrt((away**2).mean(axis=0)), np.median(turned))

    floor, left = errors(rig, domes=False), errors(compensated, domes=True)
    assert (left < 1.15 * floor).all(), (left, floor)
    assert (errors(rig, domes=True)[:2] > 20 * floor[:2]).all()


def test_what_is_noise_does_not_become_function(rng: np.random.Generator) -> None:
    rig = make_rig(1, seed=3)
    for _ in range(3):
        pairs = survey_pairs(rig, rig, [facing_pose(rng, (0.7, 1.2), (0.0, 55.0)) for _ in range(60)], rng, 0.02)
        found = calibrate_offset(rig, pairs, "film")
        angles = np.radians(np.arange(0.0, 50.0, 5.0))
        assert np.abs(np.sin(angles) * found.offset.shift(angles)).max() < 0.01e-3
        assert not found.helps


def test_a_survey_that_is_off_itself_is_noticed_and_one_wrong_pose_left_out(rng: np.random.Generator) -> None:
    rig = make_rig(1, seed=3)
    pairs = survey_pairs(rig, rig, [facing_pose(rng, (0.7, 1.2), (0.0, 55.0)) for _ in range(120)], rng, 0.02, traced)
    off = [
        (sighting, replace(told, position=told.position + 1e-4 * rng.standard_normal(3))) for sighting, told in pairs
    ]
    sighting, told = off[17]
    turned = exp_rotation(np.array([2.5, 0.0, 0.0])) @ told.pose.rotation
    wrong = Pose.from_matrix(turned, told.position + np.array([0.02, 0.0, 0.0]))
    off[17] = sighting, replace(told, position=wrong.position, orientation=wrong.orientation)
    found = calibrate_offset(rig, off, "film")
    assert np.flatnonzero(~found.used).tolist() == [17]
    assert found.helps
    assert not calibrate_offset(with_offset(rig, found.offset), off, "film").helps
    assert 0.07e-3 < found.spread.survey_m < 0.14e-3
    assert np.degrees(found.seen_up_to) < 62.0 < np.degrees(found.offset.up_to_rad)
    sharp = calibrate_offset(rig, pairs, "film").offset
    angles = np.radians(np.arange(0.0, 50.0, 5.0))
    across = np.sin(angles) * (found.offset.shift(angles) - sharp.shift(angles))  # the line of sight: what is seen
    assert np.abs(across).max() < 0.04e-3
    assert (np.abs(found.offset.values - sharp.values) < 5 * found.sigmas).all()


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A surveyed film of domes with reflections: 0 to 50 degrees."""
    folder = tmp_path_factory.mktemp("offset")
    rig = write_rig(folder, 3)
    rng = np.random.default_rng(11)
    poses = [facing_pose(rng, (0.7, 1.1), (tilt, tilt)) for tilt in np.linspace(1.0, 50.0, 45)]
    write_frames(folder / "frames", rig, poses, rng, traced)
    write_survey(folder / "truth.jsonl", "alpha", poses)
    return folder


def arguments(film: Path, *more: object, truth: str = "truth.jsonl", source: str = "frames") -> list[str]:
    return [str(a) for a in ("calibrate", "offset", film / "rig.yaml", film / source, "--truth", film / truth, *more)]


def test_the_command_makes_a_file_that_gives_the_surveyed_poses(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    out = tmp_path / "led.yaml"
    assert main(arguments(film, "-o", out)) == 0
    told = capsys.readouterr().out
    assert "in front: -2.4" in told
    assert "and with the distance: " in told
    assert "after, held out" in told
    (tmp_path / "camera.yaml").write_text((film / "camera.yaml").read_text())
    text = (film / "rig.yaml").read_text().replace("2.5e-3}", "2.5e-3, offset: led.yaml}")
    (tmp_path / "rig.yaml").write_text(text)
    rig = load_rig(tmp_path / "rig.yaml")
    # Cold, then warm: the constant part moves spots by more than what following allows for.
    tracks, last = Tracks.none(), Pose.identity()
    pose = facing_pose(rng, (0.8, 0.8), (45.0, 45.0))
    for index in range(3):
        last = Pose(pose.position + index * np.array([1e-4, 0.0, 0.0]), pose.orientation)
        image = draw(rig, {"alpha": last}, apparent=traced).expose(rng)
        result, tracks = localize(Frame(image, 1 + index * 16_666_667, index), rig, tracks)
        answer = result.answers["alpha"]
        assert isinstance(answer, PoseEstimate)
        assert np.linalg.norm(answer.position[:2] - last.position[:2]) < 0.06e-3
        assert abs(answer.position[2] - last.position[2]) < 0.3e-3
        assert angle_between(answer.pose.rotation, last.rotation) < np.radians(0.06)
        assert answer.rms_px < 0.02
    # Whoever only has the texts (a recording) gets the same rig.
    again = parse_rig(rig.rig_text, rig.camera_text, "recording", rig.offset_texts, rig.files)
    np.testing.assert_array_equal(optics_of(again.robots[0]), optics_of(rig.robots[0]))
    with pytest.raises(InputError, match=r"led.yaml is not at hand"):
        parse_rig(rig.rig_text, rig.camera_text, "recording")
    assert "exists; choose another name" in refused(capsys, *arguments(film, "-o", out))
    assert main(arguments(film, "-o", out, "--force")) == 0
    assert (tmp_path / "led.yaml.old-1").read_text() == out.read_text()
    assert re.search(
        r"poses that it was not fitted to gain: \d\.\d+ mm off an axis by the rig", capsys.readouterr().out
    )


def test_an_offset_that_does_not_help_is_not_written(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """LEDs without any; a led.yaml that is there stays, also with --force."""
    rng, out = np.random.default_rng(5), tmp_path / "led.yaml"
    poses = [facing_pose(rng, (0.7, 1.1), (tilt, tilt)) for tilt in np.linspace(1.0, 50.0, 20)]
    write_frames(tmp_path / "frames", load_rig(film / "rig.yaml"), poses, rng)
    write_survey(tmp_path / "truth.jsonl", "alpha", poses)
    source = arguments(film, "-o", out, source=str(tmp_path / "frames"), truth=str(tmp_path / "truth.jsonl"))
    assert main(source) == 0
    told = capsys.readouterr().out
    assert "poses that it was not fitted to do not gain: " in told
    assert f"not written: {out}; keep the rig" in told
    assert not out.exists()
    out.write_text("axial_shift: [0.0]\nup_to_deg: 60\n")
    assert main([*source, "--force"]) == 0
    assert "led.yaml stays as it was; keep the rig" in capsys.readouterr().out
    assert [path.name for path in tmp_path.glob("led*")] == ["led.yaml"]


def test_simulated_frames_of_a_rig_with_an_offset_have_it(rng: np.random.Generator) -> None:
    rig = with_offset(make_rig(1, seed=3), LedOffset.polynomial(np.array([-2e-3, 4e-4]), np.radians(60.0)))
    scene = Scene(rig, seed=1)
    truth = scene.truth(3, 0.05)
    answer = localize(Frame(scene.render(3, truth), 1, 3), rig, Tracks.none())[0].answers["r00"]
    assert isinstance(answer, PoseEstimate)
    assert np.linalg.norm(answer.position - truth[0].T_camera_robot.position) < 0.5e-3


def test_poses_from_exact_centres_are_exact(rng: np.random.Generator) -> None:
    """The loop goes on until the shift stands still: nothing of the offset is left in the pose."""
    offset = LedOffset.polynomial(np.array([-2.5e-3, 3e-4, 4e-4]), np.radians(60.0))
    rig = with_offset(make_rig(1, seed=3), offset)
    rig = replace(rig, robots=(replace(rig.robots[0], led_radius=None),))

    def apparent(led: Floats, axis: Floats) -> Floats:
        angle = np.arccos(-(led @ axis) / np.linalg.norm(led))
        return led + float(offset.shift(np.array(angle))) * axis

    for _ in range(30):
        pose = facing_pose(rng, (0.6, 1.2), (20.0, 55.0))
        pairs = survey_pairs(rig, rig, [pose], rng, 1e-9, apparent)
        answer = solve_sightings(rig, [pairs[0][0]])[0]
        assert answer is not None
        assert_poses_close(answer[0], pose, 2e-7, 5e-6)


def test_surveys_that_cannot_be_meant_are_refused_with_what_is_missing(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "led.yaml"
    lines = (film / "truth.jsonl").read_text().splitlines()[:20]

    def told(text: str, *more: str, source: str = "frames/000[01]*.png") -> str:
        (film / "bad.jsonl").write_text(text)
        return refused(capsys, *arguments(film, *more, "-o", out, truth="bad.jsonl", source=source))

    assert "angles of 15 to 30, 30 to 45 degrees are missing" in told("\n".join(lines[:13]))
    assert "7 of its poses belong to robots that were located" in told("\n".join(lines[:7]))
    assert "names none of the frames" in told("\n".join(line.replace("0", "a", 1) for line in lines[:15]))
    values = [json.loads(line) for line in lines]
    for value in values:
        value["robots"][0]["position"] = [1e3 * x for x in value["robots"][0]["position"]]
    assert "is that mm?" in told("\n".join(json.dumps(value) for value in values))
    values = [json.loads(line) for line in lines]
    for value in values:
        value["robots"][0]["orientation"] = np.roll(value["robots"][0]["orientation"], 1).tolist()
    assert "is that w x y z?" in told("\n".join(json.dumps(value) for value in values))
    assert not out.exists()


def test_led_files_are_read_strictly(tmp_path: Path) -> None:
    for text, words in (
        ("axial_shift: [1e-3]\n", "up_to_deg: is missing"),
        ("axial_shift: []\nup_to_deg: 50\n", "0 values, expected 1 to 8"),
        ("axial_shift: [1.5]\nup_to_deg: 50\n", "is that mm?"),
        ("axial_shift: [0.001]\nup_to_deg: 95\n", "expected at most 90"),
        ("axial: [0.001]\nup_to_deg: 5\n", "axial"),
        ("up_to_deg: 50\n", "shift: is missing"),
        (f"shift: {[1e-3] * 25}\nup_to_deg: 50\n", "25 values, expected 1 to 24"),
        ("shift: [1.0, 2.0]\nup_to_deg: 50\n", "is that mm?"),
        ("shift: [1e-3, 2e-3]\nup_to_deg: 50\nper_metre: [1e-4]\ndistance: 1\n", "1 values, expected 2 numbers"),
        ("shift: [1e-3, 2e-3]\nup_to_deg: 50\nper_metre: [1e-4, 0]\n", "distance: is missing"),
        ("shift: [1e-3, 2e-3]\nup_to_deg: 50\ndoubt: [[1e-4]]\n", "doubt[0]: 1 values"),
        ("shift: [1e-3, 2e-3]\nup_to_deg: 50\nscatter_px: 5\nstrange_px: 0\n", "scatter_px: 5, expected at most 2"),
    ):
        with pytest.raises(InputError) as caught:
            parse_offset(text, "led.yaml")
        assert words in str(caught.value)
    with pytest.raises(
        InputError, match=r"led.offset: there is no file .*led.yaml, expected one that asterism calibrate"
    ):
        write_rig(tmp_path, 3, "{radius: 2.5e-3, offset: glass/led.yaml}")
