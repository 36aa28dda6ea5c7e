"""Where an LED's spot lies beside the image of the LED's centre, given the pose; refinement that takes it into account.

The shift is a function of the pose, and the pose is found from the shifted spots: predictor-corrector. The rays are
corrected by the shift at the pose at hand, the pose is refined on them, and again, until the shift stands still. A
step shrinks the error some thousandfold, since the shift hardly changes with the pose.

`spot_shifts` is the one place that knows the causes; what else moves an LED's spot with the direction it is seen from
belongs there, its constants into another column of ``optics``.

The LED's own optics (`protocol.led_offset`): its light seems to come from a point on its axis that moves along it with
the angle and the distance it is seen at; a rotation of the line of sight about the axis changes nothing.

Perspective: the image of a disc is an ellipse whose centre is not the image of the disc's centre. Source: the conic of
the disc's outline (centre C, radius r, normal n in the camera's frame) in closed form,
x_e = (X Z + r^2 n_x n_z) / (Z^2 - r^2 (1 - n_z^2)), y_e likewise. Shifts are in ideal rays while spots are centred
in the distorted image: right to first order in the distortion's change across a spot.
"""

import math

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import MOST_DOUBTS, MOST_KNOTS
from asterism.protocol.rig import Robot
from asterism.server.compiled import compiled
from asterism.server.pose.lens import project_point
from asterism.server.pose.planar import NO_SOLUTION, refine_pose

# Columns of `optics`, a row a robot: the radius of its LEDs' discs, m, 0 where the rig does not say; their axis in the
# plane's frame; how many values the axial shift has, 0 for none, and up to which angle, rad; the distance they hold at;
# how many functions it may be wrong by; the values, what they change by in a metre, and the functions, m.
DISC_RADIUS, AXIS, KNOTS, LIMIT, DISTANCE, DOUBTS, SHIFT = 0, 1, 4, 5, 6, 7, 8
PER_METRE = SHIFT + MOST_KNOTS
DOUBT = PER_METRE + MOST_KNOTS
OPTICS = DOUBT + MOST_DOUBTS * MOST_KNOTS
STANDS_STILL_PX = 1e-6
CORRECTIONS = 6


def optics_of(robot: Robot) -> Floats:
    """What shifts a robot's spots, as the row (OPTICS,) that the compiled code takes."""
    optics = np.zeros(OPTICS)
    optics[DISC_RADIUS] = robot.led_radius or 0.0
    offset = robot.led_offset
    if offset is not None:
        optics[AXIS : AXIS + 3] = robot.T_robot_plane.rotation.T @ robot.axis
        knots = len(offset.values)
        optics[KNOTS], optics[LIMIT], optics[DISTANCE] = knots, offset.up_to_rad, offset.distance_m
        optics[SHIFT : SHIFT + knots], optics[PER_METRE : PER_METRE + knots] = offset.values, offset.per_metre
        optics[DOUBTS] = len(offset.doubts)
        for row, doubt in enumerate(offset.doubts):
            optics[DOUBT + row * MOST_KNOTS :][:knots] = doubt
    return optics


@compiled
def has_shift(optics):
    """Whether anything shifts the spots of a robot at all."""
    return optics[DISC_RADIUS] > 0.0 or optics[KNOTS] > 0.0


@compiled
def has_offset(optics):
    """Whether the LEDs' own optics shift the spots of a robot."""
    return optics[KNOTS] > 0.0


@compiled
def along_axis(optics, first, angle):
    """The function of the angle, rad, whose values stand at column ``first``: `led_offset.knot_weights`, compiled."""
    knots = int(optics[KNOTS])
    if knots == 1:
        return optics[first]
    place = min(max(angle / optics[LIMIT], 0.0), 1.0) * (knots - 1)
    k = min(int(place), knots - 2)
    t = place - k
    b, c = optics[first + k], optics[first + k + 1]
    a = optics[first + k - 1] if k > 0 else optics[first + 1]
    d = optics[first + k + 2] if k + 2 < knots else 2.0 * c - b
    return b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))


