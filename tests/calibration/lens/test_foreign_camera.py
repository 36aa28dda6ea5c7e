"""Calibrations of other programs, in files that these wrote: read as they are meant, or refused with what to do."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from asterism.protocol.camera import Camera, load_camera
from asterism.protocol.errors import InputError
from asterism.server.__main__ import main
from asterism.server.calibration.lens.camera_file import camera_text
from asterism.server.calibration.lens.foreign_camera import read_foreign_camera
from tests.protocol.mutations import mutated_yaml
from tests.sources.foreign.foreign_files import camera_info, ros_text, write_bag2, write_mcap

K = [1400.0, 0.0, 645.3, 0.0, 1401.8, 508.7, 0.0, 0.0, 1.0]
D = [-0.11, 0.035, 0.0004, -0.0003, 0.01]
MATRIX = np.array(K).reshape(3, 3)
SIZE = (1280, 1024)


def read(path: Path | str, topic: str | None = None, model: str | None = None) -> Camera:
    return read_foreign_camera(str(path), topic, model, "mine").camera


def check(camera: Camera, model: str = "plumb_bob", distortion: list[float] = D, name: str = "mine") -> None:
    assert (camera.name, camera.width, camera.height, camera.model) == (name, *SIZE, model)
    np.testing.assert_array_equal(camera.matrix, MATRIX)
    np.testing.assert_array_equal(camera.distortion, distortion)


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def storage(path: Path, **values: Any) -> Path:
    """As OpenCV's calibration samples write it."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        file.write(key, value)
    file.release()
    return path


SAMPLE = {
    "calibration_time": "Thu Nov 26 2026",
    "image_width": SIZE[0],
    "image_height": SIZE[1],
    "flags": 0,
    "camera_matrix": MATRIX,
}
DUMP = f"""\
header:
  stamp: {{sec: 1, nanosec: 5}}
  frame_id: camera_optical_frame
height: 1024
width: 1280
distortion_model: plumb_bob
d:
{"".join(f"- {value}{chr(10)}" for value in D)}k:
{"".join(f"- {value}{chr(10)}" for value in K)}r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
binning_x: 0
binning_y: 0
roi: {{x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}}
---
"""
KALIBR = """\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.02, 0.01, -0.003, 0.001]
  distortion_model: equidistant
  intrinsics: [1400.0, 1401.8, 645.3, 508.7]
  resolution: [1280, 1024]
  rostopic: /cam0/image_raw
cam1:
  camera_model: pinhole
  distortion_coeffs: [-0.11, 0.035, 0.0004, -0.0003]
  distortion_model: radtan
  intrinsics: [1400.0, 1401.8, 645.3, 508.7]
  resolution: [1280, 1024]
"""
CAMERA_INFO = camera_text(Camera("cam", *SIZE, MATRIX, "plumb_bob", np.array(D)))


@pytest.mark.parametrize("suffix", ["yml", "xml"])
def test_opencvs_file_storage(tmp_path: Path, suffix: str) -> None:
    path = storage(tmp_path / f"a.{suffix}", **SAMPLE, distortion_coefficients=np.array([D]).T)
    check(read(path))
    fisheye = [-0.02, 0.01, -0.003, 0.001]
    fish = storage(tmp_path / f"b.{suffix}", **SAMPLE, fisheye_model=1, distortion_coefficients=np.array([fisheye]).T)
    check(read(fish), "equidistant", fisheye)
    eight = [*D, 0.42, -0.02, 0.01]
    many = storage(tmp_path / f"c.{suffix}", **SAMPLE, distortion_coefficients=np.array([*eight, 0, 0, 0, 0, 0, 0]))
    check(read(many), "rational_polynomial", eight)
    old = storage(tmp_path / f"d.{suffix}", Camera_Matrix=MATRIX, Distortion_Coefficients=np.array(D), image_Width=1280)
    with pytest.raises(
        InputError, match="image_height is missing; it has Camera_Matrix, Distortion_Coefficients, image_W"
    ):
        read(old)


