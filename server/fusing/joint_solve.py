"""One robot, rays of several cameras: its pose in the world by generalised least squares, compiled.

Every ray has its own noise, and shares errors with others: with all rays of its camera where the camera's place is not
exactly known; with all rays of its LED where the rig has that LED wrong; with all rays of other times what is not known
of the robot's motion. So the covariance of all rays together is

    S_ij = [i = j] R_i + [same camera] J_i P_c J_j' + [same LED] s^2 G_i G_j' + J_i M(t_i, t_j) J_j' + sum_d u_id u_jd'

with J the ray's derivatives by a rigid move, of the robot or its camera, P_c the covariance of the camera's place, G
those by the LED's place, M the motion's covariance between two times and u what is not known of the LEDs' light. It is
factorised once, S = L L', and the whitened residuals are minimised over six numbers (Levenberg, Marquardt). Rays whose
spots are shifted (`spot_shift`) are compared with where the shifted spots would be.

Motion: what `follow` knew before any of the rays, whose errors are then none of theirs: rates, how these change, and
white jerk since.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import MOST_KNOTS
from asterism.server.compiled import compiled
from asterism.server.pose.covariance import invert
from asterism.server.pose.fit import LEDS
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.rotations import exp_into, mapped, product_into
from asterism.server.pose.spot_shift import AXIS, DOUBT, DOUBTS, along_axis, has_shift, spot_shifts

STEPS = 12
STILL = 1e-9  # m and rad: a step that is none
NEAR = 1e-6  # m and rad: a step after which the next one would be none
FAR = 5e-3  # m and rad: from there on rays share other errors than where the start was
AGAIN = 4  # times that the covariance is made anew at most


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
    and rad about the world's axes, and the part of them that is ``noise`` of spots (m, 6, 6), new in every frame;
    ``residuals`` (n, 2), rays, observed minus predicted.
    """

    rotations: Floats
    ts: Floats
    costs: Floats
    logdets: Floats
    covariances: Floats
    noise: Floats
    residuals: Floats

    @staticmethod
    def room(robots: int, rays: int) -> "Poses":
        """Room for so many."""
        m = robots
        return Poses(
            np.empty((m, 3, 3)), np.empty((m, 3)), np.empty(m), np.empty(m), np.empty((m, 6, 6)), np.empty((m, 6, 6)),
            np.empty((rays, 2)),
        )  # fmt: skip


class Work(NamedTuple):
    """Scratch for a robot of n rays: their derivatives ``by_pose`` (n, 2, 6) by a move of the robot, ``by_place``
    (n, 2, 6) by one of the camera, ``by_led`` (n, 2, 3); ``off`` (n, 2); the factor of their covariance (2 n, 2 n), and
    ``white`` (2 n, 7), derivatives and residuals divided by it.
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
        np.empty((2 * n, 7)),
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
def _quadratic(time, age):
    """What a change of rates by one does to the way from now on to that time."""
    return 0.5 * ((age + time) ** 2 - age * age)


@compiled
def _moved(rotation, t, rates, time, age, out, out_t):
    """Fill ``out`` (3, 3), ``out_t`` (3,): the pose ``time`` s later."""
    turn, change = np.empty((3, 3)), _quadratic(time, age)
    for i in range(3):
        out_t[i] = t[i] + time * rates[i] + change * rates[6 + i]
    x, y, z = time * rates[3], time * rates[4], time * rates[5]
    exp_into(x + change * rates[9], y + change * rates[10], z + change * rates[11], turn)
    product_into(turn, rotation, out)


@compiled
def linearize(k, rotation, t, eyes, bodies, bundle, motion, work, derive):
    """Fill the ``work`` of robot k of the bundle: residuals, and where ``derive``, derivatives. Returns whether all its
    LEDs lie before their cameras.
    """
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
def _add(total, left, right, share):
    """Add ``share`` (a number) times left (2, d) right' (2, d) to a block (2, 2)."""
    for a in range(2):
        for b in range(2):
            value = 0.0
            for j in range(left.shape[1]):
                value += left[a, j] * right[b, j]
            total[a, b] += share * value


