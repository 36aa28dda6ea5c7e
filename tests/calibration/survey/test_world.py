"""`asterism calibrate world`: the camera's place from robots at surveyed places and from a board on the floor."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.calibration.leds.observations import LedCentres, Sighting
from asterism.server.calibration.survey.survey import SurveyedPose
from asterism.server.calibration.survey.world import fit_world
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.helpers import assert_poses_close, random_pose, random_rotation

NOWHERE = LedCentres(np.full((6, 2), np.nan), np.full((6, 2, 2), np.nan))
Pair = tuple[Sighting, SurveyedPose]


def covariance_of(rng: np.random.Generator) -> Floats:
    """As poses of a camera above have them: z and tilts are known worse, and not independently."""
    mixed = np.diag([2e-5, 2e-5, 2e-4, 2e-3, 2e-3, 3e-4]) @ (np.eye(6) + 0.2 * rng.standard_normal((6, 6)))
    covariance: Floats = mixed @ mixed.T
    return covariance


def surveyed(
    rng: np.random.Generator, T_world_camera: Pose, count: int, noise: float = 0.0, oriented: bool = True,
    survey_m: float = 0.0, survey_rad: float = 0.0,
) -> list[Pair]:  # fmt: skip
    """Robots at random places before the camera, seen with ``noise`` times their covariance's errors."""
    pairs = []
    for k in range(count):
        position = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), rng.uniform(1.1, 1.4)])
        true = Pose.from_matrix(random_rotation(rng), position)
        covariance = covariance_of(rng)
        off = noise * np.linalg.cholesky(covariance) @ rng.standard_normal(6)
        seen = Pose.from_matrix(exp_rotation(off[3:]) @ true.rotation, true.position + off[:3])
        place = T_world_camera @ true
        turned = Pose.from_matrix(exp_rotation(survey_rad * rng.standard_normal(3)) @ place.rotation, np.zeros(3))
        pairs.append(
            (
                Sighting(f"{k}", k, "alpha", NOWHERE, seen, covariance, None),
                SurveyedPose(
                    "alpha",
                    place.position + survey_m * rng.standard_normal(3),
                    turned.orientation if oriented else None,
                ),
            )
        )
    return pairs


@pytest.mark.parametrize("oriented", [True, False])
@pytest.mark.parametrize("count", [3, 12])
def test_exact_surveys_give_the_exact_camera(rng: np.random.Generator, oriented: bool, count: int) -> None:
    T_world_camera = random_pose(rng)
    fit = fit_world(surveyed(rng, T_world_camera, count, oriented=oriented), "survey")
    assert_poses_close(fit.T_world_camera, T_world_camera, 1e-9, 1e-9)
    assert np.abs(fit.residuals_m).max() < 1e-9
    assert np.isfinite(fit.held_out_m).all() == (count > 3)
    assert fit.used.all()


@pytest.mark.parametrize(("survey_m", "survey_rad"), [(0.0, 0.0), (0.5e-3, 5e-3)])
def test_errors_are_as_large_as_the_covariance_says(
    rng: np.random.Generator, survey_m: float, survey_rad: float
) -> None:
    squared, trials = [], 20
    for _ in range(trials):
        T = random_pose(rng)
        fit = fit_world(surveyed(rng, T, 20, noise=1.0, survey_m=survey_m, survey_rad=survey_rad), "survey")
        turned = log_rotation(T.rotation @ fit.T_world_camera.rotation.T)
        off = np.concatenate([T.position - fit.T_world_camera.position, turned])
        squared.append(off @ np.linalg.solve(fit.covariance, off))
    # The survey's variance is estimated from the same few residuals, which widens the distribution somewhat.
    assert 6 - 4 * np.sqrt(12 / trials) < np.mean(squared) < 1.15 * 6 + 4 * np.sqrt(12 / trials)


def test_held_out_residuals_are_those_of_a_fit_without_the_sample(rng: np.random.Generator) -> None:
    pairs = surveyed(rng, random_pose(rng), 5, noise=1.0, survey_m=0.3e-3)
    fit = fit_world(pairs, "survey")
    for k, (sighting, place) in enumerate(pairs):
        alone = fit_world([pair for j, pair in enumerate(pairs) if j != k], "survey")
        off = place.position - (alone.T_world_camera @ sighting.pose).position
        # Refitting also finds the survey's variance anew, which shifts the weights a little.
        assert np.linalg.norm(off - fit.held_out_m[k]) < 0.3 * np.linalg.norm(off) + 1e-4
    assert (fit.held_out_m**2).sum() > (fit.residuals_m**2).sum()


def test_a_slip_in_the_survey_is_left_out(rng: np.random.Generator) -> None:
    T = random_pose(rng)
    pairs = surveyed(rng, T, 10, noise=1.0)
    sighting, place = pairs[4]
    pairs[4] = (sighting, SurveyedPose("alpha", place.position + np.array([0.05, 0.0, 0.0]), place.orientation))
    fit = fit_world(pairs, "survey")
    assert fit.used.tolist() == [k != 4 for k in range(10)]
    assert_poses_close(fit.T_world_camera, T, 1e-3, 1e-3)
    assert np.linalg.norm(fit.held_out_m[4]) == pytest.approx(0.05, rel=0.05)


