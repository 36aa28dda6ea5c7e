"""The lens, compiled: from pixels back to rays, with the covariance carried along.

The models are those of `asterism.protocol.camera.distort`; the inverse is Newton's method on them.
"""

import math

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled

# The lens as one array: fx, fy, cx, cy, the model's number, its coefficients (eight places).
FX, FY, CX, CY, MODEL, COEFFICIENTS = range(6)
_MODELS = {"plumb_bob": 0, "rational_polynomial": 0, "equidistant": 1}


def lens_of(camera: Camera) -> Floats:
    """The camera as the array (13,) that the compiled code takes."""
    lens = np.zeros(COEFFICIENTS + 8)
    k = camera.matrix
    lens[:5] = k[0, 0], k[1, 1], k[0, 2], k[1, 2], _MODELS[camera.model]
    lens[COEFFICIENTS : COEFFICIENTS + len(camera.distortion)] = camera.distortion
    return lens


@compiled
def distort_with_jacobian(lens, x, y):
    """Distorted coordinates of the ideal ones (x / z, y / z), and their derivatives: xd, yd, d00, d01, d10, d11."""
    k = lens[COEFFICIENTS:]
    r2 = x * x + y * y
    if lens[MODEL] == 1:
        r = math.sqrt(r2)
        theta = math.atan(r)
        t2 = theta * theta
        bent = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        by_theta = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))
        if r < 1e-6:
            return x, y, 1.0, 0.0, 0.0, 1.0
        scale = bent / r
        # d(scale)/d(r) / r
        bend = (by_theta / (1.0 + r2) - scale) / r2
        return x * scale, y * scale, scale + bend * x * x, bend * x * y, bend * x * y, scale + bend * y * y
    top = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    bottom = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    scale = top / bottom
    top_r2 = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4])
    bottom_r2 = k[5] + r2 * (2.0 * k[6] + r2 * 3.0 * k[7])
    bend = 2.0 * (top_r2 - scale * bottom_r2) / bottom  # d(scale)/dx = bend * x
    p1, p2 = k[2], k[3]
    xd = x * scale + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * scale + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    cross = bend * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    return (
        xd,
        yd,
        scale + bend * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        scale + bend * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@compiled
def undistort(lens, centres, covariances, rays, ray_covariances):
    """Ideal coordinates (n, 2) = (x / z, y / z) of pixels (n, 2), and their covariances (n, 3) xx, xy, yy.

    Pixels that no ray of the model reaches become nan.
    """
    for i in range(centres.shape[0]):
        xd, yd = (centres[i, 0] - lens[CX]) / lens[FX], (centres[i, 1] - lens[CY]) / lens[FY]
        x, y = xd, yd
        a, b, c, d, det = 1.0, 0.0, 0.0, 1.0, 1.0
        off = 1.0
        for _ in range(20):
            xe, ye, a, b, c, d = distort_with_jacobian(lens, x, y)
            ex, ey = xd - xe, yd - ye
            det = a * d - b * c
            if det <= 0.0:
                break
            x += (d * ex - b * ey) / det
            y += (a * ey - c * ex) / det
            off = abs(ex) + abs(ey)
            if off < 1e-12:
                break
        if det <= 0.0 or not off < 1e-9:
            rays[i, 0] = rays[i, 1] = np.nan
            ray_covariances[i, :] = 0.0
            continue
        rays[i, 0], rays[i, 1] = x, y
        # Covariance through the inverse Jacobian of pixels by ideal coordinates.
        ia, ib = d / det / lens[FX], -b / det / lens[FY]
        ic, id_ = -c / det / lens[FX], a / det / lens[FY]
        xx, xy, yy = covariances[i, 0], covariances[i, 1], covariances[i, 2]
        ray_covariances[i, 0] = ia * ia * xx + 2.0 * ia * ib * xy + ib * ib * yy
        ray_covariances[i, 1] = ia * ic * xx + (ia * id_ + ib * ic) * xy + ib * id_ * yy
        ray_covariances[i, 2] = ic * ic * xx + 2.0 * ic * id_ * xy + id_ * id_ * yy


@compiled
def project_point(lens, x, y, z):
    """Pixel of a point in the camera's frame."""
    xd, yd, _, _, _, _ = distort_with_jacobian(lens, x / z, y / z)
    return lens[FX] * xd + lens[CX], lens[FY] * yd + lens[CY]
