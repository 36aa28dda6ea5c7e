"""A robot as several cameras see it: where a pose puts its LEDs, and the pose that its spots in all of them tell.

Everything that one camera's spots have in common beyond their own noise - that the camera's place is not exactly
known, that the robot moved between the exposures - counts as a shift of the robot's pose as that camera saw it, with a
covariance Q. With the spots' information M = J' R^-1 J about that pose, what they tell of the robot's own pose is
(M^-1 + Q)^-1 = (I + M Q)^-1 M. Poses are T_world_plane: of the LEDs' plane. Their errors are translations, m, and
rotations, rad, about the world's axes.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.centres.blobs import Ints
from asterism.server.compiled import compiled
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import project_point
from asterism.server.pose.planar import NO_SOLUTION, cholesky_solve
from asterism.server.pose.rotations import exp_into, log_between, product_into
from asterism.server.pose.spot_shift import spot_shifts

EDGE_PX = 3.0  # an LED nearer to the image's edge than this may have no spot
HOLDS_STILL = 1e-4  # m and rad: a step that is smaller is the last


class Scene(NamedTuple):
    """The frames of C cameras: T_camera_world as ``turns`` (C, 3, 3) and ``origins`` (C, 3) of the cameras in the
    world, m; ``places`` (C, 6, 6) how well these are known; ``lenses`` (C, 13), ``sizes`` (C, 2) px.

    Of camera c are the spots ``first[c]`` to ``first[c + 1]``: ``rays`` (n, 2) with ``covariances`` (n, 3).
    """

    turns: Floats
    origins: Floats
    places: Floats
    lenses: Floats
    sizes: Floats
    first: Ints
    rays: Floats
    covariances: Floats


class Body(NamedTuple):
    """A robot: ``layout`` (6, 3) m in its LEDs' plane; by camera its ``optics`` (C, OPTICS) as in `spot_shift`; and how
    far its spots may be off beyond their own noise, one sigma: ``misfit`` m at the robot, and ``systematic`` (C,) in
    rays of each camera.
    """

    layout: Floats
    optics: Floats
    misfit: float
    systematic: Floats


class Course(NamedTuple):
    """How a robot moves from the time of its pose to each camera's exposure: ``turns`` (C, 3, 3) about the world's
    axes, ``shifts`` (C, 3) m; and what is not known of that, one sigma: ``drifts`` (C, 2) m and rad.
    """

    turns: Floats
    shifts: Floats
    drifts: Floats


class Room(NamedTuple):
    """How all cameras see a pose: ``rays`` (C, 6, 2) of the LEDs, nan behind the camera, ``jacobians`` (C, 6, 2, 6),
    ``visible`` (C, 6): in the image and facing it; ``depths`` (C, 6) m. What the labelled spots tell: ``own``
    (C, 6, 6) of the pose as the camera saw it, ``shared`` (C, 6, 6) of the robot's own, ``doubts`` (C, 6, 6) is Q.
    """

    rays: Floats
    jacobians: Floats
    visible: Floats
    depths: Floats
    own: Floats
    shared: Floats
    doubts: Floats


class State(NamedTuple):
    """A pose, ``rotation`` (3, 3) and ``t`` (3,), and the ``information`` (6, 6) on it."""

    rotation: Floats
    t: Floats
    information: Floats


def room_for(cameras: int) -> Room:
    """Room for so many cameras."""
    n = cameras
    return Room(
        np.zeros((n, LEDS, 2)),
        np.zeros((n, LEDS, 2, 6)),
        np.zeros((n, LEDS)),
        np.zeros((n, LEDS)),
        np.zeros((n, 6, 6)),
        np.zeros((n, 6, 6)),
        np.zeros((n, 6, 6)),
    )


@compiled
def solve_general(a, b):
    """Solve a x = b for square a (n, n) and b (n, m) in place, b becomes x: Gauss with pivots of a column."""
    n, m = a.shape[0], b.shape[1]
    for j in range(n):
        pivot = j
        for i in range(j + 1, n):
            if abs(a[i, j]) > abs(a[pivot, j]):
                pivot = i
        if pivot != j:
            for k in range(n):
                a[j, k], a[pivot, k] = a[pivot, k], a[j, k]
            for k in range(m):
                b[j, k], b[pivot, k] = b[pivot, k], b[j, k]
        per = 1.0 / a[j, j]
        for i in range(j + 1, n):
            factor = a[i, j] * per
            if factor == 0.0:
                continue
            for k in range(j, n):
                a[i, k] -= factor * a[j, k]
            for k in range(m):
                b[i, k] -= factor * b[j, k]
    for k in range(m):
        for i in range(n - 1, -1, -1):
            total = b[i, k]
            for j in range(i + 1, n):
                total -= a[i, j] * b[j, k]
            b[i, k] = total / a[i, i]


@compiled
def see(scene, body, course, rotation, t, room):
    """Fill the room's rays, jacobians, visible, depths and doubts for a pose of the robot."""
    shifts = np.empty((LEDS, 2))
    moved, seen, at, t_camera = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    arm, point = np.empty(3), np.empty(3)
    for c in range(scene.turns.shape[0]):
        turn = scene.turns[c]
        product_into(course.turns[c], rotation, moved)
        product_into(turn, moved, seen)
        for i in range(3):
            at[i] = t[i] + course.shifts[c, i]
        for i in range(3):
            t_camera[i] = 0.0
            for j in range(3):
                t_camera[i] += turn[i, j] * (at[j] - scene.origins[c, j])
        spot_shifts(seen, t_camera, body.layout, body.optics[c], shifts)
        facing = -(seen[0, 2] * t_camera[0] + seen[1, 2] * t_camera[1] + seen[2, 2] * t_camera[2])
        away = math.sqrt(t_camera[0] ** 2 + t_camera[1] ** 2 + t_camera[2] ** 2)
        for led in range(LEDS):
            for i in range(3):
                arm[i] = 0.0
                for j in range(3):
                    arm[i] += moved[i, j] * body.layout[led, j]
            for i in range(3):
                point[i] = t_camera[i]
                for j in range(3):
                    point[i] += turn[i, j] * arm[j]
            z = point[2]
            room.depths[c, led] = z
            room.visible[c, led] = 0.0
            if not z > 1e-3:
                room.rays[c, led, 0] = room.rays[c, led, 1] = np.nan
                continue
            x, y = point[0] / z, point[1] / z
            room.rays[c, led, 0], room.rays[c, led, 1] = x + shifts[led, 0], y + shifts[led, 1]
            jacobian = room.jacobians[c, led]
            for i in range(3):
                jacobian[0, i] = (turn[0, i] - x * turn[2, i]) / z
                jacobian[1, i] = (turn[1, i] - y * turn[2, i]) / z
            for row in range(2):
                # d(point) = d(theta) x arm: the row times the cross product is the arm times the row, crossed.
                jacobian[row, 3] = arm[1] * jacobian[row, 2] - arm[2] * jacobian[row, 1]
                jacobian[row, 4] = arm[2] * jacobian[row, 0] - arm[0] * jacobian[row, 2]
                jacobian[row, 5] = arm[0] * jacobian[row, 1] - arm[1] * jacobian[row, 0]
            u, v = project_point(scene.lenses[c], point[0], point[1], z)
            inside = EDGE_PX <= u <= scene.sizes[c, 0] - EDGE_PX and EDGE_PX <= v <= scene.sizes[c, 1] - EDGE_PX
            if inside and facing > 0.25 * away:
                room.visible[c, led] = 1.0
        _fill_doubt(scene, course, c, at, room.doubts[c])


