"""The lens, compiled: from pixels back to rays, with the covariance carried along.

The models are those of `asterism.protocol.camera.distort`; the inverse is Newton's method on them.
"""

import math

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled

# The lens as one array: fx, fy, cx, cy, the model's number, its coefficients (eight places).
FX, FY, CX, CY, MODEL, K1 = range(6)
STEADY = 0.1  # determinant of the Jacobian beyond which the model is nowhere near turning back
_MODELS = {"plumb_bob": 0, "rational_polynomial": 0, "equidistant": 1}


def lens_of(camera: Camera) -> Floats:
    """The camera as the array (13,) that the compiled code takes."""
    lens = np.zeros(K1 + 8)
    k = camera.matrix
    lens[:5] = k[0, 0], k[1, 1], k[0, 2], k[1, 2], _MODELS[camera.model]
    lens[K1 : K1 + len(camera.distortion)] = camera.distortion
    return lens


@compiled
def _equidistant(lens, x, y):
    """What `distort_with_jacobian` tells, of the fisheye's model."""
    k1, k2, k3, k4 = lens[K1], lens[K1 + 1], lens[K1 + 2], lens[K1 + 3]
    r2 = x * x + y * y
    r = math.sqrt(r2)
    theta = math.atan(r)
    t2 = theta * theta
    bent = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    by_theta = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
    if r < 1e-6:
        return x, y, 1.0, 0.0, 0.0, 1.0
    scale = bent / r
    # d(scale)/d(r) / r
    bend = (by_theta / (1.0 + r2) - scale) / r2
    return x * scale, y * scale, scale + bend * x * x, bend * x * y, bend * x * y, scale + bend * y * y


@compiled
def distort_with_jacobian(lens, x, y):
    """Distorted coordinates of the ideal ones (x / z, y / z), and their derivatives: xd, yd, d00, d01, d10, d11."""
    if lens[MODEL] == 1:
        return _equidistant(lens, x, y)
    # No slice of the lens: that would count references.
    k1, k2, p1, p2, k3 = lens[K1], lens[K1 + 1], lens[K1 + 2], lens[K1 + 3], lens[K1 + 4]
    k4, k5, k6 = lens[K1 + 5], lens[K1 + 6], lens[K1 + 7]
    r2 = x * x + y * y
    top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    per_bottom = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    scale = top * per_bottom
    top_r2 = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    bottom_r2 = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6)
    bend = 2.0 * (top_r2 - scale * bottom_r2) * per_bottom  # d(scale)/dx = bend * x
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

    Pixels that no ray of the model reaches become nan. ``ray_covariances`` may be ``covariances``.
    """
    per_fx, per_fy = 1.0 / lens[FX], 1.0 / lens[FY]
    for i in range(centres.shape[0]):
        xd, yd = (centres[i, 0] - lens[CX]) * per_fx, (centres[i, 1] - lens[CY]) * per_fy
        x, y = xd, yd
        a, b, c, d, det, per_det = 1.0, 0.0, 0.0, 1.0, 1.0, 1.0
        off = 1.0
        for _ in range(20):
            xe, ye, a, b, c, d = distort_with_jacobian(lens, x, y)
            ex, ey = xd - xe, yd - ye
            det = a * d - b * c
            if det <= 0.0:
                break
            per_det = 1.0 / det
            x += (d * ex - b * ey) * per_det
            y += (a * ey - c * ex) * per_det
            off = abs(ex) + abs(ey)
            # The step squares what was off, but where the model turns back.
            if off < 1e-12 or (off < 1e-9 and det > STEADY):
                break
        if det <= 0.0 or not off < 1e-9:
            rays[i, 0] = rays[i, 1] = np.nan
            ray_covariances[i, :] = 0.0
            continue
        rays[i, 0], rays[i, 1] = x, y
        # Covariance through the inverse Jacobian of pixels by ideal coordinates.
        ia, ib = d * per_det * per_fx, -b * per_det * per_fy
        ic, id_ = -c * per_det * per_fx, a * per_det * per_fy
        xx, xy, yy = covariances[i, 0], covariances[i, 1], covariances[i, 2]
        ray_covariances[i, 0] = ia * ia * xx + 2.0 * ia * ib * xy + ib * ib * yy
        ray_covariances[i, 1] = ia * ic * xx + (ia * id_ + ib * ic) * xy + ib * id_ * yy
        ray_covariances[i, 2] = ic * ic * xx + 2.0 * ic * id_ * xy + id_ * id_ * yy


@compiled
def undistort_again(lens, rows, centres, covariances, changed, rays, ray_covariances):
    """As `undistort`, of those pixels ``rows`` (n,) of ``centres`` and ``covariances`` that have ``changed``."""
    for i in range(rows.shape[0]):
        k = rows[i]
        if changed[k]:
            undistort(lens, centres[k : k + 1], covariances[k : k + 1], rays[i : i + 1], ray_covariances[i : i + 1])


@compiled
def project_point(lens, x, y, z):
    """Pixel of a point in the camera's frame."""
    xd, yd, _, _, _, _ = distort_with_jacobian(lens, x / z, y / z)
    return lens[FX] * xd + lens[CX], lens[FY] * yd + lens[CY]
