"""A lens as a row of numbers, and what each does to pixels."""

from dataclasses import replace

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats


def camera_of(like: Camera, values: Floats) -> Camera:
    """The same camera with another lens of its model: ``values`` (p,) are fx, fy, cx, cy, px, and coefficients."""
    fx, fy, cx, cy = values[:4]
    return replace(like, matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), distortion=values[4:])


def values_of(camera: Camera) -> Floats:
    """The lens' parameters (p,), as `camera_of` takes them."""
    m = camera.matrix
    return np.concatenate([[m[0, 0], m[1, 1], m[0, 2], m[1, 2]], camera.distortion])


def pixels_by_lens(camera: Camera, points: Floats) -> Floats:
    """Derivatives (n, 2, p) of the pixels of points (n, 3) in the camera's frame, m, by the lens' parameters; central
    differences.
    """
    values = values_of(camera)
    by_lens = np.empty((len(points), 2, len(values)))
    for k in range(len(values)):
        step = np.zeros(len(values))
        step[k] = 1e-3 if k < 4 else 1e-6
        ahead, behind = (camera_of(camera, values + sign * step).project(points) for sign in (1.0, -1.0))
        by_lens[:, :, k] = (ahead - behind) / (2.0 * step[k])
    return by_lens