@compiled
def _fill_doubt(scene, course, c, at, doubt):
    """Fill ``doubt`` (6, 6): the place of camera c and the motion since, as a covariance of the robot's pose there."""
    place = scene.places[c]
    doubt[:, :] = 0.0
    some = False
    for i in range(6):
        some |= place[i, i] > 0.0
    if some:
        # A camera that is off by o and turned by f sees the robot off by -o - f x (at - origin), and turned by -f.
        a, b, d = at[0] - scene.origins[c, 0], at[1] - scene.origins[c, 1], at[2] - scene.origins[c, 2]
        lever = np.zeros((6, 6))
        for i in range(6):
            lever[i, i] = -1.0
        lever[0, 4], lever[0, 5] = -d, b
        lever[1, 3], lever[1, 5] = d, -a
        lever[2, 3], lever[2, 4] = -b, a
        for i in range(6):
            for j in range(6):
                total = 0.0
                for k in range(6):
                    for m in range(6):
                        total += lever[i, k] * place[k, m] * lever[j, m]
                doubt[i, j] = total
    for i in range(3):
        doubt[i, i] += course.drifts[c, 0] ** 2
        doubt[3 + i, 3 + i] += course.drifts[c, 1] ** 2


@compiled
def noise_of(scene, body, c, spot, depth):
    """The covariance of a spot of camera c as the LED of a robot so far away: xx, xy, yy."""
    more = body.systematic[c] ** 2 + (body.misfit / depth) ** 2
    covariance = scene.covariances[spot]
    return covariance[0] + more, covariance[1], covariance[2] + more