@compiled
def _doubts(k, rotation, t, eyes, bodies, bundle, work, shifts):
    """Fill ``shifts`` (n, 2, d), rays: what each thing that is not known of the LEDs' light does to every ray."""
    begin, body = bundle.first[k], bundle.bodies[k]
    turned, axis = np.empty((3, 3)), np.empty(3)
    product_into(rotation, bodies.rotations[body], turned)
    shifts[:, :, :] = 0.0
    for i in range(begin, bundle.first[k + 1]):
        camera, led, row = bundle.cameras[i], bundle.leds[i], i - begin
        optics = bodies.optics[camera, body]
        dot = away2 = 0.0
        x, y, z = mapped(turned, t, bodies.layouts[body, led])
        sight = (x - eyes.origins[camera, 0], y - eyes.origins[camera, 1], z - eyes.origins[camera, 2])
        for j in range(3):
            axis[j] = turned[j, 0] * optics[AXIS] + turned[j, 1] * optics[AXIS + 1] + turned[j, 2] * optics[AXIS + 2]
            dot += axis[j] * sight[j]
            away2 += sight[j] * sight[j]
        angle = math.asin(math.sqrt(min(max(1.0 - dot * dot / away2, 0.0), 1.0)))
        for d in range(int(optics[DOUBTS])):
            along = along_axis(optics, DOUBT + d * MOST_KNOTS, angle)
            for a in range(2):
                for j in range(3):
                    shifts[row, a, d] += along * work.by_pose[row, a, j] * axis[j]


@compiled
def _most_doubts(k, bodies, bundle):
    """How many things are not known of the light of robot k's LEDs, of the camera that knows the most of them."""
    most = 0
    for i in range(bundle.first[k], bundle.first[k + 1]):
        most = max(most, int(bodies.optics[bundle.cameras[i], bundle.bodies[k], DOUBTS]))
    return most


@compiled
def fill_covariance(k, rotation, t, eyes, bodies, bundle, motion, work):
    """Fill the lower triangle of the work's ``factor`` with the covariance of all rays of robot k, by the derivatives
    there at that pose.
    """
    begin = bundle.first[k]
    n = bundle.first[k + 1] - begin
    misfit2 = bundle.misfits[k] ** 2
    placed, rated, risen = np.empty((2, 6)), np.empty((2, 6)), np.empty((2, 6))
    age, swayed, block = motion.ages[k], np.empty((2, 6)), np.empty((2, 2))
    rates = motion.covariances[k]
    lights = _most_doubts(k, bodies, bundle)
    light = np.empty((n, 2, max(lights, 1)))
    if lights:
        _doubts(k, rotation, t, eyes, bodies, bundle, work, light)
    for i in range(n):
        camera, time = bundle.cameras[begin + i], bundle.times[begin + i]
        change = _quadratic(time, age)
        for a in range(2):
            for j in range(6):
                placed[a, j] = rated[a, j] = risen[a, j] = 0.0
                swayed[a, j] = work.by_pose[i, a, j] * motion.densities[k, j]
                for h in range(6):
                    placed[a, j] += work.by_place[i, a, h] * eyes.places[camera, h, j]
                    if time != 0.0:
                        move = work.by_pose[i, a, h]
                        rated[a, j] += move * (time * rates[h, j] + change * rates[6 + h, j])
                        risen[a, j] += move * (time * rates[h, 6 + j] + change * rates[6 + h, 6 + j])
        for m in range(i + 1):
            other = bundle.times[begin + m]
            block[:, :] = 0.0
            if bundle.cameras[begin + m] == camera:
                _add(block, placed, work.by_place[m], 1.0)
            if misfit2 > 0.0 and bundle.leds[begin + m] == bundle.leds[begin + i]:
                _add(block, work.by_led[i], work.by_led[m], misfit2)
            if time * other != 0.0:
                _add(block, rated, work.by_pose[m], other)
                _add(block, risen, work.by_pose[m], _quadratic(other, age))
                _add(block, swayed, work.by_pose[m], shared_motion(time, other, age))
            if lights:
                _add(block, light[i], light[m], 1.0)
            if m == i:
                own = bundle.covariances[begin + i]
                block[0, 0] += own[0]
                block[0, 1] += own[1]
                block[1, 0] += own[1]
                block[1, 1] += own[2]
            for a in range(2):
                for b in range(2):
                    work.factor[2 * i + a, 2 * m + b] = block[a, b]