@compiled
def spot_shifts(rotation, t, points, optics, shifts):
    """Fill ``shifts`` (n, 2), ideal rays: a spot's centre minus the image of its LED's centre.

    ``rotation`` (3, 3) and ``t`` (3,) are T_camera_plane, ``points`` (n, 3) the LEDs in the plane's frame, m, which lie
    flat in the plane.
    """
    shifts[:, :] = 0.0
    if not has_shift(optics):
        return
    offset = has_offset(optics)
    ax = ay = az = 0.0
    if offset:
        for j in range(3):
            ax += rotation[0, j] * optics[AXIS + j]
            ay += rotation[1, j] * optics[AXIS + j]
            az += rotation[2, j] * optics[AXIS + j]
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
        if offset:
            u, v = x / z, y / z
            dot = ax * x + ay * y + az * z
            away2 = x * x + y * y + z * z
            angle = math.asin(math.sqrt(max(1.0 - dot * dot / away2, 0.0)))
            along = along_axis(optics, SHIFT, angle)
            along += (math.sqrt(away2) - optics[DISTANCE]) * along_axis(optics, PER_METRE, angle)
            x, y, z = x + along * ax, y + along * ay, z + along * az
            shifts[k, 0] = x / z - u
            shifts[k, 1] = y / z - v
        per_area = radius2 / (z * z - radius2 * sine2)
        shifts[k, 0] += per_area * (nx * nz + x / z * sine2)
        shifts[k, 1] += per_area * (ny * nz + y / z * sine2)


@compiled
def correct_rays(rotation, t, lit, optics):
    """Correct the rays of the visible LEDs (`matched.Lit`) for the shifts at a pose, in place of those applied before.

    Returns the largest change, ray units.
    """
    if not has_shift(optics):
        return 0.0
    seen, applied = lit.seen, lit.applied
    shifts = np.empty((lit.points.shape[0], 2))
    spot_shifts(rotation, t, lit.points, optics, shifts)
    change = 0.0
    for k in range(shifts.shape[0]):
        for axis in range(2):
            change = max(change, abs(shifts[k, axis] - applied[k, axis]))
            seen[k, axis] -= shifts[k, axis] - applied[k, axis]
            applied[k, axis] = shifts[k, axis]
    return change


@compiled
def refine_shifted(rotation, t, lit, optics, focal, iterations):
    """`planar.refine_pose` with the spots' shifts at the pose that results; returns the robust cost.

    The rays of ``lit`` are left as the last correction made them.
    """
    correct_rays(rotation, t, lit, optics)
    cost = refine_pose(rotation, t, lit.points, lit.seen, lit.information, iterations)
    if not has_shift(optics):
        return cost
    for _ in range(CORRECTIONS):
        if cost >= NO_SOLUTION or correct_rays(rotation, t, lit, optics) * focal < STANDS_STILL_PX:
            break
        cost = refine_pose(rotation, t, lit.points, lit.seen, lit.information, iterations)
    return cost


@compiled
def spots_at(lens, layouts, optics, rotations, ts, pixels):
    """Fill ``pixels`` (n, 6, 2): where the spots of robots lie.

    ``lens`` as in `lens`, ``layouts`` (n, 6, 3) m in the plane's frame, ``optics`` (n, OPTICS) as in `spot_shift`,
    ``rotations`` (n, 3, 3) and ``ts`` (n, 3) T_camera_plane.
    """
    shifts = np.empty((layouts.shape[1], 2))
    for k in range(layouts.shape[0]):
        spot_shifts(rotations[k], ts[k], layouts[k], optics[k], shifts)
        for led in range(layouts.shape[1]):
            x, y, z = ts[k, 0], ts[k, 1], ts[k, 2]
            for j in range(3):
                x += rotations[k, 0, j] * layouts[k, led, j]
                y += rotations[k, 1, j] * layouts[k, led, j]
                z += rotations[k, 2, j] * layouts[k, led, j]
            u, v = project_point(lens, x + shifts[led, 0] * z, y + shifts[led, 1] * z, z)
            pixels[k, led, 0], pixels[k, led, 1] = u, v
