"""Covariances (6, 6) of poses, translation (m) first, then rotation (rad): inverted, moved, turned."""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.rotations import product_into


@compiled
def tilt_variance(rotation, covariance):
    """Variance of the plane's normal, rad^2, both directions together, from the pose's covariance (6, 6)."""
    total = 0.0
    for i in range(3):
        total += covariance[3 + i, 3 + i]
        for j in range(3):
            total -= rotation[i, 2] * covariance[3 + i, 3 + j] * rotation[j, 2]
    return total


@compiled
def invert(a, out):
    """Inverse (6, 6) of the symmetric matrix whose lower triangle ``a`` holds, destroyed; huge where it is singular.

    Source: Cholesky, a = L L', then the inverse of L, column by column.
    """
    for j in range(6):
        for k in range(j + 1):
            total = a[j, k]
            for i in range(k):
                total -= a[j, i] * a[k, i]
            if k < j:
                a[j, k] = total / a[k, k]
            elif total > 0.0:
                a[j, j] = math.sqrt(total)
            else:
                out[:, :] = 0.0
                for i in range(6):
                    out[i, i] = 1e6
                return
    for j in range(6):
        a[j, j] = 1.0 / a[j, j]
        for i in range(j + 1, 6):
            total = 0.0
            for k in range(j, i):
                total -= a[i, k] * a[k, j]
            a[i, j] = total / a[i, i]
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, 6):
                total += a[k, i] * a[k, j]
            out[i, j] = out[j, i] = total


@compiled
def move_origin(covariance, arm):
    """Covariance (6, 6) of pose, translation first, when its origin moves by ``arm`` (3,), in the parent's axes."""
    # dt' = dt + w x arm: rows of translation gain K times rows of rotation, then the columns likewise.
    a, b, c = arm[0], arm[1], arm[2]
    for j in range(6):
        p, q, r = covariance[3, j], covariance[4, j], covariance[5, j]
        covariance[0, j] += q * c - r * b
        covariance[1, j] += r * a - p * c
        covariance[2, j] += p * b - q * a
    for i in range(6):
        p, q, r = covariance[i, 3], covariance[i, 4], covariance[i, 5]
        covariance[i, 0] += q * c - r * b
        covariance[i, 1] += r * a - p * c
        covariance[i, 2] += p * b - q * a


@compiled
def turn_axes(turn, covariance):
    """The same covariance (6, 6) about axes turned by ``turn`` (3, 3), in place."""
    block, half = np.empty((3, 3)), np.empty((3, 3))
    for row in range(0, 6, 3):
        for column in range(0, 6, 3):
            block[:, :] = covariance[row : row + 3, column : column + 3]
            product_into(turn, block, half)
            for i in range(3):
                for j in range(3):
                    total = 0.0
                    for k in range(3):
                        total += half[i, k] * turn[j, k]
                    covariance[row + i, column + j] = total