@compiled
def factorize(a, size):
    """The lower triangle of the symmetric ``a`` becomes its Cholesky factor, with one over the diagonal; whether it
    has one.
    """
    for j in range(size):
        for i in range(j):
            total = a[j, i]
            for h in range(i):
                total -= a[j, h] * a[i, h]
            a[j, i] = total * a[i, i]
        total = a[j, j]
        for h in range(j):
            total -= a[j, h] * a[j, h]
        if not total > 0.0:
            return False
        a[j, j] = 1.0 / math.sqrt(total)
    return True


@compiled
def whiten(factor, white, size, columns):
    """Divide the columns of ``white`` (size, columns) by the factor, in place."""
    for i in range(size):
        for h in range(i):
            share = factor[i, h]
            for c in range(columns):
                white[i, c] -= share * white[h, c]
        for c in range(columns):
            white[i, c] *= factor[i, i]


@compiled
def _fill_white(work, n, derive):
    """Residuals, and where ``derive`` the derivatives, whitened."""
    for i in range(n):
        for a in range(2):
            if derive:
                for j in range(6):
                    work.white[2 * i + a, j] = work.by_pose[i, a, j]
            work.white[2 * i + a, 6] = work.off[i, a]


@compiled
def _normal(work, size, normal, right):
    """Fill the normal matrix (6, 6) and right side (6,); returns chi squared."""
    cost = 0.0
    for i in range(6):
        for j in range(7):
            total = 0.0
            for r in range(size):
                total += work.white[r, i] * work.white[r, j]
            if j < 6:
                normal[i, j] = total
            else:
                right[i] = total
    for r in range(size):
        cost += work.white[r, 6] ** 2
    return cost


