"""The camera's calibration: the ROS camera_info file, read strictly, and the projection it describes."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, frozen_array
from asterism.protocol.keys import key_problem
from asterism.protocol.program import typed
from asterism.protocol.text_file import read_text
from asterism.protocol.yaml_file import Section, describe, parse_yaml

# Coefficients that each model takes, in OpenCV's order.
DISTORTION_MODELS = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "equidistant": (4,)}

_KEYS = (
    "image_width",
    "image_height",
    "camera_name",
    "camera_matrix",
    "distortion_model",
    "distortion_coefficients",
    "rectification_matrix",
    "projection_matrix",
)

# What people and other programs write instead.
_WORDS = {
    "camera_model": "distortion_model",
    "model": "distortion_model",
    "name": "camera_name",
    "serial": "camera_name",
    "serial_number": "camera_name",
    "k": "camera_matrix",
    "intrinsics": "camera_matrix",
    "intrinsic_matrix": "camera_matrix",
    "d": "distortion_coefficients",
    "dist_coeffs": "distortion_coefficients",
    "distortion": "distortion_coefficients",
    "distortion_coeffs": "distortion_coefficients",
    "width": "image_width",
    "height": "image_height",
    "resolution": "image_width",
}
# Files of other programs hold one of these.
_FOREIGN = re.compile(r"^%YAML|!!opencv-matrix|<opencv_storage|^(?:[kKdD]|cam\d+|mtx|dist|dist_coeffs?):", re.MULTILINE)


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A calibrated camera.

    ``matrix`` is K (3, 3) in px; ``distortion`` holds 5 (plumb_bob: k1 k2 p1 p2 k3), 8 (rational_polynomial:
    k1 k2 p1 p2 k3 k4 k5 k6) or 4 (equidistant: k1 k2 k3 k4) coefficients.
    """

    name: str
    width: int
    height: int
    matrix: Floats  # (3, 3) px
    model: str
    distortion: Floats  # (5,), (8,) or (4,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", frozen_array(self.matrix, 3, 3))
        object.__setattr__(self, "distortion", frozen_array(self.distortion, -1))

    @property
    def focal_px(self) -> float:
        """The mean of fx and fy, px."""
        return float(self.matrix[0, 0] + self.matrix[1, 1]) / 2.0

    def project(self, points: Floats) -> Floats:
        """Pixels (..., 2) of points (..., 3) in the camera's frame, z > 0, m.

        Brown's model with OpenCV's rational extension, or the equidistant fisheye of Kannala and Brandt (2006).
        """
        points = np.asarray(points, dtype=np.float64)
        distorted = distort(points[..., :2] / points[..., 2:], self.model, self.distortion)
        pixels: Floats = distorted @ self.matrix[:2, :2].T + self.matrix[:2, 2]
        return pixels


