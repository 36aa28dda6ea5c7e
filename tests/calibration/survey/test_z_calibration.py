"""`asterism calibrate z`: the physical refit, the super-plane, what they say about themselves, and the command."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.codec import decode_odometry
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.messages import ODOMETRY
from asterism.protocol.rig import Rig, load_rig, parse_rig
from asterism.protocol.z_correction import ZCorrection
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.__main__ import main
from asterism.server.budget.uncertainty import read_uncertainty
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.lens.lens_error import read_lens_error
from asterism.server.calibration.lens.values import values_of
from asterism.server.calibration.survey.refit import refit
from asterism.server.calibration.survey.super_plane import choose_plane, fit_plane
from asterism.server.calibration.survey.surveyed import Pairs
from asterism.server.calibration.survey.surveyed_fit import errors_of
from asterism.server.chain.report import report
from asterism.server.command.calibrate_z import with_correction
from asterism.server.command.locate import line
from tests.calibration.survey.surveys import (
    off_rig,
    rim_layout,
    survey_pairs,
    write_frames,
    write_off_rig,
    write_rig,
    write_survey,
    z_errors,
)
from tests.chain.frames import draw
from tests.command.test_command_line import refused
from tests.helpers import facing_pose

SURVEY, OTHERS, SIGMA_PX = 60, 400, 0.02


@pytest.fixture(scope="module")
def true(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    return write_rig(tmp_path_factory.mktemp("true"), 1, layout=rim_layout(1))


def poses(rng: np.random.Generator, count: int) -> list[Pose]:
    return [facing_pose(rng) for _ in range(count)]


def z_rms(true: Rig, given: Rig, others: list[Pose]) -> float:
    """RMS error of Z, m, of other poses than those surveyed, always with the same noise."""
    places, errors, _ = z_errors(survey_pairs(true, given, others, np.random.default_rng(5), SIGMA_PX))
    if given.z_correction is not None:
        errors = errors - given.z_correction.at(places).dz
    return float(np.sqrt((errors**2).mean()))


def test_the_refit_brings_z_to_the_noise(true: Rig, rng: np.random.Generator) -> None:
    given, others = off_rig(true, rng), poses(rng, OTHERS)
    found = refit(given, survey_pairs(true, given, poses(rng, SURVEY), rng, SIGMA_PX))
    assert found.better
    floor = z_rms(true, true, others)
    assert z_rms(true, given, others) > 8 * floor
    assert z_rms(true, found.rig, others) < 1.1 * floor
    assert found.rig.camera.distortion[4] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found.rig.robots[0].leds, true.robots[0].leds, atol=0.02e-3)
    # What is left of surveyed poses that were held out is no better than it is.
    assert np.sqrt((found.after[0][:, 2] ** 2).mean()) > 0.7 * floor


@pytest.mark.parametrize(("kind", "times"), [("plane", 3.5), ("quadric", 5.0)])
def test_the_super_plane_alone_improves_z(true: Rig, rng: np.random.Generator, kind: str, times: float) -> None:
    given, others = off_rig(true, rng), poses(rng, OTHERS)
    pairs = survey_pairs(true, given, poses(rng, SURVEY), rng, SIGMA_PX)
    corrected = replace(given, z_correction=fit_plane(kind, *z_errors(pairs)))
    assert z_rms(true, corrected, others) < z_rms(true, given, others) / times
    chosen = choose_plane(*z_errors(pairs))
    assert chosen.correction is not None
    # The variance told is the error's: of other poses, squared errors over variances average about one.
    places, errors, variances = z_errors(survey_pairs(true, given, others, rng, SIGMA_PX))
    found = chosen.correction.at(places)
    assert 0.6 < float(((errors - found.dz) ** 2 / (variances + found.variances)).mean()) < 1.6


def test_where_nothing_is_off_nothing_is_changed(true: Rig, rng: np.random.Generator) -> None:
    for _ in range(3):
        pairs = survey_pairs(true, true, poses(rng, SURVEY), rng, SIGMA_PX)
        assert not refit(true, pairs).better
        assert choose_plane(*z_errors(pairs)).correction is None


def test_a_survey_in_a_world_that_is_off_and_inexact_itself(true: Rig, rng: np.random.Generator) -> None:
    world = Pose.from_matrix(np.diag([1.0, -1.0, -1.0]), np.array([0.1, 0.2, 1.9]))
    placed = replace(true, T_world_camera=world)
    given = off_rig(placed, rng)
    off = Pose.from_matrix(exp_rotation(np.array([2e-3, -1e-3, 1e-3])), np.array([1e-3, -2e-3, 1e-3]))
    given = replace(given, T_world_camera=world @ off)
    pairs = survey_pairs(placed, given, poses(rng, 100), rng, SIGMA_PX, hidden=0.3)
    pairs = [(s, replace(told, position=told.position + 1e-4 * rng.standard_normal(3))) for s, told in pairs]
    sighting, told = pairs[30]
    pairs[30] = sighting, replace(told, position=told.position + np.array([0.0, 0.03, 0.0]))
    found = refit(given, pairs)
    assert found.better
    assert np.flatnonzero(~found.fit.used).tolist() == [30]
    assert 0.07e-3 < found.fit.sigmas[1] < 0.14e-3

    def world_errors(rig: Rig) -> Floats:
        others = survey_pairs(placed, rig, poses(np.random.default_rng(6), 200), np.random.default_rng(7), SIGMA_PX)
        solved = solve_sightings(rig, [s for s, _ in others])
        away, _ = errors_of(others, rig, solved)
        return np.sqrt((away**2).mean(axis=0))

    floor, left = world_errors(placed), world_errors(found.rig)
    assert left[2] < 1.2 * floor[2]
    assert (left[:2] < floor[:2] + 0.1e-3).all()
    assert (world_errors(given) > 5 * left).all()


def test_corrections_end_where_the_survey_ends(true: Rig, rng: np.random.Generator) -> None:
    given = off_rig(true, rng)
    correction = fit_plane("quadric", *z_errors(survey_pairs(true, given, poses(rng, SURVEY), rng, SIGMA_PX)))
    inside, outside = np.array([[0.0, 0.0, 1.4]]), np.array([[1.5, 1.5, 1.0], [0.0, 0.0, 0.15], [-2.0, 0.0, 1.4]])
    here, there = correction.at(inside), correction.at(outside)
    assert not here.extrapolated.any()
    assert here.dz[0] == pytest.approx(1.4 * 0.003, rel=0.3)
    assert there.extrapolated.all()
    assert (there.dz == 0.0).all()
    assert (there.variances > here.variances).all()
    # The way out is steady, and nowhere beyond the cap.
    along = np.column_stack([np.linspace(0.0, 2.0, 2000), np.zeros(2000), np.full(2000, 1.4)])
    path = correction.at(along)
    assert np.abs(np.diff(path.dz)).max() < 1e-4
    assert (np.abs(path.dz) <= 1.4 * correction.most + 1e-12).all()
    assert (np.diff(path.extrapolated.astype(int)) >= 0).all()


def test_poses_are_corrected_along_the_cameras_z_and_flagged(true: Rig, rng: np.random.Generator) -> None:
    correction = ZCorrection(
        "plane", np.array([0.0, 0.0, 0.9]), np.array([0.2, 0.2, 0.2]), np.array([0.002, 0.0, 0.0, 0.0]),
        1e-5 * np.eye(4), 2e-5, 0.003, 1e-4,
    )  # fmt: skip
    world = Pose.from_matrix(exp_rotation(np.array([2.5, 0.3, 0.2])), np.array([0.1, 0.2, 1.3]))
    for placed in (None, world):
        plain = replace(true, T_world_camera=placed)
        rig = replace(plain, z_correction=correction)
        along = np.array([0.0, 0.0, 1.0]) if placed is None else placed.rotation[:, 2]
        for place, inside in ((np.array([0.05, 0.0, 1.1]), True), (np.array([0.3, 0.28, 0.9]), False)):
            pose = facing_pose(rng, (1.0, 1.0), (20.0, 30.0))
            frame = Frame(draw(plain, {"alpha": Pose(place, pose.orientation)}).expose(rng), 1, 0)
            before = localize(frame, plain, Tracks.none())[0].answers["alpha"]
            result, _ = localize(frame, rig, Tracks.none())
            after = result.answers["alpha"]
            assert isinstance(before, PoseEstimate)
            assert isinstance(after, PoseEstimate)
            T_camera_parent = (placed or Pose.identity()).inverse()
            told = correction.at(T_camera_parent.map(before.position[None]))
            np.testing.assert_allclose(after.position - before.position, told.dz[0] * along, atol=1e-12)
            grown = after.covariance[:3, :3] - before.covariance[:3, :3]
            np.testing.assert_allclose(grown, told.variances[0] * np.outer(along, along), atol=1e-15)
            assert after.extrapolated is not inside
            assert ("extrapolated" in line(frame, result)["robots"][0]) is not inside
            messages = list(report(frame, result, rig, 1))
            odometry = next(m for m in messages if m.kind is ODOMETRY)
            assert decode_odometry(odometry.payload).extrapolated is not inside


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A surveyed film, and a rig that is off."""
    folder = tmp_path_factory.mktemp("z")
    rng = np.random.default_rng(21)
    true = write_rig(folder / "true", 2, layout=rim_layout(2))
    surveyed = [facing_pose(rng) for _ in range(36)]
    write_off_rig(folder, true, off_rig(true, rng))
    write_frames(folder / "frames", true, surveyed, rng)
    write_survey(folder / "truth.jsonl", "alpha", surveyed)
    return folder


