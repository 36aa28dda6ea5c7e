"""Robots that move while the shutter is open: where their LEDs would be at mid-exposure, from their streaks' shapes.

During the exposure a robot moves by v and turns by w (m and rad, camera's axes, T_camera_plane at its middle). An LED
at r from the plane's origin moves by u = v + w x r; in the image by d = J u, and the second moments of its spot are
those of a disc and of blur and d d' / 12. Of six LEDs these tell v and w, but for a common sign, on which nothing below
depends.

- A streak of a robot that turns is bent: the mean of its light lies w x (w x r) / 24 from where the LED was at
  mid-exposure. All are drawn towards the axis of the turn, as by a greater distance.
- Where the LED brightens or dims by a share g, the light's mean is g u / 12 on: the whole robot seen g / 12 of the
  exposure later. Light is taken to go with a power of the cosine of the angle it is seen at and with 1 / distance^2.

What is left unknown of the turn (about axes in a plate seen in front, which draw out no streak) and of that power is
in the pose's covariance. Source: derived here; the fit is Levenberg's, with a prior: of a robot's speed and its turn's,
where nothing tells them, no more is known than that they are such as move its LEDs so far.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.covariance import invert
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import FX, FY
from asterism.server.pose.matched import LEAST_SIGMA_PX
from asterism.server.pose.planar import cholesky_solve, normal_equations
from asterism.server.pose.rotations import mapped

POWER, POWER_SIGMA = 2.0, 1.5  # of the cosine: a flat emitter (1) as its disc narrows, more for a beam
BLUR_PX2, BLUR_SIGMA = 0.6, 0.3  # second moment of a lens's blur and of pixels, and how well it is known
MOMENT_SHARE, MOMENT_PX2 = 0.04, 0.05  # one sigma of a moment: of its size, and besides
NUMBERS = 8  # v, w, the disc's semi-axis squared, blur beside BLUR_PX2
STARTS, STEPS = 4, 20
ENOUGH = 1e-4
SMALL = 1e-3  # of a displacement: so that the robust loss sees no outlier in it
FIELDS = 9  # ways in which the turn may be wrong


class Arms(NamedTuple):
    """A robot's LEDs that tell: ``points`` (k, 3) m in the camera's frame, ``arms`` (k, 3) from the plane's origin,
    ``moments`` (k, 3) px^2 and the plane's ``normal`` (3,).
    """

    points: Any
    arms: Any
    moments: Any
    normal: Any


class Motion(NamedTuple):
    """During the exposure: ``numbers`` (6,), m and rad, and their ``covariance`` (6, 6)."""

    numbers: Any
    covariance: Any


@compiled
def _cross(a, b, c, x, y, z):
    """(a, b, c) x (x, y, z)."""
    return b * z - c * y, c * x - a * z, a * y - b * x


@compiled
def _by_motion(arms, focal, by):
    """Fill ``by`` (k, 2, 6): px that every LED moves with the motion's numbers."""
    for k in range(arms.points.shape[0]):
        x, y, z = arms.points[k]
        p, q, r = arms.arms[k]
        by[k, 0, 0], by[k, 0, 1], by[k, 0, 2] = focal / z, 0.0, -focal * x / (z * z)
        by[k, 1, 0], by[k, 1, 1], by[k, 1, 2] = 0.0, focal / z, -focal * y / (z * z)
        for i in range(2):
            a, b, c = by[k, i, 0], by[k, i, 1], by[k, i, 2]
            # a . (w x r) = w . (r x a)
            by[k, i, 3], by[k, i, 4], by[k, i, 5] = _cross(p, q, r, a, b, c)


@compiled
def _disc(arms, disc):
    """Fill ``disc`` (3,) with the second moments, times four, of a flat disc of radius 1 px that turns as the robot."""
    x, y, z = 0.0, 0.0, 0.0
    for point in arms.points:
        x, y, z = x + point[0], y + point[1], z + point[2]
    n = arms.normal
    ex, ey = n[0] - x * n[2] / z, n[1] - y * n[2] / z
    length = max(math.sqrt(ex * ex + ey * ey), 1e-12)
    ex, ey = ex / length, ey / length
    facing = (n[0] * x + n[1] * y + n[2] * z) / math.sqrt(x * x + y * y + z * z)
    flat = 1.0 - facing * facing
    disc[0], disc[1], disc[2] = 1.0 - flat * ex * ex, -flat * ex * ey, 1.0 - flat * ey * ey


