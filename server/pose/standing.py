"""Robots that stand on the surface: solved again with it (`on_surface`), if what light alone says does not deny it.

Light denies the surface where the joint pose costs more than light alone can explain. That splits in two: the distance,
with the tilt as the surface has it and the height free, and the tilt. Either beyond 5 sigma, the robot is solved
without: it is lifted, or sunk, or tilted. Where one frame cannot tell, the distances that light saw in the frames
before count (`remembered`). In between the surface's own sigma is raised, so that the pose's covariance covers what is
seen: a surface that is wrong by a little is followed less and less.
"""

import math
from typing import NamedTuple

from asterism.server.compiled import compiled
from asterism.server.pose.choose import MOST_ODDS, carry, to_parent, turn_room
from asterism.server.pose.covariance import invert, move_origin
from asterism.server.pose.doubt import doubt, doubt_tilt
from asterism.server.pose.ground import is_within, sigma_at
from asterism.server.pose.lens import FX, FY
from asterism.server.pose.minima import SAME_RAD, Robot
from asterism.server.pose.on_surface import (
    add_stance,
    fill_stance,
    refine_standing,
    stance_cost,
)
from asterism.server.pose.planar import NO_SOLUTION, cholesky_solve, normal_equations
from asterism.server.pose.remembered import DENIED, look_back, remember
from asterism.server.pose.rotations import angle_between, exp_into, product_into
from asterism.server.pose.seen_standing import (
    fill_seen_pose,
    gather_lit,
    light_alone,
    seen_of,
    standing_room,
    take_place,
)
from asterism.server.pose.shared_errors import fill_light, is_shared
from asterism.server.pose.solve import NOISE_SHARE, fill_residuals
from asterism.server.pose.spot_shift import correct_rays
from asterism.server.pose.stood import (
    BEYOND,
    LIFTED,
    NOWHERE,
    OFF,
    OFF_SIGMA,
    ON_SURFACE,
    SUNK,
    TILT,
    TILT_SIGMA,
    TILTED,
)
from asterism.server.pose.systematic import ITERATIONS, systematic
from asterism.server.pose.track import is_fresh

TILT_DENIED = 28.7  # chi squared of both tilts together that is as unlikely as 5 sigma
NO_TILT = 80.0  # chi squared of a tilt against the normal beyond which no pose with the surface is: odds of e^40
SAME_START = math.radians(0.5)  # starts no further apart lead to one pose
ASTRAY = 0.5  # of a robot's depth: a pose that went further than that arrived nowhere
SETTLE = 3  # Gauss-Newton steps that bring shared errors in


@compiled
def _weigh(number, underfoot, stance):
    """Fill the weights of the surface where the stance touches it; returns whether that is within its edge, and the
    variances.
    """
    terrain, foot = underfoot.terrain, stance.touching.foot
    variance = underfoot.feet.variances[number, 0] + sigma_at(terrain, foot[0], foot[1]) ** 2
    tilt = underfoot.feet.variances[number, 1] + terrain.known[1] ** 2
    stance.weights[0], stance.weights[1] = 1.0 / variance, 1.0 / tilt
    return is_within(terrain.edge, foot[0], foot[1]), variance, tilt


@compiled
def _begin(which, underfoot, work):
    """Fill the third start: the pose that is nearest to the surface, from light's."""
    stance, rotation, t, axis = work.stance, work.rotations[which], work.ts[which], work.arm
    start, start_t = work.rotations[2], work.ts[2]
    start[:, :], start_t[:] = rotation, t
    if not fill_stance(rotation, t, stance, underfoot, False):
        return
    normal = stance.normal
    if stance.weights[1] > 0.0:
        for i in range(3):
            axis[i] = 0.0
            for j in range(3):
                axis[i] += rotation[i, j] * stance.axis[j]
        x, y, z = (
            axis[1] * normal[2] - axis[2] * normal[1],
            axis[2] * normal[0] - axis[0] * normal[2],
            axis[0] * normal[1] - axis[1] * normal[0],
        )
        sine, cosine = math.sqrt(x * x + y * y + z * z), axis[0] * normal[0] + axis[1] * normal[1] + axis[2] * normal[2]
        turn = math.atan2(sine, cosine) / sine if sine > 1e-9 else 1.0
        exp_into(turn * x, turn * y, turn * z, work.light[:3, :3])
        product_into(work.light[:3, :3], rotation, start)
    if fill_stance(start, start_t, stance, underfoot, False):
        for i in range(3):
            start_t[i] -= stance.off[0] * stance.normal[i]


