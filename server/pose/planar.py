"""Pose of a plane of points from their rays: homography by total least squares, both minima, refinement.

Everything here is compiled and works on points (n, 3) in the plane's frame (third coordinate: what they deviate from
the plane, m), rays (n, 2) = (x / z, y / z) in the camera's frame, and information (n, 3) = xx, xy, yy of the inverse
covariance of every ray. Poses are T_camera_plane as a rotation matrix (3, 3) and a translation (3,), m.

Sources: homography by total least squares: Hartley and Zisserman, "Multiple View Geometry", 4.1; the two rotations
of a plane: Collins and Bartoli, "Infinitesimal plane-based pose estimation", IJCV 2014; refinement: Levenberg and
Marquardt with left perturbation (R <- exp(w) R, t <- t + dt).
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.rotations import exp_into, product_into

HUBER2 = 9.0  # squared Mahalanobis distance beyond which a residual counts linearly
NO_SOLUTION = 1e18
CONVERGED = 1e-6  # squared sigmas: a step that gains less is the last


@compiled
def cholesky_solve(a, b):
    """Solve a x = b for symmetric positive definite a (n, n), in place; b becomes x. False if a is not that."""
    n = b.shape[0]
    for j in range(n):
        s = a[j, j]
        for k in range(j):
            s -= a[j, k] * a[j, k]
        if not s > 0.0:
            return False
        d = math.sqrt(s)
        a[j, j] = d
        for i in range(j + 1, n):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            a[i, j] = s / d
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * b[k]
        b[i] = s / a[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= a[k, i] * b[k]
        b[i] = s / a[i, i]
    return True


@compiled
def _normalisation(points, rays):
    """Scale of centred points, mean and scale of rays: what keeps the linear systems well conditioned."""
    n = points.shape[0]
    mean_u = mean_v = size_p = size_r = 0.0
    for i in range(n):
        mean_u += rays[i, 0]
        mean_v += rays[i, 1]
        size_p += points[i, 0] ** 2 + points[i, 1] ** 2
    mean_u /= n
    mean_v /= n
    for i in range(n):
        size_r += (rays[i, 0] - mean_u) ** 2 + (rays[i, 1] - mean_v) ** 2
    return math.sqrt(size_p / (2 * n)), mean_u, mean_v, math.sqrt(size_r / (2 * n))


@compiled
def _denormalise(g, size_p, mean_u, mean_v, size_r, h):
    """Homography h (3, 3), h[2, 2] = 1, from the nine numbers of the normalised one."""
    for j in range(3):
        unscale = 1.0 / size_p if j < 2 else 1.0
        h[0, j] = (size_r * g[j] + mean_u * g[6 + j]) * unscale
        h[1, j] = (size_r * g[3 + j] + mean_v * g[6 + j]) * unscale
        h[2, j] = g[6 + j] * unscale
    w = h[2, 2]
    if abs(w) < 1e-9:
        return False
    h /= w
    return True


@compiled
def homography_tls(points, rays, h):
    """The homography h (3, 3) from plane to rays by total least squares: the last right singular vector (SVD).

    ``points`` must be centred. Returns False where there is none.
    """
    n = points.shape[0]
    size_p, mean_u, mean_v, size_r = _normalisation(points, rays)
    if not (size_p > 0.0 and size_r > 0.0):
        return False
    a = np.zeros((2 * n, 9))
    for i in range(n):
        x, y = points[i, 0] / size_p, points[i, 1] / size_p
        u, v = (rays[i, 0] - mean_u) / size_r, (rays[i, 1] - mean_v) / size_r
        a[2 * i, 0], a[2 * i, 1], a[2 * i, 2] = x, y, 1.0
        a[2 * i, 6], a[2 * i, 7], a[2 * i, 8] = -u * x, -u * y, -u
        a[2 * i + 1, 3], a[2 * i + 1, 4], a[2 * i + 1, 5] = x, y, 1.0
        a[2 * i + 1, 6], a[2 * i + 1, 7], a[2 * i + 1, 8] = -v * x, -v * y, -v
    _, _, vt = np.linalg.svd(a, True)
    return _denormalise(vt[8], size_p, mean_u, mean_v, size_r, h)


@compiled
def homography_ls(points, rays, h):
    """The same by ordinary least squares with h[2, 2] = 1 (normal equations): a quick start for verification."""
    n = points.shape[0]
    size_p, mean_u, mean_v, size_r = _normalisation(points, rays)
    if not (size_p > 0.0 and size_r > 0.0):
        return False
    a = np.zeros((8, 8))
    b = np.zeros(8)
    row = np.zeros(8)
    for i in range(n):
        x, y = points[i, 0] / size_p, points[i, 1] / size_p
        u, v = (rays[i, 0] - mean_u) / size_r, (rays[i, 1] - mean_v) / size_r
        for second in range(2):
            told = v if second else u
            row[:] = 0.0
            row[3 * second], row[3 * second + 1], row[3 * second + 2] = x, y, 1.0
            row[6], row[7] = -told * x, -told * y
            for j in range(8):
                if row[j] != 0.0:
                    b[j] += row[j] * told
                    for k in range(j + 1):
                        a[j, k] += row[j] * row[k]
    if not cholesky_solve(a, b):
        return False
    g = np.empty(9)
    g[:8] = b
    g[8] = 1.0
    return _denormalise(g, size_p, mean_u, mean_v, size_r, h)


@compiled
def two_rotations(h, first, second):
    """Both rotations (3, 3) that explain the homography to first order at the plane's origin (IPPE).

    False where the homography is degenerate.
    """
    p, q = h[0, 2], h[1, 2]
    j00, j01 = h[0, 0] - h[2, 0] * p, h[0, 1] - h[2, 1] * p
    j10, j11 = h[1, 0] - h[2, 0] * q, h[1, 1] - h[2, 1] * q
    # v: the rotation that turns the optical axis towards the plane's origin.
    s = math.sqrt(p * p + q * q + 1.0)
    c = 1.0 / s
    k = 1.0 / (1.0 + c) / (s * s)
    v00, v01, v11 = 1.0 - k * p * p, -k * p * q, 1.0 - k * q * q
    v02, v12, v20, v21, v22 = p * c, q * c, -p * c, -q * c, c
    b00, b01 = v00 - p * v20, v01 - p * v21
    b10, b11 = v01 - q * v20, v11 - q * v21
    det = b00 * b11 - b01 * b10
    if abs(det) < 1e-12:
        return False
    a00, a01 = (b11 * j00 - b01 * j10) / det, (b11 * j01 - b01 * j11) / det
    a10, a11 = (b00 * j10 - b10 * j00) / det, (b00 * j11 - b10 * j01) / det
    aa, bb, ab = a00 * a00 + a01 * a01, a10 * a10 + a11 * a11, a00 * a10 + a01 * a11
    gamma = math.sqrt(0.5 * (aa + bb + math.sqrt((aa - bb) ** 2 + 4.0 * ab * ab)))
    if not gamma > 1e-12:
        return False
    r00, r01, r10, r11 = a00 / gamma, a01 / gamma, a10 / gamma, a11 / gamma
    c0 = math.sqrt(max(1.0 - r00 * r00 - r10 * r10, 0.0))
    c1 = math.sqrt(max(1.0 - r01 * r01 - r11 * r11, 0.0))
    if -(r00 * r01 + r10 * r11) < 0.0:
        c1 = -c1
    for which in range(2):
        out = first if which == 0 else second
        sign = 1.0 if which == 0 else -1.0
        x0, x1, x2 = r00, r10, sign * c0
        y0, y1, y2 = r01, r11, sign * c1
        z0, z1, z2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
        for j in range(3):
            e0, e1, e2 = (x0, x1, x2) if j == 0 else ((y0, y1, y2) if j == 1 else (z0, z1, z2))
            out[0, j] = v00 * e0 + v01 * e1 + v02 * e2
            out[1, j] = v01 * e0 + v11 * e1 + v12 * e2
            out[2, j] = v20 * e0 + v21 * e1 + v22 * e2
    return True


@compiled
def translation(rotation, points, rays, t):
    """The translation (3,) that fits best, linearly, for a given rotation."""
    n = points.shape[0]
    s1 = s2 = s3 = d0 = d1 = d2 = 0.0
    for i in range(n):
        q0 = q1 = q2 = 0.0
        for j in range(3):
            q0 += rotation[0, j] * points[i, j]
            q1 += rotation[1, j] * points[i, j]
            q2 += rotation[2, j] * points[i, j]
        u, v = rays[i, 0], rays[i, 1]
        bx, by = u * q2 - q0, v * q2 - q1
        s1 += u
        s2 += v
        s3 += u * u + v * v
        d0 += bx
        d1 += by
        d2 -= u * bx + v * by
    t[2] = (d2 + (s1 * d0 + s2 * d1) / n) / (s3 - (s1 * s1 + s2 * s2) / n)
    t[0] = (d0 + s1 * t[2]) / n
    t[1] = (d1 + s2 * t[2]) / n


@compiled
def pose_cost(rotation, t, points, rays, information):
    """Robust sum of squared Mahalanobis residuals; NO_SOLUTION if a point lies behind the camera."""
    cost = 0.0
    for i in range(points.shape[0]):
        x = rotation[0, 0] * points[i, 0] + rotation[0, 1] * points[i, 1] + rotation[0, 2] * points[i, 2] + t[0]
        y = rotation[1, 0] * points[i, 0] + rotation[1, 1] * points[i, 1] + rotation[1, 2] * points[i, 2] + t[1]
        z = rotation[2, 0] * points[i, 0] + rotation[2, 1] * points[i, 1] + rotation[2, 2] * points[i, 2] + t[2]
        if not z > 1e-6:
            return NO_SOLUTION
        e, f = rays[i, 0] - x / z, rays[i, 1] - y / z
        m2 = information[i, 0] * e * e + 2.0 * information[i, 1] * e * f + information[i, 2] * f * f
        cost += m2 if m2 <= HUBER2 else 2.0 * math.sqrt(HUBER2 * m2) - HUBER2
    return cost


@compiled
def normal_equations(rotation, t, points, rays, information, a, b):
    """Fill a (6, 6; its lower triangle) and b (6,) of the Gauss-Newton step: translation first, then the rotation
    vector.
    """
    # Sums are numbers of their own, which stay in registers: half of a solution's time was spent here on arrays.
    a00 = a10 = a11 = a20 = a21 = a22 = a30 = a31 = a32 = a33 = a40 = a41 = a42 = a43 = a44 = 0.0
    a50 = a51 = a52 = a53 = a54 = a55 = b0 = b1 = b2 = b3 = b4 = b5 = 0.0
    for i in range(points.shape[0]):
        q0 = rotation[0, 0] * points[i, 0] + rotation[0, 1] * points[i, 1] + rotation[0, 2] * points[i, 2]
        q1 = rotation[1, 0] * points[i, 0] + rotation[1, 1] * points[i, 1] + rotation[1, 2] * points[i, 2]
        q2 = rotation[2, 0] * points[i, 0] + rotation[2, 1] * points[i, 1] + rotation[2, 2] * points[i, 2]
        iz = 1.0 / (q2 + t[2])
        u, v = (q0 + t[0]) * iz, (q1 + t[1]) * iz
        # Derivatives of the ray's x are (iz, 0, u2, u3, u4, u5), those of its y (0, iz, v2, v3, v4, v5): d(w x q), the
        # rotation's part, is (translation's part) x, crossed with q.
        u2, v2 = -u * iz, -v * iz
        u3, u4, u5 = u2 * q1, iz * q2 - u2 * q0, -iz * q1
        v3, v4, v5 = -iz * q2 + v2 * q1, -v2 * q0, iz * q0
        e, f = rays[i, 0] - u, rays[i, 1] - v
        wxx, wxy, wyy = information[i, 0], information[i, 1], information[i, 2]
        m2 = wxx * e * e + 2.0 * wxy * e * f + wyy * f * f
        if m2 > HUBER2:
            trust = math.sqrt(HUBER2 / m2)
            wxx *= trust
            wxy *= trust
            wyy *= trust
        x, y = wxx * iz, wxy * iz
        b0 += x * e + y * f
        a00 += x * iz
        x, y = wxy * iz, wyy * iz
        b1 += x * e + y * f
        a10 += x * iz
        a11 += y * iz
        x, y = wxx * u2 + wxy * v2, wxy * u2 + wyy * v2
        b2 += x * e + y * f
        a20 += x * iz
        a21 += y * iz
        a22 += x * u2 + y * v2
        x, y = wxx * u3 + wxy * v3, wxy * u3 + wyy * v3
        b3 += x * e + y * f
        a30 += x * iz
        a31 += y * iz
        a32 += x * u2 + y * v2
        a33 += x * u3 + y * v3
        x, y = wxx * u4 + wxy * v4, wxy * u4 + wyy * v4
        b4 += x * e + y * f
        a40 += x * iz
        a41 += y * iz
        a42 += x * u2 + y * v2
        a43 += x * u3 + y * v3
        a44 += x * u4 + y * v4
        x, y = wxx * u5 + wxy * v5, wxy * u5 + wyy * v5
        b5 += x * e + y * f
        a50 += x * iz
        a51 += y * iz
        a52 += x * u2 + y * v2
        a53 += x * u3 + y * v3
        a54 += x * u4 + y * v4
        a55 += x * u5 + y * v5
    a[:, :] = 0.0
    a[0, 0] = a00
    a[1, 0], a[1, 1] = a10, a11
    a[2, 0], a[2, 1], a[2, 2] = a20, a21, a22
    a[3, 0], a[3, 1], a[3, 2], a[3, 3] = a30, a31, a32, a33
    a[4, 0], a[4, 1], a[4, 2], a[4, 3], a[4, 4] = a40, a41, a42, a43, a44
    a[5, 0], a[5, 1], a[5, 2], a[5, 3], a[5, 4], a[5, 5] = a50, a51, a52, a53, a54, a55
    b[0], b[1], b[2], b[3], b[4], b[5] = b0, b1, b2, b3, b4, b5


@compiled
def damped_step(normal, damping, rotation, t, step, new_rotation, new_t):
    """Fill ``new_rotation`` (3, 3) and ``new_t`` (3,) with a pose one step of Levenberg and Marquardt further, of the
    ``normal`` equations a (6, 6; its lower triangle) and b (6,), both destroyed; False where they have no solution.
    ``step`` (3, 3) is scratch.
    """
    a, b = normal
    for j in range(6):
        a[j, j] *= 1.0 + damping
    if not cholesky_solve(a, b):
        return False
    exp_into(b[3], b[4], b[5], step)
    product_into(step, rotation, new_rotation)
    new_t[0], new_t[1], new_t[2] = t[0] + b[0], t[1] + b[1], t[2] + b[2]
    return True


@compiled
def refine_pose(rotation, t, points, rays, information, iterations):
    """Levenberg-Marquardt on rotation and translation, in place; returns the robust cost."""
    cost = pose_cost(rotation, t, points, rays, information)
    if cost >= NO_SOLUTION:
        return cost
    # Room is asked for as seldom as can be: that takes as long as half an iteration.
    six, three = np.empty((7, 6)), np.empty((3, 3, 3))
    a, b, step, new_rotation, new_t = six[:6], six[6], three[0], three[1], three[2, 0]
    damping = 1e-6
    for _ in range(iterations):
        normal_equations(rotation, t, points, rays, information, a, b)
        if not damped_step((a, b), damping, rotation, t, step, new_rotation, new_t):
            damping = damping * 10.0 + 1e-3
            continue
        new_cost = pose_cost(new_rotation, new_t, points, rays, information)
        if new_cost <= cost:
            gained = cost - new_cost
            rotation[:, :] = new_rotation
            t[:] = new_t
            cost = new_cost
            damping *= 0.1
            if gained <= CONVERGED:
                break
        else:
            damping = damping * 10.0 + 1e-4
    return cost


@compiled
def other_minimum(rotation, t, points, rays, other_rotation, other_t):
    """Where to start for the second minimum of a plane's pose: the first one's own homography, explained otherwise.

    ``points`` must be centred on the plane's origin. False where the two coincide.
    """
    room = np.empty((2, 3, 3))
    h, same = room[0], room[1]
    for i in range(3):
        h[i, 0], h[i, 1], h[i, 2] = rotation[i, 0] / t[2], rotation[i, 1] / t[2], t[i] / t[2]
    if not two_rotations(h, same, other_rotation):
        return False
    # Of the two, one is the pose it came from: take the other.
    here, there = 0.0, 0.0
    for i in range(3):
        for j in range(3):
            here += same[i, j] * rotation[i, j]
            there += other_rotation[i, j] * rotation[i, j]
    if there > here:
        other_rotation[:, :] = same
    translation(other_rotation, points, rays, other_t)
    return True


@compiled
def solve_both(points, rays, information, iterations, rotations, ts, costs):
    """Both minima of the pose: rotations (2, 3, 3), translations (2, 3), robust costs (2,), the cheaper first.

    ``points`` must be centred. A minimum that does not exist has cost NO_SOLUTION; False if there is none at all.
    """
    h = np.empty((3, 3))
    costs[0] = costs[1] = NO_SOLUTION
    if not homography_ls(points, rays, h) or not two_rotations(h, rotations[0], rotations[1]):
        return False
    for which in range(2):
        translation(rotations[which], points, rays, ts[which])
        if ts[which, 2] > 0.0:
            costs[which] = refine_pose(rotations[which], ts[which], points, rays, information, iterations)
    if costs[1] < costs[0]:
        for i in range(3):
            ts[0, i], ts[1, i] = ts[1, i], ts[0, i]
            for j in range(3):
                rotations[0, i, j], rotations[1, i, j] = rotations[1, i, j], rotations[0, i, j]
        costs[0], costs[1] = costs[1], costs[0]
    return costs[0] < NO_SOLUTION
