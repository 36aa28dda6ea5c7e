"""The poses in which three LEDs are seen in three directions.

Seen from afar, a triangle's image tells its distance and two poses, each other's mirror image in depth, in closed form;
from these the three distances are refined by Newton's method on the law of cosines. Sources: Alter, "3-D pose from 3
points using weak-perspective", IEEE T-PAMI 1994; the equations are Grunert's, as in Haralick, Lee, Ottenberg, Noelle,
"Review and analysis of solutions of the three point perspective pose estimation problem", IJCV 1994. The up to two
further solutions of very near triangles are not found.
"""

import math

import numpy as np

from asterism.server.compiled import compiled

STEPS = 6
CLOSE = 1e-9  # of the squared length of a side


@compiled
def _frame(a, b, c, out):
    """Fill ``out`` (3, 3), its columns: along a to b, across in the triangle's plane, and its normal. False: a line."""
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    length = math.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    if not length > 0.0:
        return False
    x0, x1, x2 = x0 / length, x1 / length, x2 / length
    n0, n1, n2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    if not length > 0.0:
        return False
    n0, n1, n2 = n0 / length, n1 / length, n2 / length
    out[0, 0], out[1, 0], out[2, 0] = x0, x1, x2
    out[0, 1], out[1, 1], out[2, 1] = n1 * x2 - n2 * x1, n2 * x0 - n0 * x2, n0 * x1 - n1 * x0
    out[0, 2], out[1, 2], out[2, 2] = n0, n1, n2
    return True


@compiled
def _settle(cosines, sides2, distances):
    """Refine the distances (3,) until the sides 01, 02, 12 are right. False: they never are."""
    for _ in range(STEPS):
        a, b, c = distances[0], distances[1], distances[2]
        f0 = a * a + b * b - 2.0 * a * b * cosines[0] - sides2[0]
        f1 = a * a + c * c - 2.0 * a * c * cosines[1] - sides2[1]
        f2 = b * b + c * c - 2.0 * b * c * cosines[2] - sides2[2]
        if abs(f0) < CLOSE * sides2[0] and abs(f1) < CLOSE * sides2[1] and abs(f2) < CLOSE * sides2[2]:
            return a > 0.0 and b > 0.0 and c > 0.0
        p, q = a - b * cosines[0], b - a * cosines[0]
        r, s = a - c * cosines[1], c - a * cosines[1]
        u, v = b - c * cosines[2], c - b * cosines[2]
        # Rows (p, q, 0), (r, 0, s), (0, u, v), half of the derivatives.
        det = -p * s * u - q * r * v
        if not abs(det) > 1e-30:
            return False
        f0, f1, f2 = 0.5 * f0, 0.5 * f1, 0.5 * f2
        distances[0] -= (-f0 * s * u - q * (f1 * v - s * f2)) / det
        distances[1] -= (p * (f1 * v - s * f2) - f0 * r * v) / det
        distances[2] -= (-p * f1 * u - q * r * f2 + f0 * r * u) / det
    a, b, c = distances[0], distances[1], distances[2]
    # A triangle that is seen square on may have no exact solution for the spots' noise: a near one will do.
    f0 = a * a + b * b - 2.0 * a * b * cosines[0] - sides2[0]
    f1 = a * a + c * c - 2.0 * a * c * cosines[1] - sides2[1]
    f2 = b * b + c * c - 2.0 * b * c * cosines[2] - sides2[2]
    near = abs(f0) < 0.02 * sides2[0] and abs(f1) < 0.02 * sides2[1] and abs(f2) < 0.02 * sides2[2]
    return near and a > 0.0 and b > 0.0 and c > 0.0


@compiled
def three_points(directions, points, rotations, ts):
    """Fill ``rotations`` (2, 3, 3) and ``ts`` (2, 3) m with the poses that map ``points`` (3, 3) m onto rays along the
    unit vectors ``directions`` (3, 3), rows; returns how many there are.
    """
    cosines, sides2, chords2 = np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        i, j = (0, 1) if k == 0 else ((0, 2) if k == 1 else (1, 2))
        cosines[k] = sides2[k] = 0.0
        for axis in range(3):
            cosines[k] += directions[i, axis] * directions[j, axis]
            sides2[k] += (points[i, axis] - points[j, axis]) ** 2
        chords2[k] = max(2.0 - 2.0 * cosines[k], 1e-18)
    # Alter's equations: R the sides, d the chords in the image; a and c are 16 squared areas.
    r01, r02, r12, d01, d02, d12 = sides2[0], sides2[1], sides2[2], chords2[0], chords2[1], chords2[2]
    a = 2.0 * (r01 * r02 + r01 * r12 + r02 * r12) - r01 * r01 - r02 * r02 - r12 * r12
    c = 2.0 * (d01 * d02 + d01 * d12 + d02 * d12) - d01 * d01 - d02 * d02 - d12 * d12
    b = d01 * (r02 + r12 - r01) + d02 * (r01 + r12 - r02) + d12 * (r01 + r02 - r12)
    if not a > 0.0:
        return 0
    scale2 = (b + math.sqrt(max(b * b - a * c, 0.0))) / a
    if not scale2 > 0.0:
        return 0
    h1 = math.sqrt(max(scale2 * r01 - d01, 0.0))
    h2 = math.sqrt(max(scale2 * r02 - d02, 0.0))
    if d01 + d02 - d12 > scale2 * (r01 + r02 - r12):
        h2 = -h2
    away = 1.0 / math.sqrt(scale2)
    seen, flat, corners, distances = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    if not _frame(points[0], points[1], points[2], flat):
        return 0
    count = 0
    for sign in (1.0, -1.0):
        distances[0], distances[1], distances[2] = away, away * (1.0 + sign * h1), away * (1.0 + sign * h2)
        if not _settle(cosines, sides2, distances):
            continue
        for k in range(3):
            for axis in range(3):
                corners[k, axis] = distances[k] * directions[k, axis]
        if not _frame(corners[0], corners[1], corners[2], seen):
            continue
        rotation = rotations[count]
        for i in range(3):
            for j in range(3):
                rotation[i, j] = seen[i, 0] * flat[j, 0] + seen[i, 1] * flat[j, 1] + seen[i, 2] * flat[j, 2]
        for i in range(3):
            ts[count, i] = corners[0, i]
            for j in range(3):
                ts[count, i] -= rotation[i, j] * points[0, j]
        count += 1
    return count
