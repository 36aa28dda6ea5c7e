"""Rotations, compiled: the counterparts of `asterism.protocol.geometry` for the kernels (tests hold them together)."""

import math

import numpy as np

from asterism.server.compiled import compiled


@compiled
def exp_into(x, y, z, out):
    """out (3, 3) = rotation matrix of the rotation vector (x, y, z), rad (Rodrigues)."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-10:
        s, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - c * (y * y + z * z), -s * z + c * x * y, s * y + c * x * z
    out[1, 0], out[1, 1], out[1, 2] = s * z + c * x * y, 1.0 - c * (x * x + z * z), -s * x + c * y * z
    out[2, 0], out[2, 1], out[2, 2] = -s * y + c * x * z, s * x + c * y * z, 1.0 - c * (x * x + y * y)


@compiled
def product_into(a, b, out):
    """out = a @ b, all (3, 3); out is neither a nor b."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled
def quat_into(r, out):
    """out (4,) = unit quaternion x y z w, w >= 0, of the rotation matrix r (3, 3); largest component first."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace >= max(r[0, 0], r[1, 1], r[2, 2]):
        x, y, z, w = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1.0 + trace
    elif r[0, 0] >= max(r[1, 1], r[2, 2]):
        x, y = 1.0 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0]
        z, w = r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]
    elif r[1, 1] >= r[2, 2]:
        x, y = r[0, 1] + r[1, 0], 1.0 + r[1, 1] - r[0, 0] - r[2, 2]
        z, w = r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]
    else:
        x, y = r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
        z, w = 1.0 + r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]
    scale = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        scale = -scale
    # `+ 0.0` turns -0.0 into 0.0, so that equal poses have equal bytes.
    out[0], out[1], out[2], out[3] = x * scale + 0.0, y * scale + 0.0, z * scale + 0.0, w * scale + 0.0


@compiled
def log_between(a, b, out):
    """out (3,) = rotation vector, rad, of b @ a.T: the turn, about the parent's axes, that leads from a to b."""
    turn = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turn[i, j] = b[i, 0] * a[j, 0] + b[i, 1] * a[j, 1] + b[i, 2] * a[j, 2]
    quat = np.empty(4)
    quat_into(turn, quat)
    sine = math.sqrt(quat[0] ** 2 + quat[1] ** 2 + quat[2] ** 2)
    factor = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, quat[3]) / sine
    out[0], out[1], out[2] = factor * quat[0], factor * quat[1], factor * quat[2]


@compiled
def angle_between(a, b):
    """Angle, rad, of the rotation that leads from a to b, both (3, 3)."""
    trace = 0.0
    skew2 = 0.0
    turn = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turn[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]
    trace = turn[0, 0] + turn[1, 1] + turn[2, 2]
    skew2 = (turn[2, 1] - turn[1, 2]) ** 2 + (turn[0, 2] - turn[2, 0]) ** 2 + (turn[1, 0] - turn[0, 1]) ** 2
    return math.atan2(math.sqrt(skew2), trace - 1.0)


@compiled
def mapped(rotation, t, point):
    """x, y, z of rotation @ point + t."""
    x, y, z = t[0], t[1], t[2]
    for j in range(3):
        x += rotation[0, j] * point[j]
        y += rotation[1, j] * point[j]
        z += rotation[2, j] * point[j]
    return x, y, z
