"""Rays of several cameras that see one robot: where they should be, and how they change with its pose, compiled.

Motion: what `follow` knew before any of the rays, whose errors are then none of theirs: rates, how these change, and
white jerk since. Rays whose spots are shifted (`spot_shift`) are compared with where the shifted spots would be.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.pose.fit import LEDS
from asterism.server.pose.rotations import exp_into, mapped, product_into
from asterism.server.pose.spot_shift import has_shift, spot_shifts

WHITE = 8  # six derivatives, a residual and a zero: a number that fills a processor's registers


class Eyes(NamedTuple):
    """c cameras: T_camera_world, ``rotations`` (c, 3, 3) and ``ts`` (c, 3) m; where they stand in the world,
    ``origins`` (c, 3) m, with ``places`` (c, 6, 6), covariances about the world's axes, m and rad.
    """

    rotations: Floats
    ts: Floats
    origins: Floats
    places: Floats


class Bodies(NamedTuple):
    """r robots: T_robot_plane, ``rotations`` (r, 3, 3) and ``ts`` (r, 3); ``layouts`` (r, 6, 3) m of the LEDs in the
    plane's frame; by camera and robot what shifts spots, ``optics`` (c, r, OPTICS) as in `spot_shift`.
    """

    rotations: Floats
    ts: Floats
    layouts: Floats
    optics: Floats


class Motion(NamedTuple):
    """How m robots move, as known ``ages`` (m,) s before the exposure: ``rates`` (m, 12), velocity and turn, and how
    these change, m, rad and s about the world's axes; their ``covariances`` (m, 12, 12), and ``densities`` (m, 6) of
    white jerk since, m^2/s^5 and rad^2/s^5.
    """

    ages: Floats
    rates: Floats
    covariances: Floats
    densities: Floats


class Bundle(NamedTuple):
    """Rays of m robots: of robot k those from ``first[k]`` to ``first[k + 1]`` of ``rays`` (n, 2) with their own
    ``covariances`` (n, 3), ``cameras`` (n,), ``leds`` (n,), and ``times`` (n,) s after the exposure that is solved for.
    ``bodies`` (m,) are rows of the `Bodies`, ``misfits`` (m,) how far off the rig has their LEDs, one sigma, m.
    """

    first: NDArray[np.int64]
    rays: Floats
    covariances: Floats
    cameras: NDArray[np.int64]
    leds: NDArray[np.int64]
    times: Floats
    bodies: NDArray[np.int64]
    misfits: Floats


class Poses(NamedTuple):
    """Poses of m robots, T_world_robot: ``rotations`` (m, 3, 3) and ``ts`` (m, 3) m, starts first, then what is solved;
    ``costs`` (m,) are chi squared of all residuals, NO_SOLUTION where there is no pose, and ``logdets`` (m,) the
    logarithms of the determinants of the rays' covariance and of the pose's information; ``covariances`` (m, 6, 6) m
    and rad about the world's axes; ``residuals`` (n, 2), rays, observed minus predicted.
    """

    rotations: Floats
    ts: Floats
    costs: Floats
    logdets: Floats
    covariances: Floats
    residuals: Floats

    @staticmethod
    def room(robots: int, rays: int) -> "Poses":
        """Room for so many."""
        m = robots
        return Poses(
            np.empty((m, 3, 3)), np.empty((m, 3)), np.empty(m), np.empty(m), np.empty((m, 6, 6)), np.empty((rays, 2))
        )  # fmt: skip


class Work(NamedTuple):
    """Scratch for a robot of n rays: their derivatives ``by_pose`` (n, 2, 6) by a move of the robot, ``by_place``
    (n, 2, 6) by one of the camera, ``by_led`` (n, 2, 3); ``off`` (n, 2); the ``factor`` of their covariance (2 n, 2 n),
    and ``white`` (2 n, WHITE), by columns derivatives and residuals divided by it, and zeros.
    """

    by_pose: Floats
    by_place: Floats
    by_led: Floats
    off: Floats
    factor: Floats
    white: Floats


@compiled
def work_room(n):
    """Scratch for n rays."""
    return Work(
        np.empty((n, 2, 6)), np.empty((n, 2, 6)), np.empty((n, 2, 3)), np.empty((n, 2)), np.empty((2 * n, 2 * n)),
        np.zeros((2 * n, WHITE)),
    )  # fmt: skip


@compiled
def _both(first, second):
    """Covariance of where white jerk of density one has brought a robot at two times, s, since it was zero."""
    a = max(min(first, second), 0.0)
    apart = abs(first - second)
    return a * a * a * (a * a / 20.0 + apart * a / 8.0 + apart * apart / 12.0)


@compiled
def shared_motion(first, second, age):
    """Covariance of how far white jerk of density one has brought a robot from where it is ``age`` s later, at two
    times, s, from then.
    """
    a, b = age + first, age + second
    return _both(a, b) - _both(a, age) - _both(age, b) + _both(age, age)


@compiled
def way_by_change(time, age):
    """What a change of rates by one does to the way from now on to that time."""
    return 0.5 * ((age + time) ** 2 - age * age)


@compiled
def _moved(rotation, t, rates, time, age, out, out_t):
    """Fill ``out`` (3, 3), ``out_t`` (3,): the pose ``time`` s later."""
    turn, change = np.empty((3, 3)), way_by_change(time, age)
    for i in range(3):
        out_t[i] = t[i] + time * rates[i] + change * rates[6 + i]
    x, y, z = time * rates[3], time * rates[4], time * rates[5]
    exp_into(x + change * rates[9], y + change * rates[10], z + change * rates[11], turn)
    product_into(turn, rotation, out)


@compiled
def linearize(k, pose, eyes, bodies, bundle, motion, work, derive):
    """Fill the ``work`` of robot k of the bundle at a ``pose``, (3, 3) and (3,): residuals, and where ``derive``,
    derivatives. Returns whether all its LEDs lie before their cameras.
    """
    rotation, t = pose
    begin, body, rates = bundle.first[k], bundle.bodies[k], motion.rates[k]
    there, there_t, plane, turned = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    plane_t, shifts = np.empty(3), np.zeros((LEDS, 2))
    camera_before, time_before = -1, math.inf
    for i in range(begin, bundle.first[k + 1]):
        row, camera, time, led = i - begin, bundle.cameras[i], bundle.times[i], bundle.leds[i]
        if time != time_before or camera != camera_before:
            _moved(rotation, t, rates, time, motion.ages[k], there, there_t)
            product_into(there, bodies.rotations[body], turned)
            view = eyes.rotations[camera]
            product_into(view, turned, plane)
            x, y, z = mapped(there, there_t, bodies.ts[body])
            for j in range(3):
                plane_t[j] = view[j, 0] * x + view[j, 1] * y + view[j, 2] * z + eyes.ts[camera, j]
            if has_shift(bodies.optics[camera, body]):
                spot_shifts(plane, plane_t, bodies.layouts[body], bodies.optics[camera, body], shifts)
            else:
                shifts[:, :] = 0.0
            camera_before, time_before = camera, time
        x, y, z = mapped(plane, plane_t, bodies.layouts[body, led])
        if not z > 0.0:
            return False
        u, v = x / z, y / z
        work.off[row, 0] = bundle.rays[i, 0] - u - shifts[led, 0]
        work.off[row, 1] = bundle.rays[i, 1] - v - shifts[led, 1]
        if not derive:
            continue
        # The LED in the world, from the robot's origin and from the camera.
        away_x = turned[0, 0] * bodies.layouts[body, led, 0] + turned[0, 1] * bodies.layouts[body, led, 1]
        away_y = turned[1, 0] * bodies.layouts[body, led, 0] + turned[1, 1] * bodies.layouts[body, led, 1]
        away_z = turned[2, 0] * bodies.layouts[body, led, 0] + turned[2, 1] * bodies.layouts[body, led, 1]
        away_x += turned[0, 2] * bodies.layouts[body, led, 2]
        away_y += turned[1, 2] * bodies.layouts[body, led, 2]
        away_z += turned[2, 2] * bodies.layouts[body, led, 2]
        offset = bodies.ts[body]
        arm_x = away_x + there[0, 0] * offset[0] + there[0, 1] * offset[1] + there[0, 2] * offset[2]
        arm_y = away_y + there[1, 0] * offset[0] + there[1, 1] * offset[1] + there[1, 2] * offset[2]
        arm_z = away_z + there[2, 0] * offset[0] + there[2, 1] * offset[1] + there[2, 2] * offset[2]
        far_x = arm_x + there_t[0] - eyes.origins[camera, 0]
        far_y = arm_y + there_t[1] - eyes.origins[camera, 1]
        far_z = arm_z + there_t[2] - eyes.origins[camera, 2]
        for axis in range(2):
            w = u if axis == 0 else v
            a = (view[axis, 0] - w * view[2, 0]) / z
            b = (view[axis, 1] - w * view[2, 1]) / z
            c = (view[axis, 2] - w * view[2, 2]) / z
            # By a turn about the world's axes: d = turn x arm.
            move, place = work.by_pose[row, axis], work.by_place[row, axis]
            move[0], move[1], move[2] = a, b, c
            move[3], move[4], move[5] = c * arm_y - b * arm_z, a * arm_z - c * arm_x, b * arm_x - a * arm_y
            place[0], place[1], place[2] = -a, -b, -c
            place[3], place[4], place[5] = b * far_z - c * far_y, c * far_x - a * far_z, a * far_y - b * far_x
            for j in range(3):
                work.by_led[row, axis, j] = a * there[0, j] + b * there[1, j] + c * there[2, j]
    return True


@compiled
def residuals_at(eyes, bodies, bundle, motion, poses):
    """Fill the residuals of the `Poses` as they stand."""
    for k in range(bundle.bodies.shape[0]):
        begin, end = bundle.first[k], bundle.first[k + 1]
        work = work_room(end - begin)
        linearize(k, (poses.rotations[k], poses.ts[k]), eyes, bodies, bundle, motion, work, False)
        for i in range(begin, end):
            poses.residuals[i, 0], poses.residuals[i, 1] = work.off[i - begin, 0], work.off[i - begin, 1]