@compiled
def _refine_all(robot, solutions, k, underfoot, count, focal, work):
    """Refine with the surface from the pose nearest to it, and from those minima that may lead elsewhere: which are
    neither near that pose, nor so far from the normal that the surface lets none of their kind be.

    Returns whether one went astray: light and surface contradict each other so that there is no minimum to arrive at.
    """
    stance, astray = work.stance, False
    for which in range(3):
        work.costs[which] = NO_SOLUTION
        if which < 2:
            if not solutions.costs[k, which] < NO_SOLUTION:
                continue
            rotation = work.rotations[which]
            if not fill_stance(rotation, work.ts[which], stance, underfoot, False):
                continue
            denied = stance.weights[1] * (stance.off[1] ** 2 + stance.off[2] ** 2) > NO_TILT
            if denied or angle_between(rotation, work.rotations[2]) < SAME_START:
                continue
        lit, away = seen_of(work, count, work.room.information), work.ts[2, 2]
        work.costs[which] = refine_standing(
            work.rotations[which], work.ts[which], lit, robot.optics, work.stance, underfoot, ITERATIONS, focal
        )
        if work.costs[which] < NO_SOLUTION and not abs(work.ts[which, 2] - away) < ASTRAY * away:
            work.costs[which], astray = NO_SOLUTION, True
    return astray


@compiled
def _mode_cost(robot, learned, which, underfoot, count, focal, work):
    """Minus twice the logarithm of how likely a refined pose is: `systematic`'s of the spots, and the surface's."""
    rotation, t, lit = work.rotations[which], work.ts[which], seen_of(work, count, work.own)
    correct_rays(rotation, t, lit, robot.optics)
    _, cost = systematic(rotation, t, lit, focal, (learned / t[2]) ** 2)
    if not fill_stance(rotation, t, work.stance, underfoot, False):
        return NO_SOLUTION
    return cost + stance_cost(work.stance)


@compiled
def _choose(robot, alone, k, underfoot, count, focal, work):
    """Which refined pose is the likeliest, which other one there is (-1: none), and its odds over it."""
    costs, best, other = work.costs, 0, -1
    for which in range(1, 3):
        if costs[which] < costs[best]:
            best = which
    if costs[best] >= NO_SOLUTION:
        return -1, -1, 0.0
    for which in range(3):
        if costs[which] >= NO_SOLUTION or angle_between(work.rotations[which], work.rotations[best]) < SAME_RAD:
            continue
        if other < 0 or costs[which] < costs[other]:
            other = which
    if other < 0:
        return best, -1, MOST_ODDS
    learned = alone.solutions.learned[k]
    evidence = 0.5 * _mode_cost(robot, learned, other, underfoot, count, focal, work)
    evidence -= 0.5 * _mode_cost(robot, learned, best, underfoot, count, focal, work)
    # What is known beforehand, of frames before and of the rig, is what light's choice rests on beyond its costs.
    solutions, chosen = alone.solutions, alone.choices.best[k]
    if solutions.costs[k, 0] < NO_SOLUTION and solutions.costs[k, 1] < NO_SOLUTION:
        # Odds that are told no higher hide what of them was known before.
        odds = alone.choices.odds[k]
        before = math.log(odds) if odds < MOST_ODDS else 0.0
        before -= 0.5 * (solutions.costs[k, 1 - chosen] - solutions.costs[k, chosen]) if odds < MOST_ODDS else 0.0
        near = angle_between(solutions.rotations[k, chosen], work.rotations[best])
        far = angle_between(solutions.rotations[k, chosen], work.rotations[other])
        evidence += before if near <= far else -before
    if evidence < 0.0:
        best, other = other, best
    return best, other, math.exp(min(abs(evidence), math.log(MOST_ODDS)))


class _Fit(NamedTuple):
    """A pose solved with the surface: what light's part ``cost``, and the surface's, ``stance``; how far off it is with
    the height left to light, ``off`` m, the ``variance`` of that by light, and which part of it is single spots' own,
    ``noise``.
    """

    cost: float
    stance: float
    off: float
    variance: float
    noise: float