@compiled
def _cost(work, size):
    """Chi squared of the residuals, which are in ``off``."""
    _fill_white(work, size // 2, False)
    column = work.white[:size, 6:]
    whiten(work.factor, column, size, 1)
    cost = 0.0
    for r in range(size):
        cost += column[r, 0] ** 2
    return cost


@compiled
def _damped(normal, right, damping, inverse, move):
    """Fill ``move`` (6,) with a damped step, and ``inverse`` (6, 6)."""
    a = normal.copy()
    for i in range(6):
        a[i, i] *= 1.0 + damping
    invert(a, inverse)
    for i in range(6):
        move[i] = 0.0
        for j in range(6):
            move[i] += inverse[i, j] * right[j]


@compiled
def _noise(k, bundle, work, covariance, noise):
    """Fill ``noise`` (6, 6): what of a pose's ``covariance`` is noise of spots.

    A pose moves by C J' S^-1 e with errors e: with Z = S^-1 J, C Z' R Z C.
    """
    begin = bundle.first[k]
    size = 2 * (bundle.first[k + 1] - begin)
    back, inner = work.white, np.zeros((6, 6))
    for i in range(size - 1, -1, -1):
        for c in range(6):
            back[i, c] *= work.factor[i, i]
            for h in range(i):
                back[h, c] -= work.factor[i, h] * back[i, c]
    for r in range(size // 2):
        own = bundle.covariances[begin + r]
        for i in range(6):
            p, q = back[2 * r, i], back[2 * r + 1, i]
            for j in range(6):
                inner[i, j] += p * (own[0] * back[2 * r, j] + own[1] * back[2 * r + 1, j])
                inner[i, j] += q * (own[1] * back[2 * r, j] + own[2] * back[2 * r + 1, j])
    half = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            half[i, j] = 0.0
            for h in range(6):
                half[i, j] += covariance[i, h] * inner[h, j]
    for i in range(6):
        for j in range(6):
            noise[i, j] = 0.0
            for h in range(6):
                noise[i, j] += half[i, h] * covariance[h, j]


@compiled
def _fit(k, rotation, t, eyes, bodies, bundle, motion, work, covariance):
    """Refine a pose in place with the rays' covariance where it starts; returns chi squared, `Poses.logdets` and how
    far it went.

    Leaves the whitened derivatives of the last linearization in the ``work``, and fills the ``covariance``.
    """
    size = 2 * (bundle.first[k + 1] - bundle.first[k])
    normal, right, move, turn = np.empty((6, 6)), np.empty(6), np.empty(6), np.empty((3, 3))
    trial, trial_t, gone = np.empty((3, 3)), np.empty(3), 0.0
    fill_covariance(k, rotation, t, eyes, bodies, bundle, motion, work)
    if not factorize(work.factor, size):
        return NO_SOLUTION, 0.0, 0.0
    damping, cost = 0.0, NO_SOLUTION
    for _ in range(STEPS):
        _fill_white(work, size // 2, True)
        whiten(work.factor, work.white[:size], size, 7)
        cost = _normal(work, size, normal, right)
        accepted, step, trial_cost = False, 0.0, cost
        for _ in range(8):
            _damped(normal, right, damping, covariance, move)
            exp_into(move[3], move[4], move[5], turn)
            product_into(turn, rotation, trial)
            step = 0.0
            for i in range(3):
                trial_t[i] = t[i] + move[i]
                step = max(step, abs(move[i]), abs(move[3 + i]))
            in_front = linearize(k, trial, trial_t, eyes, bodies, bundle, motion, work, False)
            if in_front:
                trial_cost = _cost(work, size)
                if step < STILL or trial_cost <= cost * (1.0 + 1e-12):
                    accepted = True
                    break
            damping = max(10.0 * damping, 1e-3)
        if not accepted:
            linearize(k, rotation, t, eyes, bodies, bundle, motion, work, False)
            break
        rotation[:, :] = trial
        for i in range(3):
            t[i] = trial_t[i]
        gone += step
        cost = trial_cost
        damping = 0.1 * damping if damping > 1e-5 else 0.0
        if step < NEAR:
            # What the derivatives change by on so short a way is nothing.
            break
        linearize(k, rotation, t, eyes, bodies, bundle, motion, work, True)
    invert(normal, covariance)
    logdet = 0.0
    for i in range(size):
        logdet -= 2.0 * math.log(work.factor[i, i])
    for i in range(6):
        logdet -= 2.0 * math.log(normal[i, i])
    return cost, logdet, gone


@compiled
def solve_one(k, eyes, bodies, bundle, motion, poses):
    """Solve robot k of the bundle: its rows of the `Poses`."""
    begin, end = bundle.first[k], bundle.first[k + 1]
    rotation, t, covariance = poses.rotations[k], poses.ts[k], poses.covariances[k]
    poses.costs[k], poses.logdets[k] = NO_SOLUTION, 0.0
    covariance[:, :] = poses.noise[k] = 0.0
    for i in range(begin, end):
        poses.residuals[i, :] = 0.0
    if end - begin < 3:
        return
    work = work_room(end - begin)
    cost, logdet = NO_SOLUTION, 0.0
    for _ in range(AGAIN):
        if not linearize(k, rotation, t, eyes, bodies, bundle, motion, work, True):
            return
        cost, logdet, gone = _fit(k, rotation, t, eyes, bodies, bundle, motion, work, covariance)
        if gone < FAR:
            break
    poses.costs[k], poses.logdets[k] = cost, logdet
    for i in range(begin, end):
        poses.residuals[i, 0], poses.residuals[i, 1] = work.off[i - begin, 0], work.off[i - begin, 1]
    _noise(k, bundle, work, covariance, poses.noise[k])


@compiled
def solve_joint(eyes, bodies, bundle, motion, poses):
    """Solve all robots of the bundle from the starts in the `Poses`, and fill these."""
    for k in range(bundle.bodies.shape[0]):
        solve_one(k, eyes, bodies, bundle, motion, poses)


@compiled
def residuals_at(eyes, bodies, bundle, motion, poses):
    """Fill the residuals of the `Poses` as they stand."""
    for k in range(bundle.bodies.shape[0]):
        begin, end = bundle.first[k], bundle.first[k + 1]
        work = work_room(end - begin)
        linearize(k, poses.rotations[k], poses.ts[k], eyes, bodies, bundle, motion, work, False)
        for i in range(begin, end):
            poses.residuals[i, 0], poses.residuals[i, 1] = work.off[i - begin, 0], work.off[i - begin, 1]