def test_ros_files_dumps_and_scripts(tmp_path: Path) -> None:
    check(read(written(tmp_path / "ost.yaml", CAMERA_INFO)), name="cam")
    check(read(written(tmp_path / "serial.yaml", CAMERA_INFO.replace("cam\n", "00421337\n"))), name="00421337")
    check(read(written(tmp_path / "slash.yaml", CAMERA_INFO.replace("cam\n", "narrow/left\n"))))
    check(read(written(tmp_path / "dump.yaml", DUMP)))
    check(read(written(tmp_path / "two.yaml", DUMP + DUMP)))
    ros1 = DUMP.replace("d:\n", "D:\n").replace("k:\n", "K:\n")
    check(read(written(tmp_path / "ros1.yaml", ros1)))
    script = f"camera_matrix: {MATRIX.tolist()}\ndist_coeff: {[D]}\nimage_size: [1280, 1024]\n"
    check(read(written(tmp_path / "script.yaml", script)))


def test_kalibrs_camchains(tmp_path: Path) -> None:
    chain = written(tmp_path / "camchain.yaml", KALIBR)
    check(read(f"{chain}#cam0"), "equidistant", [-0.02, 0.01, -0.003, 0.001])
    check(read(f"{chain}#cam1"), "plumb_bob", [-0.11, 0.035, 0.0004, -0.0003, 0.0])
    with pytest.raises(InputError, match=r"holds 2 cameras; say which: .*camchain\.yaml#cam0, .*camchain\.yaml#cam1"):
        read(chain)
    with pytest.raises(InputError, match=r"camchain\.yaml#cam7: there is no such camera, expected .*#cam0"):
        read(f"{chain}#cam7")
    omni = written(tmp_path / "omni.yaml", KALIBR.partition("cam1")[0].replace("pinhole", "omni"))
    with pytest.raises(InputError, match="camera_model: 'omni', expected pinhole"):
        read(omni)
    fov = written(tmp_path / "fov.yaml", KALIBR.partition("cam1")[0].replace("equidistant", "fov"))
    with pytest.raises(InputError, match=r"the model 'fov', expected one of plumb_bob \(radtan\), rational"):
        read(fov)


def test_messages_in_bags_and_mcap_files(tmp_path: Path) -> None:
    info = camera_info(K, D, SIZE)
    check(read(write_mcap(tmp_path / "a.mcap", [("/chatter", 1, ros_text("a")), ("/camera_info", 2, info)])))
    check(read(write_bag2(tmp_path / "bag", [("/camera_info", 2, info)])))
    two = write_mcap(tmp_path / "two.mcap", [("/l/camera_info", 1, info), ("/r/camera_info", 1, info)])
    check(read(two, "/r/camera_info"))
    with pytest.raises(
        InputError, match="several topics with a camera's calibration; choose by --topic: /l/camera_info"
    ):
        read(two)
    none = write_mcap(tmp_path / "none.mcap", [("/chatter", 1, ros_text("a"))])
    with pytest.raises(
        InputError, match=r"no topic with a camera's calibration .*; it has /chatter \(std_msgs/String\)"
    ):
        read(none)
    told = CameraCalibration(width=1280, height=1024, distortion_model="plumb_bob", K=K, D=D)
    check(read(write_mcap(tmp_path / "f.mcap", [("/c", 1, told)])))