def distort(normalised: Floats, model: str, coefficients: Floats) -> Floats:
    """Distorted image-plane coordinates (..., 2) of ideal ones (x / z, y / z)."""
    x, y = normalised[..., 0], normalised[..., 1]
    r2 = x * x + y * y
    if model == "equidistant":
        k1, k2, k3, k4 = coefficients
        r = np.sqrt(r2)
        theta = np.arctan(r)
        t2 = theta * theta
        bent = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        scale = np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)
        return np.stack([x * scale, y * scale], axis=-1)
    k1, k2, p1, p2, k3 = coefficients[:5]
    scale = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if len(coefficients) == 8:
        k4, k5, k6 = coefficients[5:]
        scale = scale / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.stack(
        [
            x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def load_camera(path: Path) -> Camera:
    """Read a camera_info calibration file. Raises InputError with file, key, what was found, what is accepted."""
    return parse_camera(read_text(path, "a YAML file"), str(path))


def parse_camera(text: str, name: str) -> Camera:
    """The camera that the text of a camera_info file describes. Raises InputError as `load_camera` does."""
    try:
        return _camera(parse_yaml(text, name), text)
    except InputError as error:
        if not _FOREIGN.search(text):
            raise
        command = typed("calibrate", "camera", "--from", name, "-o", "camera.yaml")
        raise InputError(f"{error}; is it another program's calibration? Then {command} makes a file of it") from None


def _name(section: Section, text: str) -> str:
    """A serial number is a name as it stands there, with its zeros in front."""
    digits = re.search(r"^camera_name:[ \t]*([0-9]+)[ \t]*(?:#.*)?$", text, re.MULTILINE)
    name = digits[1] if digits else section.text("camera_name")
    if problem := key_problem(name):
        raise section.error("camera_name", f"{describe(name)} {problem}; it becomes part of a zenoh key")
    return name


def _camera(section: Section, text: str) -> Camera:
    section.only(_KEYS, _WORDS)
    width = section.integer("image_width", 16, 65_535)
    height = section.integer("image_height", 16, 65_535)
    name = _name(section, text)
    matrix = np.array(_matrix(section, "camera_matrix", 3, 3)).reshape(3, 3)
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise section.error(
            "camera_matrix",
            f"fx = {matrix[0, 0]:g} and fy = {matrix[1, 1]:g}, expected focal lengths above 0 px",
        )
    if matrix[0, 1] != 0.0:
        raise section.error(
            "camera_matrix",
            f"a skew of {matrix[0, 1]:g} px, which no lens model here has, since sensors have none",
        )
    fixed = matrix.copy()
    fixed[0, 0] = fixed[1, 1] = fixed[0, 2] = fixed[1, 2] = 0.0
    if not np.array_equal(fixed, np.diag([0.0, 0.0, 1.0])):
        raise section.error("camera_matrix", "expected the form [fx, 0, cx, 0, fy, cy, 0, 0, 1]")
    model = section.text("distortion_model", tuple(DISTORTION_MODELS))
    distortion = _coefficients(section, model)
    for key, rows, cols in (("rectification_matrix", 3, 3), ("projection_matrix", 3, 4)):
        if key in section:
            _matrix(section, key, rows, cols)
    return Camera(name, width, height, matrix, model, np.array(distortion))


def _matrix(section: Section, key: str, rows: int, cols: int) -> list[float]:
    inner = section.section(key)
    inner.only(("rows", "cols", "data"))
    have = (inner.integer("rows", 1, 100), inner.integer("cols", 1, 100))
    if have != (rows, cols):
        raise section.error(key, f"{have[0]} x {have[1]}, expected {rows} x {cols}")
    return inner.numbers("data", rows * cols, "row by row")


def _coefficients(section: Section, model: str) -> list[float]:
    inner = section.section("distortion_coefficients")
    inner.only(("rows", "cols", "data"))
    count = inner.integer("rows", 1, 100) * inner.integer("cols", 1, 100)
    accepted = DISTORTION_MODELS[model]
    if count not in accepted:
        wanted = " or ".join(str(number) for number in accepted)
        raise section.error("distortion_coefficients", f"{count} coefficients, expected {wanted} for {model}")
    values = inner.numbers("data", count, "the coefficients")
    return [*values, 0.0] if model == "plumb_bob" and count == 4 else values


def check_image_size(camera: Camera, width: int, height: int, where: str) -> None:
    """Refuse an image of another size than the calibration's; ``where`` names the image in the InputError."""
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{where}: the image is {width}x{height}, expected {camera.width}x{camera.height}, "
            f"the size that camera '{camera.name}' is calibrated for{_part_hint(camera, width, height)}"
        )


def _part_hint(camera: Camera, width: int, height: int) -> str:
    """What a rig says where images are a part of what is calibrated."""
    if width > camera.width or height > camera.height:
        return ""
    hint = f"capture: {{size: [{width}, {height}], offset: [x, y]}} for a region of it"
    step = camera.width // width
    if step > 1 and (width * step, height * step) == (camera.width, camera.height):
        hint = f"capture: {{binning: {step}}} where pixels are joined, {hint}"
    return f"; in the rig say {hint}"
