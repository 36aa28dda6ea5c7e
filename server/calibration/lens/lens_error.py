"""How wrong a calibrated lens may be, and what that does to where things seen through it seem to be.

First order: pixels are predicted with the lens as it was calibrated; a lens that is off by d shifts them by F d, and a
pose fitted to them by -(J' J)^-1 J' F d. All views through one lens share its error: it does not average out.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.protocol.camera import Camera, load_camera
from asterism.protocol.geometry import Floats
from asterism.protocol.rig_files import report_path
from asterism.protocol.yaml_file import Section, read_yaml
from asterism.server.calibration.lens.fit import NAMES
from asterism.server.calibration.lens.values import camera_of, pixels_by_lens, values_of

ANOTHER = 1e-6  # relative: a focal length that differs by more is another lens'
GRID = 12  # places across and down the image


@dataclass(frozen=True, slots=True, eq=False)
class LensError:
    """``covariance`` (p, p) of fx, fy, cx, cy, px, and the model's coefficients; ``told_by``, for sentences.

    ``correlated``: whether it is whole; otherwise only its diagonal is known.
    """

    covariance: Floats
    told_by: str
    correlated: bool = True


def read_lens_error(camera_path: Path, camera: Camera) -> LensError | None:
    """What the report beside a camera's file tells; None where there is none. ``camera`` may be a part of what the file
    calibrates: the error is that of the part.

    Raises InputError where the report is of another lens.
    """
    path = report_path(camera_path)
    if not path.exists():
        return None
    report = read_yaml(path)
    names = ("fx", "fy", "cx", "cy", *NAMES[camera.model])
    whole = camera
    if camera_path.exists():
        told = load_camera(camera_path)
        if (told.width, told.height) != (camera.width, camera.height):
            whole = told
    _check_same_lens(report, whole, camera_path, names)
    shares = np.diag(camera.matrix)[:2] / np.diag(whole.matrix)[:2]
    by_part = np.concatenate([shares, shares, np.ones(len(names) - 4)])
    by = report.text("made_by") if "made_by" in report else "calibrate camera"
    if "covariance" in report:
        rows = report.rows("covariance", len(names), ", ".join(names))
        return LensError(np.array(rows).reshape(len(names), len(names)) * np.outer(by_part, by_part), by)
    sigmas = report.section("sigmas")
    variances = np.array([sigmas.number(name, least=0.0) ** 2 for name in names])
    return LensError(np.diag(variances * by_part**2), by, correlated=False)


def _check_same_lens(report: Section, camera: Camera, camera_path: Path, names: tuple[str, ...]) -> None:
    if "model" in report and report.text("model") != camera.model:
        raise report.error("model", f"{report.text('model')}, expected {camera.model} as {camera_path} has it")
    if "values" not in report:
        return
    for name, value in zip(names, values_of(camera), strict=True):
        told = report.section("values").number(name)
        if abs(told - value) > ANOTHER * max(abs(value), 1.0):
            raise report.error(
                f"values.{name}",
                f"{told:.9g}, expected {value:.9g} as {camera_path} has it: it is the report of another calibration; "
                "calibrate that camera, or remove the report",
            )


def assumed_lens_error(
    camera: Camera, focal_relative: float, principal_point_px: float, distortion_relative: float, told_by: str
) -> LensError:
    """Of standard deviations alone: focal lengths are off together, and so are the distortion's coefficients."""
    p = 4 + len(camera.distortion)
    causes = np.zeros((4, p))
    causes[0, :2] = focal_relative * camera.matrix[[0, 1], [0, 1]]
    causes[1, 2] = causes[2, 3] = principal_point_px
    causes[3, 4:] = distortion_relative * camera.distortion
    return LensError(causes.T @ causes, told_by)


def shares_of(error: LensError, camera: Camera) -> dict[str, float]:
    """The error as three standard deviations: focal length, relative; principal point, px; and of what is left when
    both are known, the distortion's share: the RMS shift over the image for one of the lens' own.
    """
    covariance, focal = error.covariance, camera.focal_px
    sigmas = np.sqrt(np.diag(covariance))
    told = {
        "focal_relative": float(0.5 * (sigmas[0] + sigmas[1]) / focal),
        "principal_point_px": float(0.5 * (sigmas[2] + sigmas[3])),
    }
    if not (error.correlated and camera.distortion.any()):
        return told
    first, mixed = covariance[:4, :4], covariance[:4, 4:]
    left = covariance[4:, 4:] - mixed.T @ np.linalg.pinv(first, hermitian=True) @ mixed
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, GRID), np.linspace(0, camera.height - 1, GRID))
    rays = (np.column_stack([x.ravel(), y.ravel()]) - camera.matrix[:2, 2]) / focal
    points = np.column_stack([rays, np.ones(len(rays))])
    plain = camera_of(camera, np.concatenate([values_of(camera)[:4], 0.0 * camera.distortion]))
    bent = camera.project(points) - plain.project(points)
    by_distortion = pixels_by_lens(camera, points)[:, :, 4:]
    moved = np.einsum("nij,jk,nik->", by_distortion, left, by_distortion)
    told["distortion_relative"] = float(np.sqrt(max(moved, 0.0) / (bent**2).sum()))
    return told


def pose_by_lens(by_pose: Floats, by_lens: Floats) -> Floats:
    """(6, p): how a pose fitted to pixels moves when the lens that predicts them is off; ``by_pose`` (2 n, 6) and
    ``by_lens`` (2 n, p) are the pixels' derivatives.
    """
    return np.asarray(-np.linalg.solve(by_pose.T @ by_pose, by_pose.T @ by_lens), np.float64)