def arguments(film: Path, *more: object, truth: str = "truth.jsonl") -> list[str]:
    return [str(a) for a in ("calibrate", "z", film / "rig.yaml", film / "frames", "--truth", film / truth, *more)]


def test_the_command_writes_a_rig_that_needs_no_option(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    out, others = tmp_path / "new.yaml", poses(rng, 200)
    true, given = load_rig(film / "true" / "rig.yaml"), load_rig(film / "rig.yaml")
    assert main(arguments(film, "-o", out)) == 0
    told = capsys.readouterr().out
    assert re.search(r"refit: f 1395.80 -> (1399\.9|1400\.0)\d \+- 0\.0\d", told), told
    assert "left as they were: k3" in told
    assert "z_correction: not needed" in told
    floor = z_rms(true, true, others)
    assert z_rms(true, load_rig(out), others) < 1.1 * floor
    # Comments are kept, in both files; the camera lies beside.
    assert "camera: new-camera.yaml   # beside this" in out.read_text()
    assert "alpha:   # the first one" in out.read_text()
    assert (tmp_path / "new-camera.yaml").read_text().startswith("# the 12 mm lens\n")
    # How sure the refit is: of the lens beside its file, of the LEDs beside the rig.
    new, camera = load_rig(out), tmp_path / "new-camera.yaml"
    lens = read_lens_error(camera, new.camera)
    assert lens is not None
    off = values_of(new.camera) - values_of(true.camera)
    sigmas = np.sqrt(np.diag(lens.covariance))
    assert (np.abs(off[:4]) < 4.5 * sigmas[:4]).all()
    beside = read_uncertainty(out, "edge-model", camera)
    assert beside.leds_of("alpha").by == beside.origin("focal_relative") == "measured: calibrate z"
    assert beside.focal_relative == pytest.approx(0.5 * (sigmas[0] + sigmas[1]) / 1400.0, rel=1e-3)
    assert beside.leds_of("alpha").position_m < 0.1e-3
    assert "exists; choose another name" in refused(capsys, *arguments(film, "-o", out))
    out.unlink()
    assert "new-camera.yaml: exists" in refused(capsys, *arguments(film, "-o", out))

    assert main(arguments(film, "-o", out, "--no-refit", "--force")) == 0
    told = capsys.readouterr().out
    assert "z_correction: quadric" in told or "z_correction: plane" in told
    assert "refit" not in told
    assert f"{out.stem}.uncertainty.yaml was of an older new.yaml: kept as" in told
    assert not (tmp_path / "new.uncertainty.yaml").exists()
    corrected = load_rig(out)
    assert corrected.camera_text == given.camera_text
    assert z_rms(true, corrected, others) < z_rms(true, given, others) / 4

    # From a rig that has a z_correction, the new one takes its place.
    assert main(["calibrate", "z", str(out), *arguments(film, "-o", out, "--no-refit", "--force")[3:]]) == 0
    again = load_rig(out)
    assert again.z_correction is not None
    assert corrected.z_correction is not None
    np.testing.assert_allclose(again.z_correction.coefficients, corrected.z_correction.coefficients)
    assert out.read_text().count("z_correction") == 1
    assert (tmp_path / "new.yaml.old-1").exists()


def test_surveys_that_do_not_suffice_are_refused(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new.yaml"
    values = [json.loads(text) for text in (film / "truth.jsonl").read_text().splitlines()]

    def told(lines: list[dict[str, object]], *more: str) -> str:
        (film / "bad.jsonl").write_text("\n".join(json.dumps(value) for value in lines))
        return refused(capsys, *arguments(film, "-o", out, *more, truth="bad.jsonl"))

    assert "10 of its poses belong to robots that were located in their frames, expected at least 20" in told(
        values[:10]
    )
    assert "names none of the frames" in told([{**value, "frame": f"x{value['frame']}"} for value in values[:25]])
    assert "is that mm?" in told([moved(value, 1e3) for value in values])
    assert "leave nothing to do" in told(values, "--no-refit", "--no-plane")
    assert not out.exists()


def moved(value: dict[str, object], scale: float) -> dict[str, object]:
    robot = value["robots"][0]  # type: ignore[index]
    return {**value, "robots": [{**robot, "position": [scale * x for x in robot["position"]]}]}


def test_places_on_one_line_are_refused(true: Rig, rng: np.random.Generator) -> None:
    from asterism.server.calibration.survey.surveyed import check_spread

    def pairs(across: float) -> Pairs:
        chosen = []
        for step in np.linspace(0.0, 1.0, 20):
            place = np.array([0.1 * step, across * rng.standard_normal(), 0.9 + step])
            chosen.append(Pose(place, facing_pose(rng).orientation))
        return survey_pairs(true, true, chosen, rng, SIGMA_PX)

    check_spread(pairs(0.1), "truth.jsonl")
    with pytest.raises(InputError, match="lie on one line"):
        check_spread(pairs(0.005), "truth.jsonl")


def test_z_corrections_are_read_strictly(true: Rig, rng: np.random.Generator) -> None:
    given = off_rig(true, rng)
    correction = fit_plane("plane", *z_errors(survey_pairs(true, given, poses(rng, SURVEY), rng, SIGMA_PX)))
    text = with_correction(true.rig_text, correction, SURVEY)
    read = parse_rig(text, true.camera_text, "rig").z_correction
    assert read is not None
    places = np.array([pose.position for pose in poses(rng, 50)])
    np.testing.assert_allclose(read.at(places).dz, correction.at(places).dz, atol=1e-7)
    for old, new, words in (
        ("kind: plane", "kind: cubic", "expected one of plane, quadric"),
        ("kind: plane", "kind: quadric", "coefficients: 4 values, expected 7 numbers"),
        ("  most:", "  least:", "unknown key 'least'"),
        ("  region:", "  region: -1 #", "expected a number above 0"),
    ):
        with pytest.raises(InputError) as caught:
            parse_rig(text.replace(old, new), true.camera_text, "rig")
        assert words in str(caught.value)
