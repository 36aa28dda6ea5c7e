"""The calibration that a driver of ROS tells beside its images, against the rig's."""

import numpy as np

from asterism.protocol.camera import Camera
from asterism.server.calibration.lens.foreign_camera import camera_of
from asterism.server.pose.lens import lens_of, undistort
from asterism.server.sources.foreign.ros_messages import CameraInfoTold

SAME_PX = 0.1  # no two calibrations of one lens agree better
_STEPS = 24  # along either side of the image
_TOLD_ALIKE = 1e-4  # of numbers, relative
_FURTHER = ("k3", "k4", "k5", "k6")


def difference(camera: Camera, told: CameraInfoTold) -> str | None:
    """How far another calibration puts what the rig's camera sees, a sentence; None where that is nowhere far.

    Raises InputError for one that is none, or that no lens model here has; drivers without one tell zeros: None.
    """
    if not any(told.matrix.ravel().tolist()):
        return None
    other = camera_of(told, "its calibration", camera.name)
    if (other.width, other.height) != (camera.width, camera.height):
        size, expected = f"{other.width}x{other.height}", f"{camera.width}x{camera.height}"
        return f"its calibration is for images of {size} px, the rig's for {expected}"
    middle_px, most_px = apart(camera, other)
    if most_px <= SAME_PX:
        return None
    return (
        f"its calibration is not the rig's: up to {most_px:.3g} px apart, {middle_px:.3g} px in the middle "
        f"({numbers(camera, other)}); poses are by the rig's"
    )


def apart(camera: Camera, other: Camera) -> tuple[float, float]:
    """How far two calibrations put the same rays from one another, px: in the image's middle, and at most."""
    across, down = np.linspace(0, camera.width - 1, _STEPS), np.linspace(0, camera.height - 1, _STEPS)
    grid = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    pixels = np.vstack([[(camera.width - 1) / 2, (camera.height - 1) / 2], grid])
    rays, covariances = np.empty_like(pixels), np.zeros((len(pixels), 3))
    undistort(lens_of(camera), pixels, covariances, rays, covariances)
    seen = np.isfinite(rays).all(axis=1)
    with np.errstate(all="ignore"):  # another calibration may put rays anywhere
        there = other.project(np.column_stack([rays[seen], np.ones(seen.sum())]))
        off = np.nan_to_num(np.linalg.norm(there - pixels[seen], axis=1), nan=np.inf, posinf=np.inf)
    return float(off[0]), float(off.max())


def numbers(camera: Camera, other: Camera) -> str:
    """What of two calibrations differs, in numbers; coefficients of several models are not to be compared."""
    ours, theirs = _listed(camera), _listed(other)
    if camera.model == other.model:
        told = [
            f"{name} {value:.6g} instead of {ours[name]:.6g}"
            for name, value in theirs.items()
            if not np.isclose(value, ours[name], rtol=_TOLD_ALIKE, atol=1e-6)
        ]
    else:
        told = [f"{other.model} instead of {camera.model}"]
    return ", ".join(told) or "no number by much"


def _listed(camera: Camera) -> dict[str, float]:
    k = camera.matrix
    names = ("k1", "k2", "k3", "k4") if camera.model == "equidistant" else ("k1", "k2", "p1", "p2", *_FURTHER)
    coefficients = dict(zip(names, camera.distortion.tolist(), strict=False))
    return {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], **coefficients}
