"""Where an LED's spot lies beside the image of the LED's centre, given the pose; refinement that takes it into account.

The shift is a function of the pose, and the pose is found from the shifted spots: predictor-corrector. The rays are
corrected by the shift at the pose at hand, the pose is refined on them, and again, until the shift stands still. A
step shrinks the error some thousandfold, since the shift hardly changes with the pose.

`spot_shifts` is the one place that knows the causes; what else moves an LED's spot with the direction it is seen from
belongs there, its constants into another column of ``optics``.

Perspective: the image of a disc is an ellipse whose centre is not the image of the disc's centre. Source: the conic of
the disc's outline (centre C, radius r, normal n in the camera's frame) in closed form,
x_e = (X Z + r^2 n_x n_z) / (Z^2 - r^2 (1 - n_z^2)), y_e likewise. Shifts are in ideal rays while spots are centred
in the distorted image: right to first order in the distortion's change across a spot.
"""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Robot
from asterism.server.compiled import compiled
from asterism.server.planar import NO_SOLUTION, refine_pose

# Columns of `optics`, a row a robot: the radius of its LEDs' discs, m, 0 where the rig does not say.
DISC_RADIUS = 0
OPTICS = 1
STANDS_STILL_PX = 1e-6
CORRECTIONS = 6


def optics_of(robot: Robot) -> Floats:
    """What shifts a robot's spots, as the row (OPTICS,) that the compiled code takes."""
    optics = np.zeros(OPTICS)
    optics[DISC_RADIUS] = robot.led_radius or 0.0
    return optics


@compiled
def has_shift(optics):
    """Whether anything shifts the spots of a robot at all."""
    return optics[DISC_RADIUS] > 0.0


@compiled
def spot_shifts(rotation, t, points, optics, shifts):
    """Fill ``shifts`` (n, 2), ideal rays: a spot's centre minus the image of its LED's centre.

    ``rotation`` (3, 3) and ``t`` (3,) are T_camera_plane, ``points`` (n, 3) the LEDs in the plane's frame, m, which lie
    flat in the plane.
    """
    shifts[:, :] = 0.0
    if not has_shift(optics):
        return
    radius2 = optics[DISC_RADIUS] ** 2
    nx, ny, nz = rotation[0, 2], rotation[1, 2], rotation[2, 2]
    sine2 = 1.0 - nz * nz
    for k in range(points.shape[0]):
        x, y, z = t[0], t[1], t[2]
        for j in range(3):
            x += rotation[0, j] * points[k, j]
            y += rotation[1, j] * points[k, j]
            z += rotation[2, j] * points[k, j]
        if not z > 2.0 * optics[DISC_RADIUS]:
            continue
        per_area = radius2 / (z * z - radius2 * sine2)
        shifts[k, 0] = per_area * (nx * nz + x / z * sine2)
        shifts[k, 1] = per_area * (ny * nz + y / z * sine2)


@compiled
def correct_rays(rotation, t, points, optics, seen, applied):
    """Correct ``seen`` (n, 2) for the shifts at a pose, in place of those ``applied`` (n, 2) before.

    Returns the largest change, ray units.
    """
    if not has_shift(optics):
        return 0.0
    shifts = np.empty((points.shape[0], 2))
    spot_shifts(rotation, t, points, optics, shifts)
    change = 0.0
    for k in range(points.shape[0]):
        for axis in range(2):
            change = max(change, abs(shifts[k, axis] - applied[k, axis]))
            seen[k, axis] -= shifts[k, axis] - applied[k, axis]
            applied[k, axis] = shifts[k, axis]
    return change


@compiled
def refine_shifted(rotation, t, points, seen, applied, information, optics, focal, iterations):
    """`planar.refine_pose` with the spots' shifts at the pose that results; returns the robust cost.

    ``seen`` and ``applied`` as in `correct_rays` are left as the last correction made them.
    """
    correct_rays(rotation, t, points, optics, seen, applied)
    cost = refine_pose(rotation, t, points, seen, information, iterations)
    if not has_shift(optics):
        return cost
    for _ in range(CORRECTIONS):
        if cost >= NO_SOLUTION or correct_rays(rotation, t, points, optics, seen, applied) * focal < STANDS_STILL_PX:
            break
        cost = refine_pose(rotation, t, points, seen, information, iterations)
    return cost