@compiled
def _begin(arms, focal, starts, scales):
    """Fill ``starts`` (STARTS, NUMBERS): moving, turning about the normal, both; in units of the ``scales`` (NUMBERS,)
    of what is likely, from the mean of the moments; returns one sigma of a moment, px^2.
    """
    xx = xy = yy = depth = arm2 = half = 0.0
    count = arms.points.shape[0]
    for k in range(count):
        a, b, c = arms.moments[k]
        xx, xy, yy = xx + a / count, xy + b / count, yy + c / count
        half += math.sqrt((0.5 * (a - c)) ** 2 + b * b) / count
        depth += arms.points[k, 2] / count
        for i in range(3):
            arm2 += arms.arms[k, i] ** 2 / count
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    length = math.sqrt(24.0 * max(half, 0.02)) * depth / focal
    scales[:3], scales[3:6] = length, 0.5 * length / math.sqrt(arm2)
    scales[6], scales[7] = max(4.0 * (0.5 * (xx + yy) - half - BLUR_PX2), 0.5), BLUR_SIGMA
    starts[:, :] = 0.0
    starts[:, 6] = 1.0
    for row in range(STARTS):
        moves = 0.0 if row == 1 else 1.0
        turns = 0.0 if row == 0 else (-1.0 if row == 3 else 1.0)
        starts[row, 0], starts[row, 1] = moves * math.cos(angle), moves * math.sin(angle)
        for i in range(3):
            starts[row, 3 + i] = turns * arms.normal[i]
    return MOMENT_SHARE * (xx + yy) + MOMENT_PX2


@compiled
def _normal(arms, by, disc, x, scales, a, b):
    """Fill the normal equations a, b of a step from ``x`` (NUMBERS,), sigmas of a moment being 1; returns the cost."""
    a[:, :] = 0.0
    b[:] = 0.0
    row = np.empty(NUMBERS)
    cost = 0.0
    for k in range(arms.points.shape[0]):
        u = v = 0.0
        for j in range(6):
            u += by[k, 0, j] * scales[j] * x[j]
            v += by[k, 1, j] * scales[j] * x[j]
        for i in range(3):
            blur = 0.0 if i == 1 else 1.0
            drawn = u * u if i == 0 else (u * v if i == 1 else v * v)
            still = 0.25 * disc[i] * scales[6] * x[6] + blur * (BLUR_PX2 + scales[7] * x[7])
            off = arms.moments[k, i] - still - drawn / 12.0
            for j in range(6):
                p, q = by[k, 0, j], by[k, 1, j]
                change = 2.0 * u * p if i == 0 else (u * q + v * p if i == 1 else 2.0 * v * q)
                row[j] = change * scales[j] / 12.0
            row[6], row[7] = 0.25 * disc[i] * scales[6], blur * scales[7]
            cost += off * off
            for j in range(NUMBERS):
                b[j] += row[j] * off
                for m in range(j + 1):
                    a[j, m] += row[j] * row[m]
    return cost


@compiled
def _with_prior(x, variance, a, b):
    """Add the prior to normal equations in units of the moments' ``variance``; returns its cost. Nothing is known of
    the disc's size.
    """
    cost = 0.0
    for j in range(NUMBERS):
        if j != 6:
            a[j, j] += variance
            b[j] -= variance * x[j]
            cost += variance * x[j] * x[j]
    return cost


@compiled
def _descend(arms, by, disc, scales, variance, x, a):
    """Levenberg's steps from ``x`` (NUMBERS,), in place, with the normal equations' ``a`` there; returns the cost."""
    new, b, next_b, step = np.empty(NUMBERS), np.empty(NUMBERS), np.empty(NUMBERS), np.empty(NUMBERS)
    next_a, work = np.empty((NUMBERS, NUMBERS)), np.empty((NUMBERS, NUMBERS))
    cost = _normal(arms, by, disc, x, scales, a, b)
    cost += _with_prior(x, variance, a, b)
    damping = 1e-3
    for _ in range(STEPS):
        work[:, :], step[:] = a, b
        for j in range(NUMBERS):
            work[j, j] *= 1.0 + damping
        if not cholesky_solve(work, step):
            break
        for j in range(NUMBERS):
            new[j] = x[j] + step[j]
        now = _normal(arms, by, disc, new, scales, next_a, next_b)
        now += _with_prior(new, variance, next_a, next_b)
        if now < cost:
            done = cost - now < ENOUGH * variance
            x[:], a[:, :], b[:], cost, damping = new, next_a, next_b, now, 0.3 * damping
            if done:
                break
        else:
            damping *= 10.0
    return cost