@compiled
def _sum_up(scene, body, c, labels, room, pull):
    """Sums over the labelled spots of camera c: fills the room's ``own`` and ``pull`` (6,) = J' R^-1 r; returns chi
    squared and the count.
    """
    own = room.own[c]
    own[:, :] = 0.0
    pull[:] = 0.0
    chi2, count = 0.0, 0
    for led in range(LEDS):
        spot = labels[led]
        if spot < 0:
            continue
        if not room.depths[c, led] > 1e-3:
            return NO_SOLUTION, count
        xx, xy, yy = noise_of(scene, body, c, spot, room.depths[c, led])
        per = 1.0 / (xx * yy - xy * xy)
        wxx, wxy, wyy = yy * per, -xy * per, xx * per
        rx, ry = scene.rays[spot, 0] - room.rays[c, led, 0], scene.rays[spot, 1] - room.rays[c, led, 1]
        jacobian = room.jacobians[c, led]
        for i in range(6):
            wx = wxx * jacobian[0, i] + wxy * jacobian[1, i]
            wy = wxy * jacobian[0, i] + wyy * jacobian[1, i]
            pull[i] += wx * rx + wy * ry
            for j in range(i + 1):
                own[i, j] += wx * jacobian[0, j] + wy * jacobian[1, j]
        chi2 += wxx * rx * rx + 2.0 * wxy * rx * ry + wyy * ry * ry
        count += 1
    for i in range(6):
        for j in range(i):
            own[j, i] = own[i, j]
    return chi2, count


@compiled
def _share(own, doubt, pull, shared):
    """What spots tell of the robot's own pose, beyond the ``doubt`` they have in common: fills ``shared`` (6, 6), and
    changes ``pull`` (6,) likewise; returns by how much chi squared is less.
    """
    some = False
    for i in range(6):
        some |= doubt[i, i] > 0.0
    if not some:
        shared[:, :] = own
        return 0.0
    a, b = np.empty((6, 6)), np.empty((6, 7))
    for i in range(6):
        for j in range(6):
            total = 1.0 if i == j else 0.0
            for k in range(6):
                total += own[i, k] * doubt[k, j]
            a[i, j] = total
            b[i, j] = own[i, j]
        b[i, 6] = pull[i]
    solve_general(a, b)
    less = 0.0
    for i in range(6):
        for j in range(6):
            less += pull[i] * doubt[i, j] * b[j, 6]
    for i in range(6):
        for j in range(6):
            shared[i, j] = 0.5 * (b[i, j] + b[j, i])
    for i in range(6):
        pull[i] = b[i, 6]
    return less


@compiled
def fit(scene, body, course, labels, prior, state, steps, room):
    """The pose that the spots ``labels`` (C, 6) of all cameras tell, from ``state`` on, into it, by Gauss and Newton.

    ``prior`` (`State`) is what was known, with information 0 where nothing was. Returns chi squared, without that of
    the prior, and the count of spots; NO_SOLUTION where there is no pose. The room is filled as of the pose.
    """
    cameras = scene.turns.shape[0]
    pull, total, away, turn, turned = np.empty(6), np.empty(6), np.empty(6), np.empty((3, 3)), np.empty((3, 3))
    normal = np.empty((6, 6))
    chi2, count = NO_SOLUTION, 0
    for step in range(steps + 1):
        see(scene, body, course, state.rotation, state.t, room)
        for i in range(3):
            away[i] = prior.t[i] - state.t[i]
        log_between(state.rotation, prior.rotation, away[3:])
        for i in range(6):
            total[i] = 0.0
            for j in range(6):
                normal[i, j] = prior.information[i, j]
                total[i] += prior.information[i, j] * away[j]
        chi2, count = 0.0, 0
        for c in range(cameras):
            own2, seen = _sum_up(scene, body, c, labels[c], room, pull)
            if own2 >= NO_SOLUTION:
                return NO_SOLUTION, count
            if seen == 0:
                room.shared[c, :, :] = 0.0
                continue
            chi2 += own2 - _share(room.own[c], room.doubts[c], pull, room.shared[c])
            count += seen
            for i in range(6):
                total[i] += pull[i]
                for j in range(6):
                    normal[i, j] += room.shared[c, i, j]
        state.information[:, :] = normal
        if step == steps:
            break
        for i in range(6):
            normal[i, i] += 1e-9 * normal[i, i] + 1e-6
        if not cholesky_solve(normal, total):
            return NO_SOLUTION, count
        length = 0.0
        for i in range(3):
            length = max(length, abs(total[i]), abs(total[3 + i]))
        if not length < 1e3:
            return NO_SOLUTION, count
        # A step of more than half a radian leads anywhere.
        shorter = min(1.0, 0.5 / max(length, 1e-12))
        for i in range(3):
            state.t[i] += shorter * total[i]
        exp_into(shorter * total[3], shorter * total[4], shorter * total[5], turn)
        product_into(turn, state.rotation, turned)
        state.rotation[:, :] = turned
        if length < HOLDS_STILL:
            steps = step + 1
    return chi2, count
