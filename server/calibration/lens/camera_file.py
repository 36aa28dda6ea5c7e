"""What a camera's calibration is written as: camera_info YAML, and a report of how good it is beside it."""

import math
import re
from collections.abc import Sequence

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats
from asterism.server.calibration.lens.fit import NAMES, CameraFit
from asterism.server.calibration.lens.values import values_of

_WORDS = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")  # of YAML, 1.1 too


def camera_text(camera: Camera) -> str:
    """The camera_info file, as ROS' camera_calibration writes it."""
    fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
    cx, cy = camera.matrix[0, 2], camera.matrix[1, 2]
    return f"""\
image_width: {camera.width}
image_height: {camera.height}
camera_name: {_name(camera.name)}
camera_matrix:
  rows: 3
  cols: 3
  data: {_list([fx, 0, cx, 0, fy, cy, 0, 0, 1])}
distortion_model: {camera.model}
distortion_coefficients:
  rows: 1
  cols: {len(camera.distortion)}
  data: {_list(camera.distortion)}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: {_list([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0])}
"""


def report_text(fit: CameraFit, target: str, source: str, held_out: dict[str, float], remarks: Sequence[str]) -> str:
    """How good it is: standard deviations, residuals, held-out errors (RMS distance of a point, px), what was left out.

    ``held_out`` is the held-out error of every model that was tried.
    """
    lines = [
        "# Made by asterism calibrate camera. Errors are RMS distances of a point, px.",
        "made_by: calibrate camera",
        f"source: {_quoted(source)}",
        f"target: {_quoted(target)}",
        f"model: {fit.camera.model}",
        f"views: {len(fit.views)}",
        f"points: {sum(len(off) for off in fit.residuals)}",
        f"rms_px: {fit.total_rms_px:.4f}",
        f"held_out_px: {fit.total_held_out_px:.4f}",
        "held_out_px_of_models: {" + ", ".join(f"{name}: {error:.4f}" for name, error in held_out.items()) + "}",
        *_lens_lines(fit.camera, fit.covariance),
        f"points_left_out: {fit.odd_points}",
        "views_left_out:" + ("" if fit.odd_views else " {}"),
        *(f"  {_quoted(name)}: {rms:.3f}" for name, rms in fit.odd_views),
        "views_used:  # RMS px: fitted, held out",
        *(
            f"  {_quoted(view.frame)}: [{rms:.4f}, {out:.4f}]"
            for view, rms, out in zip(fit.views, fit.rms_px, fit.held_out_px, strict=True)
        ),
        "remarks:" + ("" if remarks else " []"),
        *(f"  - {_quoted(remark)}" for remark in remarks),
    ]
    return "\n".join(lines) + "\n"


def refit_report_text(camera: Camera, covariance: Floats, source: str, views: int, by: str = "calibrate z") -> str:
    """What a refit of the lens knows of its own errors: ``covariance`` (p, p) of fx, fy, cx, cy and coefficients."""
    lines = [
        f"# Made by asterism {by}: the lens refitted to poses.",
        f"made_by: {by}",
        f"source: {_quoted(source)}",
        f"model: {camera.model}",
        f"views: {views}",
        *_lens_lines(camera, covariance),
    ]
    return "\n".join(lines) + "\n"


def _lens_lines(camera: Camera, covariance: Floats) -> list[str]:
    """Values, standard deviations and covariance of all parameters."""
    names = ("fx", "fy", "cx", "cy", *NAMES[camera.model])
    sigmas = np.sqrt(np.diag(covariance))
    return [
        "values:  # px and pure numbers",
        *(f"  {name}: {_number(value, 12)}" for name, value in zip(names, values_of(camera).tolist(), strict=True)),
        "sigmas:  # one standard deviation of every parameter",
        *(f"  {name}: {_number(sigma, 3)}" for name, sigma in zip(names, sigmas.tolist(), strict=True)),
        f"covariance:  # of {', '.join(names)}",
        *(f"  - {_list(row, 7)}" for row in covariance),
    ]


def _name(name: str) -> str:
    """In quotes where YAML would not read the same text: numbers, words with signs in them."""
    return name if re.fullmatch(r"[A-Za-z][\w.-]*", name, re.ASCII) and name.lower() not in _WORDS else _quoted(name)


def _list(values: Sequence[float] | Floats, digits: int = 12) -> str:
    return "[" + ", ".join(_number(float(value), digits) for value in np.asarray(values, np.float64)) + "]"


def _number(value: float, digits: int) -> str:
    text = f"{value:.{digits}g}"
    # YAML 1.1 takes 1e-05 for a text.
    return text.replace("e", ".0e") if "e" in text and "." not in text and math.isfinite(value) else text


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''").replace("\n", " ") + "'"