@compiled
def _finish(robot, which, underfoot, count, work):
    """Bring in what errors light's spots share, and fill light's information and the ``covariance`` of a refined pose;
    what it says of the height.
    """
    rotation, t, stance, a, b = work.rotations[which], work.ts[which], work.stance, work.a, work.b
    lit = seen_of(work, count, work.room.information)
    correct_rays(rotation, t, lit, robot.optics)
    fill_stance(rotation, t, stance, underfoot, True)
    for _ in range(SETTLE if is_shared(robot.optics, work.shared) else 0):
        fill_light(rotation, t, lit, robot.optics, work.shared, a, b)
        add_stance(stance, True, a, b)
        if not cholesky_solve(a, b):
            break
        exp_into(b[3], b[4], b[5], work.alone[:3, :3])
        product_into(work.alone[:3, :3], rotation, work.light[:3, :3])
        rotation[:, :] = work.light[:3, :3]
        for i in range(3):
            t[i] += b[i]
        correct_rays(rotation, t, lit, robot.optics)
        fill_stance(rotation, t, stance, underfoot, True)
    normal_equations(rotation, t, lit.points, lit.seen, lit.information, work.alone, b)
    for i in range(6):
        for j in range(i):
            work.alone[j, i] = work.alone[i, j]
    cost = fill_light(rotation, t, lit, robot.optics, work.shared, work.light, b)
    a[:, :] = work.light
    add_stance(stance, False, a, b)
    invert(a, work.covariance)
    off, variance, noise, gain = stance.off[0], 0.0, 0.0, work.gain
    for i in range(6):
        gain[i] = 0.0
        for j in range(6):
            gain[i] += work.covariance[i, j] * stance.by_pose[0, j]
        off += gain[i] * b[i]
        variance += gain[i] * stance.by_pose[0, i]
    for i in range(6):
        for j in range(6):
            noise += gain[i] * work.alone[i, j] * gain[j]
    a[:, :] = work.light
    add_stance(stance, True, a, b)
    invert(a, work.covariance)
    return _Fit(cost, stance_cost(stance), off, variance, noise)


@compiled
def _tell(alone, k, robot, modes, odds, mounts, work, stood):
    """Write the pose of the first of two ``modes``, and the other's (-1: none), in the parent frame."""
    number, own = robot
    room, centre, view = turn_room(), work.centre, mounts.camera_rotation
    for place in range(2):
        which = modes[place]
        if which < 0:
            continue
        rotation, t = work.rotations[which], work.ts[which].copy()
        for i in range(3):
            for j in range(3):
                t[i] -= rotation[i, j] * centre[j]
        if place == 0:
            for i in range(3):
                work.arm[i] = 0.0
                for j in range(3):
                    work.arm[i] -= rotation[i, j] * centre[j]
            move_origin(work.covariance, work.arm)
            move_origin(work.alone, work.arm)
            fill_residuals(alone.lens, own, rotation, t, alone.measured.centres_px, work.shifts, stood.residuals[k])
        for i in range(3):
            t[i] += alone.moves[k, i]
        to_parent(rotation, t, number, mounts, room, stood.positions[k, place], stood.quaternions[k, place])
        if place == 0:
            carry(work.covariance, view, room.arm, stood.covariances[k])
            carry(work.alone, view, room.arm, stood.by_spots[k])
    stood.odds[k] = odds


@compiled
def _fill_by_spots(work):
    """Leave in ``alone`` what single spots' errors do to the pose: C A C, A being their information."""
    half = work.a
    for i in range(6):
        for j in range(6):
            half[i, j] = 0.0
            for m in range(6):
                half[i, j] += work.covariance[i, m] * work.alone[m, j]
    for i in range(6):
        for j in range(6):
            work.light[i, j] = 0.0
            for m in range(6):
                work.light[i, j] += half[i, m] * work.covariance[m, j]
    work.alone[:, :] = work.light


