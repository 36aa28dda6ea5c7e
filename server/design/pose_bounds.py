"""What a constellation can tell about its pose at best: the Cramer-Rao bound, and how often the two tilts are confused.

Ideal rays, every centre with the same noise, the plate on the optical axis. Tilts are against the line of sight; the
direction in which a plate leans matters, so there are `DIRECTIONS` of them.
"""

import math
from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats, exp_rotation
from asterism.server.pose.planar import normal_equations, other_minimum, pose_cost, refine_pose

DIRECTIONS = 12  # evenly round the plate
_FACING = np.diag([1.0, -1.0, -1.0])
_ITERATIONS = 30
_LINE = 1e-3  # points whose spread in one direction is less than this of that in the other lie on one line


@dataclass(frozen=True, slots=True)
class Bound:
    """Least standard deviations of an unbiased estimate, root mean square over the directions of tilt."""

    across_m: float  # of x and of y, which are parallel to the image
    depth_m: float  # of z
    tilt_rad: float  # about the worst axis in the plate
    spin_rad: float  # about the plate's normal
    flip: float  # how often the wrong one of the two tilts explains the spots better; mean over the directions


def leaning_poses(distance_m: float, tilt_rad: float) -> list[tuple[Floats, Floats]]:
    """T_camera_plane, rotation (3, 3) and translation (3,), on the axis and tilted in all directions."""
    poses = []
    for number in range(DIRECTIONS):
        angle = 2.0 * math.pi * number / DIRECTIONS
        turn = exp_rotation(tilt_rad * np.array([math.cos(angle), math.sin(angle), 0.0]))
        poses.append((turn @ _FACING, np.array([0.0, 0.0, distance_m])))
    return poses


def pose_bound(points: Floats, distance_m: float, tilt_rad: float, sigma: float) -> Bound:
    """The bound for a plane's points (n, 3), n >= 4, m, at that distance and tilt; infinite where they lie on one line.

    The pose is that of the points' mean. ``sigma``, rays, is the noise of every coordinate of a centre: that in px over
    the focal length.

    A flip is decided by the least squared residual alone, without any prior. Its probability is that of the likelier
    of two known images, Q(d / 2) with d the distance of the two in sigmas. Where the second minimum is not one any
    more, the mirrored tilt itself stands for it; a plate that faces the camera has one half.
    """
    centred = points - points.mean(axis=0)
    lengths = np.linalg.svd(centred, compute_uv=False)
    if lengths[1] < _LINE * lengths[0]:
        return Bound(math.inf, math.inf, math.inf, math.inf, 0.5)
    information = np.tile([sigma**-2, 0.0, sigma**-2], (len(points), 1))
    squares, flips = [], []
    for rotation, t in leaning_poses(distance_m, tilt_rad):
        mapped = centred @ rotation.T + t
        rays = mapped[:, :2] / mapped[:, 2:]
        half, right = np.empty((6, 6)), np.empty(6)
        normal_equations(rotation, t, centred, rays, information, half, right)
        covariance = np.linalg.inv(np.tril(half) + np.tril(half, -1).T)
        turned = rotation.T @ covariance[3:, 3:] @ rotation  # in the plate's axes
        squares.append(
            [
                (covariance[0, 0] + covariance[1, 1]) / 2.0,
                covariance[2, 2],
                np.linalg.eigvalsh(turned[:2, :2])[1],
                turned[2, 2],
            ]
        )
        flips.append(_flip(rotation, t, centred, rays, information))
    across, depth, tilt, spin = np.sqrt(np.mean(squares, axis=0)).tolist()
    return Bound(across, depth, tilt, spin, float(np.mean(flips)))


def _flip(rotation: Floats, t: Floats, points: Floats, rays: Floats, information: Floats) -> float:
    other, other_t = np.empty((3, 3)), np.empty(3)
    if not other_minimum(rotation, t, points, rays, other, other_t):
        return 0.5
    start = other.copy()
    cost = pose_cost(other, other_t, points, rays, information)
    refined = refine_pose(other, other_t, points, rays, information, _ITERATIONS)
    # Near to facing the camera there may be one minimum only, at which the refinement then arrives.
    if float(np.sum(other * start)) > float(np.sum(other * rotation)):
        cost = refined
    return 0.5 * math.erfc(math.sqrt(max(cost, 0.0) / 8.0))