@compiled
def motion_of(arms, focal, motion):
    """Fill the `Motion` that draws a robot's spots out as their moments say; returns whether there is one."""
    by, disc = np.empty((arms.points.shape[0], 2, 6)), np.empty(3)
    starts, scales, a = np.empty((STARTS, NUMBERS)), np.empty(NUMBERS), np.empty((NUMBERS, NUMBERS))
    best, work, step = np.empty((NUMBERS, NUMBERS)), np.empty((NUMBERS, NUMBERS)), np.empty(NUMBERS)
    _by_motion(arms, focal, by)
    _disc(arms, disc)
    variance = _begin(arms, focal, starts, scales) ** 2
    least = math.inf
    for row in range(STARTS):
        cost = _descend(arms, by, disc, scales, variance, starts[row], a)
        if cost < least:
            least, best[:, :] = cost, a
            for j in range(6):
                motion.numbers[j] = scales[j] * starts[row, j]
    for j in range(6):
        work[:, :], step[:] = best, 0.0
        step[j] = 1.0
        if not cholesky_solve(work, step):
            return False
        for i in range(6):
            motion.covariance[i, j] = variance * scales[i] * scales[j] * step[i]
    return True


@compiled
def _dimming(arms, motion, k):
    """How the logarithms of an LED's facing and of 1 / distance^2 change during the exposure, and its motion (m)."""
    x, y, z = arms.points[k]
    p, q, r = arms.arms[k]
    n, w = arms.normal, motion.numbers[3:]
    mx, my, mz = _cross(w[0], w[1], w[2], n[0], n[1], n[2])
    ux, uy, uz = _cross(w[0], w[1], w[2], p, q, r)
    ux, uy, uz = ux + motion.numbers[0], uy + motion.numbers[1], uz + motion.numbers[2]
    facing = x * n[0] + y * n[1] + z * n[2]
    away = (x * ux + y * uy + z * uz) / (x * x + y * y + z * z)
    turned = (mx * x + my * y + mz * z + n[0] * ux + n[1] * uy + n[2] * uz) / facing - away
    return turned, -2.0 * away, ux, uy, uz


@compiled
def _seen_off(point, dx, dy, dz):
    """A displacement (m) of a point as its ray's."""
    return (dx - dz * point[0] / point[2]) / point[2], (dy - dz * point[1] / point[2]) / point[2]


@compiled
def _bent(arms, second, k):
    """Displacement (m) of an LED's light by E[w w'] = ``second`` (3, 3): (E[w w'] - trace) r / 24."""
    p, q, r = arms.arms[k]
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    dx = second[0, 0] * p + second[0, 1] * q + second[0, 2] * r - trace * p
    dy = second[1, 0] * p + second[1, 1] * q + second[1, 2] * r - trace * q
    dz = second[2, 0] * p + second[2, 1] * q + second[2, 2] * r - trace * r
    return dx / 24.0, dy / 24.0, dz / 24.0


@compiled
def light_off(arms, motion, off):
    """Fill ``off`` (k, 2): how far, as rays, every LED's light lies from where the LED is at mid-exposure."""
    second = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            second[i, j] = motion.numbers[3 + i] * motion.numbers[3 + j] + motion.covariance[3 + i, 3 + j]
    for k in range(arms.points.shape[0]):
        turned, away, ux, uy, uz = _dimming(arms, motion, k)
        later = (POWER * turned + away) / 12.0
        dx, dy, dz = _bent(arms, second, k)
        off[k, 0], off[k, 1] = _seen_off(arms.points[k], dx + later * ux, dy + later * uy, dz + later * uz)


@compiled
def _fields(motion, seconds):
    """Fill ``seconds`` (FIELDS, 3, 3): how w w' may be wrong, one sigma each, by the turn's covariance."""
    root = np.zeros((3, 3))
    for j in range(3):
        for i in range(j, 3):
            total = motion.covariance[3 + i, 3 + j]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            root[i, j] = math.sqrt(max(total, 1e-18)) if i == j else total / root[j, j]
    w = motion.numbers[3:]
    row = 0
    for a in range(3):
        for i in range(3):
            for j in range(3):
                seconds[row, i, j] = w[i] * root[j, a] + root[i, a] * w[j]
        row += 1
    for a in range(3):
        for b in range(a + 1):
            size = math.sqrt(0.5) if a == b else 1.0
            for i in range(3):
                for j in range(3):
                    seconds[row, i, j] = size * (root[i, a] * root[j, b] + root[i, b] * root[j, a])
            row += 1


