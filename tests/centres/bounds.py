"""The least error that physics allows: Cramer-Rao bounds, by differences of rendered images; slow and obvious."""

from collections.abc import Callable

import numpy as np

from asterism.protocol.geometry import Floats
from tests.centres.rendering import Canvas

READ, GAIN = 1.2, 0.03  # grey levels, grey levels of variance per grey level of light: as `Canvas.expose` draws them


def centre_bound(
    a: float, b: float, angle: float, level: float, psf: float = 0.9, x: float = 0.0, y: float = 0.0,
    read: float = READ, slope: tuple[float, float] = (0.0, 0.0), background: float = 8.0,
) -> Floats:  # fmt: skip
    """Covariance (2, 2) px^2 of the best unbiased estimate of an ellipse's centre.

    Brightness, background with its slopes, axes, angle and point spread are unknown as well. Pixels at the sensor's
    ceiling tell nothing; rounding adds a variance of 1/12.
    """
    half = int(np.ceil(a + 4 * psf + 2))
    size = 2 * half + 1

    def mean(p: Floats) -> Floats:
        canvas = Canvas.of(size, size, background=p[2], slope=(p[3], p[4]))
        canvas.psf_px = p[9]
        return canvas.ellipse(half + p[0], half + p[1], p[6], p[7], p[8], level=p[5]).light

    at = np.array([x, y, background, slope[0], slope[1], level, a, b, angle, psf])
    steps = np.array([0.02, 0.02, 0.5, 0.01, 0.01, 0.01 * level, 0.02, 0.02, 0.02, 0.02])
    keep = [k for k in range(len(at)) if k != 8 or a != b]  # a circle has no angle
    middle = mean(at)
    columns = []
    for k in keep:
        up, down = at.copy(), at.copy()
        up[k] += steps[k]
        down[k] -= steps[k]
        columns.append(((mean(up) - mean(down)) / (2 * steps[k])).ravel())
    jacobian = np.stack(columns, axis=1)
    variance = read**2 + GAIN * np.maximum(middle - background, 0.0).ravel() + 1 / 12
    weight = np.where(middle.ravel() < 254.5, 1.0 / variance, 0.0)
    return np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian))[:2, :2]


def pose_bound(project: Callable[[Floats], Floats], pose: Floats, covariances: Floats) -> Floats:
    """Covariance (6, 6) of the best unbiased estimate of a pose.

    ``project`` maps a small motion (6,) applied to the pose to the LEDs' pixels (n, 2); ``covariances`` (n, 2, 2) are
    those of the centres, px^2.
    """
    columns = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6
        columns.append((project(pose + step) - project(pose - step)) / 2e-6)
    jacobian = np.stack(columns, axis=-1)  # (n, 2, 6)
    information = np.zeros((6, 6))
    for row, covariance in zip(jacobian, covariances, strict=True):
        information += row.T @ np.linalg.solve(covariance, row)
    return np.linalg.inv(information)
