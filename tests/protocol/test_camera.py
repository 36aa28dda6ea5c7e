"""The camera file and the lens models, against OpenCV."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.protocol.camera import Camera, check_image_size, load_camera, parse_camera
from asterism.protocol.errors import InputError
from asterism.server.pose.lens import distort_with_jacobian, lens_of, project_point, undistort
from tests.helpers import numeric_jacobian

MATRIX = np.array([[1400.0, 0.0, 645.3], [0.0, 1401.8, 508.7], [0.0, 0.0, 1.0]])
MODELS = {
    "plumb_bob": [-0.11, 0.035, 0.0004, -0.0003, 0.01],
    "rational_polynomial": [0.3, -0.05, 0.0004, -0.0003, 0.02, 0.42, -0.02, 0.01],
    "equidistant": [-0.02, 0.01, -0.003, 0.001],
}
TEXT = """\
image_width: 1280
image_height: 1024
camera_name: cam
camera_matrix:
  rows: 3
  cols: 3
  data: [1400.0, 0.0, 645.3, 0.0, 1401.8, 508.7, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.11, 0.035, 0.0004, -0.0003, 0.0]
"""


def camera_with(model: str) -> Camera:
    return Camera("cam", 1280, 1024, MATRIX, model, np.array(MODELS[model]))


def opencv_project(camera: Camera, points: np.ndarray) -> np.ndarray:
    zero = np.zeros((3, 1))
    if camera.model == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, camera.matrix, camera.distortion)
    else:
        pixels, _ = cv2.projectPoints(points, zero, zero, camera.matrix, camera.distortion)
    return pixels.reshape(-1, 2)


def points_in_view(rng: np.random.Generator) -> np.ndarray:
    z = rng.uniform(0.5, 2.0, 200)
    return np.column_stack([z * rng.uniform(-0.45, 0.45, 200), z * rng.uniform(-0.35, 0.35, 200), z])


@pytest.mark.parametrize("model", MODELS)
def test_projection_equals_opencv(rng: np.random.Generator, model: str) -> None:
    camera, points = camera_with(model), points_in_view(rng)
    np.testing.assert_allclose(camera.project(points), opencv_project(camera, points), atol=1e-8)


@pytest.mark.parametrize("model", MODELS)
def test_compiled_projection_and_its_inverse(rng: np.random.Generator, model: str) -> None:
    camera, points = camera_with(model), points_in_view(rng)
    lens = lens_of(camera)
    pixels = camera.project(points)
    np.testing.assert_allclose([project_point(lens, *point) for point in points], pixels, atol=1e-9)
    rays, covariances = np.empty((200, 2)), np.empty((200, 3))
    undistort(lens, pixels, np.tile([0.01, 0.0, 0.01], (200, 1)), rays, covariances)
    np.testing.assert_allclose(rays, points[:, :2] / points[:, 2:], atol=1e-10)


@pytest.mark.parametrize("model", MODELS)
def test_jacobian_and_carried_covariance(rng: np.random.Generator, model: str) -> None:
    camera = camera_with(model)
    lens = lens_of(camera)
    for _ in range(20):
        at = rng.uniform(-0.4, 0.4, 2)
        xd, yd, *derivatives = distort_with_jacobian(lens, *at)
        numeric = numeric_jacobian(lambda p: np.array(distort_with_jacobian(lens, *p)[:2]), at)
        np.testing.assert_allclose(np.reshape(derivatives, (2, 2)), numeric, atol=1e-7)
        # A pixel covariance, carried to rays, is J C J' with J the derivative of the inverse.
        pixel = np.array([[MATRIX[0, 0] * xd + MATRIX[0, 2], MATRIX[1, 1] * yd + MATRIX[1, 2]]])
        spread = np.array([[0.02, 0.004], [0.004, 0.01]])
        rays, covariances = np.empty((1, 2)), np.empty((1, 3))
        undistort(lens, pixel, np.array([[0.02, 0.004, 0.01]]), rays, covariances)
        inverse = np.linalg.inv(np.diag([MATRIX[0, 0], MATRIX[1, 1]]) @ numeric)
        expected = inverse @ spread @ inverse.T
        np.testing.assert_allclose(covariances[0], expected[[0, 0, 1], [0, 1, 1]], rtol=1e-5, atol=1e-14)


def test_a_pixel_that_no_ray_reaches_is_nan() -> None:
    strong = Camera("cam", 1280, 1024, MATRIX, "plumb_bob", np.array([-2.0, 0.0, 0.0, 0.0, 0.0]))
    rays, covariances = np.empty((1, 2)), np.empty((1, 3))
    undistort(lens_of(strong), np.array([[2600.0, 2000.0]]), np.zeros((1, 3)), rays, covariances)
    assert np.isnan(rays).all()


def test_the_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "camera.yaml").write_text(TEXT)
    camera = load_camera(tmp_path / "camera.yaml")
    assert (camera.name, camera.width, camera.height, camera.model) == ("cam", 1280, 1024, "plumb_bob")
    np.testing.assert_array_equal(camera.matrix, MATRIX)
    assert camera.focal_px == pytest.approx(1400.9)


def test_four_coefficients_of_plumb_bob_mean_k3_is_zero() -> None:
    camera = parse_camera(TEXT.replace("cols: 5", "cols: 4").replace(", 0.0]\n", "]\n"), "camera.yaml")
    assert camera.distortion.tolist() == [-0.11, 0.035, 0.0004, -0.0003, 0.0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("camera_name: cam\n", "", "camera_name: is missing"),
        ("image_width: 1280", "image_width: 12.5", "image_width: 12.5, expected a whole number"),
        ("plumb_bob", "fisheye", "distortion_model: 'fisheye', expected one of plumb_bob, rational_polynomial"),
        ("[1400.0,", "[-1400.0,", "camera_matrix: fx = -1400"),
        ("[1400.0, 0.0,", "[1400.0, 0.5,", "camera_matrix: a skew of 0.5 px, which no lens model here has"),
        ("0.0, 1401.8", "0.1, 1401.8", "camera_matrix: expected the form"),
        ("distortion_model", "camera_model", "unknown key 'camera_model'; did you mean 'distortion_model'?"),
        ("camera_name: cam", "camera_name: 0x1f", "camera_name: 31, expected text"),
        ("camera_matrix:", "K: [1, 2]\ncamera_matrix:", "Then asterism calibrate camera --from camera.yaml -o"),
        ("cols: 5", "cols: 6", "distortion_coefficients: 6 coefficients, expected 4 or 5 for plumb_bob"),
        ("-0.0003, 0.0]", "-0.0003]", "distortion_coefficients.data: 4 values, expected 5 numbers"),
        ("-0.0003, 0.0]", "-0.0003, .nan]", "distortion_coefficients.data: nan is among the values"),
        ("camera_name: cam", "camera_name: a/b", "camera_name: 'a/b' holds '/'"),
        ("image_height:", "image_heigth:", "unknown key 'image_heigth'; did you mean 'image_height'?"),
        ("camera_name: cam", "camera_name: cam\ncamera_name: cam", "line 4: key 'camera_name' is given twice"),
        ("data: [1400.0, 0.0, 645.3,", "data: [1400.0, 0.0,", "camera_matrix.data: 8 values, expected 9 numbers"),
        ("508.7, 0.0, 0.0, 1.0]", "508.7, 0.0, 0.0, 1.0", "line 8: is no YAML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence(old: str, new: str, words: str) -> None:
    assert old in TEXT
    with pytest.raises(InputError, match="yaml") as caught:
        parse_camera(TEXT.replace(old, new), "camera.yaml")
    text = str(caught.value)
    assert text.startswith("camera.yaml")
    assert "\n" not in text
    assert words in text


def test_a_missing_or_truncated_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"camera\.yaml: no such file"):
        load_camera(tmp_path / "camera.yaml")
    (tmp_path / "camera.yaml").write_text(TEXT[:120])
    with pytest.raises(InputError, match=r"camera\.yaml: .*(is missing|is no YAML)"):
        load_camera(tmp_path / "camera.yaml")
    (tmp_path / "empty.yaml").write_text("")
    with pytest.raises(InputError, match=r"empty\.yaml: is empty, expected a YAML mapping"):
        load_camera(tmp_path / "empty.yaml")
    (tmp_path / "noise.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"noise\.yaml: is no text in UTF-8"):
        load_camera(tmp_path / "noise.yaml")


def test_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(InputError, match=r"frames/1\.png: the image is 640x480, expected 1280x1024"):
        check_image_size(camera_with("plumb_bob"), 640, 480, "frames/1.png")
    check_image_size(camera_with("plumb_bob"), 1280, 1024, "frames/1.png")


@pytest.mark.parametrize("name", ["12345678", "00421337", "12345678  # on its label"])
def test_a_serial_number_is_a_name_as_it_stands_there(name: str) -> None:
    assert parse_camera(TEXT.replace("camera_name: cam", f"camera_name: {name}"), "c").name == name.split(maxsplit=1)[0]