def test_binning_and_regions_scale_the_calibration(tmp_path: Path) -> None:
    """A point that the whole sensor sees at a pixel is seen by the part where that pixel lies in it."""
    info = camera_info(K, D, SIZE, binning=(2, 2), region=(200, 100, 800, 600))
    found = read_foreign_camera(str(write_mcap(tmp_path / "a.mcap", [("/i", 1, info)])), None, None, "mine")
    part, whole = found.camera, Camera("mine", *SIZE, MATRIX, "plumb_bob", np.array(D))
    assert (part.width, part.height) == (400, 300)
    assert "400x300 px: 800x600 from (200, 100) on, binned 2x2; the calibration was scaled" in found.told[-1]
    points = np.array([[0.02, -0.1, 1.2], [-0.2, 0.1, 1.4]])
    # The outer edges of pixels are the same places.
    np.testing.assert_allclose((part.project(points) + 0.5) * 2 + [200, 100], whole.project(points) + 0.5, atol=1e-9)
    outside = camera_info(K, D, SIZE, region=(1000, 0, 800, 600))
    with pytest.raises(InputError, match=r"800x600 px from \(1000, 0\) on lead beyond the 1280x1024 px"):
        read(write_mcap(tmp_path / "b.mcap", [("/i", 1, outside)]))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("- 0.0\n- 645.3", "- 0.7\n- 645.3", "a skew of 0.7 px, the sensor's rows and columns 0.0286 degrees off"),
        ("- 1400.0", "- 0.0", "drivers tell zeros for a camera that was never calibrated"),
        ("- 1400.0", "- .inf", "camera_matrix: .*expected numbers"),
        ("- 0.01\n", "- 0.01\n- 0.3\n", "6 coefficients for plumb_bob, expected 5"),
        ("- 0.01\n", "- a\n", "distortion_coefficients: a list of 5 values, expected numbers"),
        ("distortion_model: plumb_bob", "distortion_model: ds", "the model 'ds', expected one of"),
        ("distortion_model", "camera_model", r"camera_model: plumb_bob: did you mean distortion_model\?"),
        ("width: 1280", "width: 12.5", "image_width: 12.5, expected a whole number"),
        ("width: 1280\n", "", "image_width is missing; it has header, height"),
        ("k:\n", "kk:\n", "camera_matrix is missing"),
        ("binning_x: 0", "binning_x: 99", "binning by 99, expected 1 to 16"),
        ("roi: {", "roi: 7 #{", "roi: 7, expected x_offset"),
    ],
)
def test_what_cannot_be_taken_is_explained(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in DUMP
    with pytest.raises(InputError, match=words):
        read(written(tmp_path / "dump.yaml", DUMP.replace(old, new, 1)))


def test_four_coefficients_without_a_model_are_not_guessed(tmp_path: Path) -> None:
    path = storage(tmp_path / "a.yml", **SAMPLE, distortion_coefficients=np.array([-0.1, 0.02, 0.001, 0.002]))
    with pytest.raises(InputError, match=r"say --model plumb_bob \(k1 k2 p1 p2\), or --model equidistant"):
        read(path)
    check(read(path, None, "plumb_bob"), "plumb_bob", [-0.1, 0.02, 0.001, 0.002, 0.0])
    check(read(path, None, "equidistant"), "equidistant", [-0.1, 0.02, 0.001, 0.002])
    with pytest.raises(InputError, match="its model is plumb_bob, but --model is equidistant"):
        read(written(tmp_path / "dump.yaml", DUMP), None, "equidistant")


@pytest.mark.parametrize("kind", ["dump", "kalibr", "storage", "xml"])
def test_whatever_a_file_holds_it_is_taken_or_refused(tmp_path: Path, kind: str, rng: np.random.Generator) -> None:
    suffix = "xml" if kind == "xml" else "yml"
    sample = storage(tmp_path / f"s.{suffix}", **SAMPLE, distortion_coefficients=np.array(D)).read_text()
    text, path = {"dump": DUMP, "kalibr": KALIBR}.get(kind, sample), tmp_path / "mutated"
    for _ in range(100):
        path.write_text(mutated_yaml(text, rng))
        try:
            camera = read(f"{path}#cam1" if kind == "kalibr" else path)
        except InputError:
            continue
        assert camera.matrix.shape == (3, 3)


def test_the_command_writes_a_camera_file_that_a_rig_can_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, dump = tmp_path / "cell.yaml", written(tmp_path / "dump.yaml", DUMP)
    (tmp_path / "cell.report.yaml").write_text("made_by: calibrate camera\n")
    assert main(["calibrate", "camera", "--from", str(dump), "-o", str(out)]) == 0
    told = capsys.readouterr().out
    assert "a dump of CameraInfo: 1280x1024, plumb_bob with 5 coefficients" in told
    check(load_camera(out), name="cell")
    # What was known of an older calibration is not known of this one.
    assert "cell.report.yaml was of an older cell.yaml: kept as" in told
    assert not (tmp_path / "cell.report.yaml").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["frames/", "--from", "dump.yaml"], "--from takes a calibration as it is; expected no SOURCE (frames/)"),
        (["--from", "nowhere.yaml"], "nowhere.yaml: no such file"),
        (["--from", "dump.yaml", "--topic", "/a"], "--topic /a: dump.yaml has no topics"),
        (["frames/"], "expected SOURCE and --target: images of a board"),
        (["a.png", "--target", "chessboard:9x6:0.025", "--listen", "tcp/127.0.0.1:1"], "images from the network"),
    ],
)
def test_what_the_command_cannot_take_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], sentence: str, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "dump.yaml", DUMP)
    cv2.imwrite("a.png", np.zeros((40, 50), np.uint8))
    assert main(["calibrate", "camera", *words, "-o", "c.yaml"]) == 2
    assert sentence in capsys.readouterr().err