@compiled
def _stand(matched, alone, k, underfoot, mounts, history, work, stood):
    """How one robot stands, from its row; writes what is remembered of it."""
    number, solutions, best = matched.robots[k], alone.solutions, alone.choices.best[k]
    focal = math.sqrt(alone.lens[FX] * alone.lens[FY])
    robot = Robot(alone.constellations.layouts[number], alone.constellations.optics[number], matched.assignment[k])
    stance, offs = work.stance, stood.offs[k]
    count = gather_lit(robot, alone, k, best, focal, work)
    take_place(number, solutions.rotations[k, best], alone, k, underfoot, work)
    for which in range(2):
        if solutions.costs[k, which] < NO_SOLUTION:
            fill_seen_pose(
                solutions.rotations[k, which], solutions.ts[k, which], work.centre, work.rotations[which],
                work.ts[which],
            )  # fmt: skip
    stood.standing[k] = BEYOND
    if not fill_stance(work.rotations[best], work.ts[best], stance, underfoot, False):
        history[:, :] = 0.0
        return
    inside, variance, tilt_variance = _weigh(number, underfoot, stance)
    if not inside:
        history[:, :] = 0.0
        return
    least, tilt, tilt_sigma = light_alone(robot, solutions, k, underfoot, count, work)
    offs[TILT], offs[TILT_SIGMA] = tilt, tilt_sigma
    _begin(best, underfoot, work)
    astray = _refine_all(robot, solutions, k, underfoot, count, focal, work)
    first, other, odds = _choose(robot, alone, k, underfoot, count, focal, work)
    if first < 0:
        history[:, :] = 0.0
        if astray:
            stood.standing[k] = TILTED
            _by_light(alone, k, underfoot, variance, work, stood)
        return
    fit = _finish(robot, first, underfoot, count, work)
    share = solutions.misfits[k, NOISE_SHARE]
    noise, whole = share * fit.noise, fit.variance + variance
    offs[OFF], offs[OFF_SIGMA] = fit.off, math.sqrt(whole)
    tilted = fit.cost + fit.stance - least - fit.off * fit.off / whole
    if tilted > TILT_DENIED:
        history[:, :] = 0.0
        stood.standing[k] = TILTED
        _by_light(alone, k, underfoot, variance, work, stood)
        return
    mean, spread = look_back(history, fit.off, noise)
    together = spread + max(whole - noise, 0.0)
    now, lately = abs(fit.off) / math.sqrt(whole), abs(mean) / math.sqrt(together)
    denied = remember(history, fit.off, noise, max(now, lately))
    if denied:
        if lately > now:
            offs[OFF], offs[OFF_SIGMA] = mean, math.sqrt(together)
        stood.standing[k] = LIFTED if offs[OFF] > 0.0 else SUNK
        return
    more = doubt(mean, together, variance, fit.variance)
    more_tilt = doubt_tilt(tilted, tilt, tilt_variance)
    if more > 0.0 or more_tilt > 0.0:
        stance.weights[0] = 1.0 / (variance + more)
        stance.weights[1] = 1.0 / (tilt_variance + more_tilt)
        lit = seen_of(work, count, work.room.information)
        refine_standing(work.rotations[first], work.ts[first], lit, robot.optics, stance, underfoot, ITERATIONS, focal)
        _finish(robot, first, underfoot, count, work)
    stood.standing[k] = ON_SURFACE
    _fill_by_spots(work)
    _tell(alone, k, (number, robot), (first, other), odds, mounts, work, stood)


@compiled
def _by_light(alone, k, underfoot, variance, work, stood):
    """How far a robot that is tilted is off the surface, by light alone: further than sigmas explain, it is lifted."""
    best, offs, stance = alone.choices.best[k], stood.offs[k], work.stance
    rotation, t, covariance = work.rotations[2], work.ts[2], work.covariance
    fill_seen_pose(alone.solutions.rotations[k, best], alone.solutions.ts[k, best], work.centre, rotation, t)
    if not fill_stance(rotation, t, stance, underfoot, True):
        offs[OFF] = offs[OFF_SIGMA] = math.nan
        return
    covariance[:, :] = alone.solutions.covariances[k, best]
    for i in range(3):
        work.arm[i] = t[i] - alone.solutions.ts[k, best, i]
    move_origin(covariance, work.arm)
    total = variance
    for i in range(6):
        for j in range(6):
            total += stance.by_pose[0, i] * covariance[i, j] * stance.by_pose[0, j]
    offs[OFF], offs[OFF_SIGMA] = stance.off[0], math.sqrt(total)
    if abs(offs[OFF]) > DENIED * offs[OFF_SIGMA]:
        stood.standing[k] = LIFTED if offs[OFF] > 0.0 else SUNK


@compiled
def stand_robots(matched, alone, underfoot, mounts, exposed_ns, seen_ns, histories, stood):
    """How every solved robot stands: fill the `Stood` from `Matched` and `Alone`, and write ``histories`` (robots,
    REMEMBERED, 3) of the distances that light saw (`remembered`). ``seen_ns`` (robots,) when they were seen before.
    """
    work = standing_room()
    for k in range(matched.robots.shape[0]):
        robot = matched.robots[k]
        stood.standing[k] = NOWHERE
        if underfoot.feet.stands[robot] == 0 or alone.choices.best[k] < 0:
            continue
        if not is_fresh(seen_ns[robot], exposed_ns):
            histories[robot, :, :] = 0.0
        _stand(matched, alone, k, underfoot, mounts, histories[robot], work, stood)
