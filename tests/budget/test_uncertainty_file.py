"""Which file says what is not known exactly of a rig, and how calibrations change it."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.server.budget.uncertainty import LedError, lens_error_of, read_uncertainty
from asterism.server.budget.uncertainty_file import check_uncertainty_file, write_uncertainty_file
from asterism.server.calibration.lens.camera_file import camera_text, refit_report_text
from asterism.server.calibration.lens.lens_error import LensError, assumed_lens_error, read_lens_error, shares_of
from tests.rigs import make_camera

ALPHA = {"alpha": LedError(3.21456e-6, 0.00116, "calibrate leds")}
PERSON = "# mine\nled_position_m: 0.0003   # by ruler\nfocal_relative: 0.001   # old lens\nbias_px: 0.002\n"


def test_the_rigs_own_file_is_read_in_place_of_the_folders(tmp_path: Path) -> None:
    rig = tmp_path / "rig2.yaml"
    assert read_uncertainty(rig, "edge-model").file is None
    (tmp_path / "uncertainty.yaml").write_text("bias_px: 0.1\n")
    assert read_uncertainty(rig, "edge-model").bias_px == 0.1
    (tmp_path / "rig2.uncertainty.yaml").write_text("led_position_m: 0.001\n")
    told = read_uncertainty(rig, "edge-model")
    assert (told.bias_px, told.led_position_m, told.given) == (0.001, 0.001, {"led_position_m"})
    assert read_uncertainty(tmp_path / "rig3.yaml", "edge-model").bias_px == 0.1


def test_a_calibration_keeps_what_a_person_wrote_and_never_changes_the_folders_file(tmp_path: Path) -> None:
    (tmp_path / "uncertainty.yaml").write_text(PERSON)
    rig, out = tmp_path / "rig.yaml", tmp_path / "rig2.yaml"
    told = write_uncertainty_file(rig, out, ALPHA, force=False)
    assert told == [f"written: {tmp_path / 'rig2.uncertainty.yaml'}, what is not known exactly, for asterism report"]
    text = (tmp_path / "rig2.uncertainty.yaml").read_text()
    assert text.startswith("# Uncertainties of rig2.yaml, ")
    assert PERSON in text
    assert "  alpha: {led_position_m: 0.00000321, size_relative: 0.00116, by: calibrate leds}\n" in text
    assert (tmp_path / "uncertainty.yaml").read_text() == PERSON
    known = read_uncertainty(out, "edge-model")
    assert known.leds_of("alpha").position_m == 3.21e-6
    assert (known.leds_of("bravo").position_m, known.leds_of("bravo").by) == (0.0003, "given")


def test_a_chain_of_calibrations_carries_it_along(tmp_path: Path) -> None:
    """leds of alpha, leds of bravo, world, z: rig.yaml to rig4.yaml in one folder, as in README."""
    rigs = [tmp_path / f"rig{k}.yaml" for k in ("", 2, 3, 4, 5)]
    bravo = {"bravo": LedError(5e-6, 0.0, "calibrate leds")}
    write_uncertainty_file(rigs[0], rigs[1], ALPHA, force=False)
    write_uncertainty_file(rigs[1], rigs[2], bravo, force=False)
    write_uncertainty_file(rigs[2], rigs[3], {}, force=False)
    carried = (tmp_path / "rig4.uncertainty.yaml").read_text()
    assert carried.count("# Uncertainties of ") == carried.count("# Uncertainties of rig4.yaml") == 1
    assert list(read_uncertainty(rigs[3], "edge-model").robots) == ["alpha", "bravo"]
    again = {"alpha": LedError(2e-5, 0.0, "calibrate z")}
    write_uncertainty_file(rigs[3], rigs[4], again, force=False, new_lens=True)
    last = read_uncertainty(rigs[4], "edge-model")
    assert last.leds_of("alpha") == LedError(2e-5, 0.0, "measured: calibrate z")
    assert last.leds_of("bravo").position_m == 5e-6


def test_a_refitted_lens_takes_the_place_of_what_a_person_said_of_the_old_one(tmp_path: Path) -> None:
    (tmp_path / "uncertainty.yaml").write_text(PERSON)
    told = write_uncertainty_file(tmp_path / "rig.yaml", tmp_path / "rig4.yaml", {}, force=False, new_lens=True)
    assert "focal_relative of" in told[1]
    assert "are left out there: the refitted lens has its own report" in told[1]
    camera, covariance = make_camera(), np.diag([1.0, 1.0, 0.04, 0.04, *[1e-8] * 5])
    path = tmp_path / "rig4-camera.yaml"
    path.write_text(camera_text(camera))
    path.with_name("rig4-camera.report.yaml").write_text(refit_report_text(camera, covariance, "here", 60))
    known = read_uncertainty(tmp_path / "rig4.yaml", "edge-model", path)
    assert known.origin("focal_relative") == known.origin("distortion_relative") == "measured: calibrate z"
    assert (known.origin("led_position_m"), known.origin("bias_px"), known.origin("offset_m")) == (
        *("given", "given"),
        "assumed",
    )
    assert known.principal_point_px == pytest.approx(0.2)


def test_an_older_rigs_file_is_no_newer_rigs(tmp_path: Path) -> None:
    """A rig replaced by one of which nothing was measured: the old numbers do not stay beside it."""
    out = tmp_path / "rig2.yaml"
    write_uncertainty_file(tmp_path / "rig.yaml", out, ALPHA, force=False)
    with pytest.raises(InputError, match=r"rig2\.uncertainty\.yaml: exists; choose another name, or --force"):
        check_uncertainty_file(out, force=False)
    told = write_uncertainty_file(tmp_path / "rig.yaml", out, {}, force=True)
    assert "was of an older rig2.yaml: kept as" in told[0]
    assert read_uncertainty(out, "edge-model").robots == {}


def test_a_file_in_braces_is_refused(tmp_path: Path) -> None:
    (tmp_path / "uncertainty.yaml").write_text("{bias_px: 0.1}\n")
    with pytest.raises(InputError, match=r"uncertainty\.yaml: is written in braces, expected one key a line"):
        write_uncertainty_file(tmp_path / "rig.yaml", tmp_path / "rig2.yaml", ALPHA, force=False)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robots: {alpha: {led_position: 1}}\n", "robots.alpha: unknown key 'led_position'"),
        ("robots: {alpha: {led_position_m: 1e-6}}\n", "robots.alpha.by: is missing, expected text"),
        ("robots: {alpha: 1}\n", "robots.alpha: 1, expected a mapping"),
    ],
)
def test_wrong_numbers_of_a_robot_are_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "uncertainty.yaml").write_text(text)
    with pytest.raises(InputError, match=words):
        read_uncertainty(tmp_path / "rig.yaml", "edge-model")


def test_lens_errors_are_given_measured_or_assumed(tmp_path: Path) -> None:
    camera, path, rig = make_camera(), tmp_path / "camera.yaml", tmp_path / "rig.yaml"
    path.write_text(camera_text(camera))

    def told() -> LensError:
        return lens_error_of(camera, path, read_uncertainty(rig, "edge-model", path))

    assert told().told_by == "assumed"
    np.testing.assert_allclose(np.sqrt(np.diag(told().covariance))[:4], [0.7, 0.7007, 0.5, 0.5])
    mixed = 1e-3 * np.random.default_rng(0).standard_normal((9, 9))
    covariance = mixed @ mixed.T
    path.with_name("camera.report.yaml").write_text(refit_report_text(camera, covariance, "here", 60))
    assert told().told_by == "calibrate z"
    np.testing.assert_allclose(told().covariance, covariance, rtol=1e-5, atol=1e-12)
    (tmp_path / "uncertainty.yaml").write_text("focal_relative: 0.01\n")
    assert told().told_by == str(tmp_path / "uncertainty.yaml")
    assert told().covariance[0, 0] == pytest.approx(14.0**2)


def test_the_three_shares_of_a_lens_error_are_those_it_was_made_of() -> None:
    camera = make_camera()
    shares = shares_of(assumed_lens_error(camera, 4e-4, 0.3, 0.02, "a test"), camera)
    assert shares == pytest.approx(
        {"focal_relative": 4e-4, "principal_point_px": 0.3, "distortion_relative": 0.02}, rel=1e-3
    )


def test_a_report_of_another_lens_is_refused(tmp_path: Path) -> None:
    camera, path = make_camera(), tmp_path / "camera.yaml"
    report = tmp_path / "camera.report.yaml"
    report.write_text(refit_report_text(make_camera(focal_px=1401.0), np.eye(9), "here", 60))
    with pytest.raises(InputError, match=r"values.fx: 1401, expected 1400 as .* it is the report of another calibr"):
        read_lens_error(path, camera)
    report.write_text("model: equidistant\nsigmas: {fx: 1}\n")
    with pytest.raises(InputError, match="model: equidistant, expected plumb_bob"):
        read_lens_error(path, camera)