def test_the_tilt_that_the_survey_says_is_taken(rng: np.random.Generator) -> None:
    T = random_pose(rng)
    pairs = surveyed(rng, T, 6)
    pairs = [
        (
            replace(
                sighting,
                pose=Pose.from_matrix(random_rotation(rng, 0.3) @ sighting.pose.rotation, sighting.pose.position),
                alternative=sighting.pose,
            ),
            place,
        )
        for sighting, place in pairs
    ]
    fit = fit_world(pairs, "survey")
    assert_poses_close(fit.T_world_camera, T, 1e-9, 1e-9)
    assert np.abs(fit.residuals_rad).max() < 1e-9


def test_frames_of_one_place_count_as_one_sample(rng: np.random.Generator) -> None:
    T = random_pose(rng)
    pairs = surveyed(rng, T, 4)
    repeated = [(replace(s, frame=f"{s.frame}-{k}"), place) for s, place in pairs for k in range(5)]
    fit = fit_world(repeated, "survey")
    assert [sample.frames for sample in fit.samples] == [5] * 4
    assert_poses_close(fit.T_world_camera, T, 1e-9, 1e-9)


def test_places_that_do_not_determine_the_camera_are_refused(rng: np.random.Generator) -> None:
    T = random_pose(rng)
    pairs = surveyed(rng, T, 8)
    with pytest.raises(
        InputError, match="2 places are surveyed and seen, expected at least 3 that do not lie on one line"
    ):
        fit_world(pairs[:2], "survey")
    same = [(replace(s, frame=f"{k}"), place) for k, (s, place) in enumerate([pairs[0]] * 5)]
    with pytest.raises(InputError, match="1 places are surveyed and seen"):
        fit_world(same, "survey")
    line = []
    for k, (sighting, place) in enumerate(pairs):
        seen = Pose(np.array([0.1 * k, 0.05 * k, 1.2]), sighting.pose.orientation)
        line.append((replace(sighting, pose=seen), replace(place, position=(T @ seen).position)))
    with pytest.raises(InputError, match=r"lie on one line .collinear: they spread by"):
        fit_world(line, "survey")
    mm = [(s, replace(place, position=1e3 * place.position)) for s, place in pairs]
    with pytest.raises(InputError, match=r"1e.03 times as far apart .* are the surveyed positions in mm\?"):
        fit_world(mm, "survey")


def write_sim(folder: Path, frames: int = 3) -> None:
    assert main(["simulate", str(DEMO_RIG), str(folder), "--frames", str(frames), "--rate", "1"]) == 0


def test_the_command_places_the_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With places alone and with poses; a wrong world in the rig does no harm, comments stay, paths still lead."""
    write_sim(tmp_path / "sim")
    true = load_rig(tmp_path / "sim" / "rig.yaml").T_world_camera
    assert true is not None
    text = (tmp_path / "sim" / "rig.yaml").read_text()
    wrong = text.replace("position: [0.0, 0.0, 1.3]", "position: [3.0, 0.0, -1.3]").replace(
        "orientation: [1.0, 0.0, 0.0, 0.0]", "orientation: [0.0, 0.0, 0.0, 1.0]  # to do"
    )
    assert wrong != text
    (tmp_path / "sim" / "wrong.yaml").write_text(wrong)
    lines = [json.loads(row) for row in (tmp_path / "sim" / "truth.jsonl").read_text().splitlines()]
    for entry in lines:
        for robot in entry["robots"]:
            del robot["orientation"], robot["visible"]
    (tmp_path / "places.jsonl").write_text("\n".join(map(json.dumps, lines)))
    out = tmp_path / "out"
    out.mkdir()
    for truth in (tmp_path / "sim" / "truth.jsonl", tmp_path / "places.jsonl"):
        arguments = ["world", tmp_path / "sim" / "wrong.yaml", tmp_path / "sim" / "frames", "--truth", truth]
        code = main(["calibrate", *map(str, arguments), "-o", str(out / "rig.yaml"), "--force"])
        told = capsys.readouterr()
        assert code == 0, told.err
        assert "held out" in told.out
        assert "each held out and predicted from the others" in told.out.replace("\n", " ")
        assert "alpha in 00000.png" in told.out
        found = load_rig(out / "rig.yaml").T_world_camera
        assert found is not None
        assert_poses_close(found, true, 1e-3, 1e-3)
    assert "the old one is kept as" in told.out
    new = (out / "rig.yaml").read_text()
    assert "# to do" in new
    assert "camera: ../sim/camera.yaml" in new
    mirrored = json.loads(json.dumps(lines))
    for robot in (robot for entry in mirrored for robot in entry["robots"]):
        robot["position"][:2] = robot["position"][1::-1]
    (tmp_path / "mirrored.jsonl").write_text("\n".join(map(json.dumps, mirrored)))
    arguments = ["world", tmp_path / "sim" / "wrong.yaml", tmp_path / "sim" / "frames"]
    main(["calibrate", *map(str, arguments), "--truth", str(tmp_path / "mirrored.jsonl"), "-o", str(out / "m.yaml")])
    assert "are x and y of the survey swapped" in capsys.readouterr().err
    (tmp_path / "one.jsonl").write_text(json.dumps({"frame": "00001.png", "robots": lines[1]["robots"][:2]}))
    code = main(["calibrate", *map(str, arguments), "--truth", str(tmp_path / "one.jsonl"), "-o", str(out / "o.yaml")])
    told_lines = capsys.readouterr().err.splitlines()
    assert code == 2
    assert "2 frames (00000.png, 00002.png) are not in" in told_lines[0]
    assert "2 places are surveyed and seen, expected at least 3" in told_lines[1]