@compiled
def _add_doubts(rotation, t, points, arms, motion, information, term):
    """Fill ``term`` (6, 6), of the plane's origin and rotation: what is not known of the turn, and of the light."""
    count = points.shape[0]
    a, noise, right, rays = np.empty((6, 6)), np.empty((6, 6)), np.empty(6), np.empty((count, 2))
    seconds, moved = np.empty((FIELDS, 3, 3)), np.empty(6)
    _fields(motion, seconds)
    dims = 0.0
    for k in range(count):
        dims += _dimming(arms, motion, k)[0] / count
    later = POWER_SIGMA * dims / 12.0
    for i in range(6):
        for j in range(6):
            term[i, j] = later * later * motion.numbers[i] * motion.numbers[j]
    for field in range(FIELDS):
        for k in range(count):
            x, y, z = mapped(rotation, t, points[k])
            dx, dy, dz = _bent(arms, seconds[field], k)
            u, v = _seen_off(arms.points[k], dx, dy, dz)
            rays[k, 0], rays[k, 1] = x / z + SMALL * u, y / z + SMALL * v
        normal_equations(rotation, t, points, rays, information, a, right)
        invert(a, noise)
        for i in range(6):
            moved[i] = 0.0
            for j in range(6):
                moved[i] += noise[i, j] * right[j] / SMALL
        for i in range(6):
            for j in range(6):
                term[i, j] += moved[i] * moved[j]


@compiled
def _arms_of(rotation, t, layout, leds, moments):
    """The `Arms` of those ``leds`` (k,) of a robot at T_camera_plane."""
    count = leds.shape[0]
    points, arms, told, normal = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3)), np.empty(3)
    for i in range(3):
        normal[i] = rotation[i, 2]
    for row in range(count):
        x, y, z = mapped(rotation, t, layout[leds[row]])
        points[row, 0], points[row, 1], points[row, 2] = x, y, z
        for i in range(3):
            arms[row, i] = points[row, i] - t[i]
            told[row, i] = moments[leds[row], i]
    return Arms(points, arms, told, normal)


@compiled
def _information(measured, spots, focal, information):
    """Fill ``information`` (k, 3) of the rays of some spots."""
    floor = (LEAST_SIGMA_PX / focal) ** 2
    for row in range(spots.shape[0]):
        xx, xy, yy = measured.covariances[spots[row]]
        xx, yy = xx + floor, yy + floor
        det = xx * yy - xy * xy
        information[row, 0], information[row, 1], information[row, 2] = yy / det, -xy / det, xx / det


@compiled
def straighten(lens, constellations, matched, measured, moments, terms):
    """Put the spots of robots that moved during the exposure where they would be at its middle.

    Changes the rays and centres of `Measured`; fills ``terms`` (m, 6, 6), which are to be added to the covariances of
    the poses of the plane's origin. ``moments`` (m, 6, 3) px^2 of the robots' spots, nan where they are no streaks.
    """
    focal = math.sqrt(lens[FX] * lens[FY])
    terms[:, :, :] = 0.0
    motion = Motion(np.empty(6), np.empty((6, 6)))
    for k in range(matched.robots.shape[0]):
        labels, layout = matched.assignment[k], constellations.layouts[matched.robots[k]]
        seen, tells = np.empty(LEDS, np.int64), np.empty(LEDS, np.int64)
        all_seen = all_tell = 0
        for led in range(LEDS):
            if labels[led] >= 0:
                seen[all_seen] = led
                all_seen += 1
                if not math.isnan(moments[k, led, 0]):
                    tells[all_tell] = led
                    all_tell += 1
        rotation, t = matched.rotations[k], matched.ts[k]
        if all_tell == 0:
            continue
        if not motion_of(_arms_of(rotation, t, layout, tells[:all_tell], moments[k]), focal, motion):
            continue
        arms = _arms_of(rotation, t, layout, seen[:all_seen], moments[k])
        off, information = np.empty((all_seen, 2)), np.empty((all_seen, 3))
        points, spots = np.empty((all_seen, 3)), np.empty(all_seen, np.int64)
        for row in range(all_seen):
            points[row], spots[row] = layout[seen[row]], labels[seen[row]]
        light_off(arms, motion, off)
        _information(measured, spots, focal, information)
        _add_doubts(rotation, t, points, arms, motion, information, terms[k])
        for row in range(all_seen):
            for i in range(2):
                measured.rays[spots[row], i] -= off[row, i]
                measured.centres_px[spots[row], i] -= lens[FX + i] * off[row, i]
