"""The two minima that a plane's pose has: refined, the second from the first, and one that was missed (`valley`)."""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.covariance import invert
from asterism.server.pose.matched import Lit, gather
from asterism.server.pose.planar import NO_SOLUTION, normal_equations, other_minimum, refine_pose
from asterism.server.pose.rotations import angle_between
from asterism.server.pose.spot_shift import correct_rays, refine_shifted
from asterism.server.pose.systematic import ITERATIONS, systematic
from asterism.server.pose.valley import fill_pose, is_frontal, look_around, missed, survey, tilt_of

FEW = 3  # iterations, after which a second minimum that costs more than the first by HOPELESS is good enough
HOPELESS = 80.0  # squared sigmas: odds of e^40
NEGLIGIBLE = 0.02  # of a spot's own variance
SLIGHT = 0.5  # up to here more variance of every spot makes the pose less sure, but hardly moves it
SAME_RAD = 0.002  # poses no further apart are one


class Robot(NamedTuple):
    """One robot: ``layout`` (6, 3) m, ``optics`` (OPTICS,), the spots of its LEDs ``labels`` (6,)."""

    layout: Any
    optics: Any
    labels: Any


class Work(NamedTuple):
    """Scratch of one robot's solution. Either minimum has its own shifts, and so its own rays."""

    points: Any  # (6, 3)
    seen: Any  # (2, 6, 2)
    applied: Any  # (2, 6, 2)
    information: Any  # (6, 3)
    own: Any  # (6, 3): information of the spots' own noise
    centre: Any  # (3,) of the visible LEDs
    shifts: Any  # (6, 2)
    start: Any  # (3, 3)
    start_t: Any  # (3,)
    kept: Any  # (3, 3)
    kept_t: Any  # (3,)
    arm: Any  # (3,)
    a: Any  # (6, 6)
    b: Any  # (6,)
    told: Any  # (2,): what `systematic` says of the better minimum as it is, a cost of NO_SOLUTION: nothing


@compiled
def work_room():
    points, seen, applied, information = np.empty((6, 3)), np.empty((2, 6, 2)), np.empty((2, 6, 2)), np.empty((6, 3))
    own, centre, shifts, start, start_t = np.empty((6, 3)), np.empty(3), np.empty((6, 2)), np.empty((3, 3)), np.empty(3)
    kept, kept_t, arm, a, b = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((6, 6)), np.empty(6)
    told = np.empty(2)
    return Work(points, seen, applied, information, own, centre, shifts, start, start_t, kept, kept_t, arm, a, b, told)


@compiled
def lit_of(work, which, count, information):
    """The ``count`` visible LEDs as one of the minima sees them."""
    return Lit(work.points[:count], work.seen[which, :count], work.applied[which, :count], information[:count])


@compiled
def _other(solution, known, lit, optics, focal):
    """Fill the pose's other minimum from the ``known`` one; its cost. The rays of ``lit`` become the other's."""
    rotations, ts = solution.rotations, solution.ts
    rotation, t = rotations[1 - known], ts[1 - known]
    if not other_minimum(rotations[known], ts[known], lit.points, lit.seen, rotation, t) or t[2] <= 0.0:
        return NO_SOLUTION
    correct_rays(rotation, t, lit, optics)
    found = refine_pose(rotation, t, lit.points, lit.seen, lit.information, FEW)
    if found < solution.costs[known] + HOPELESS:
        found = refine_shifted(rotation, t, lit, optics, focal, ITERATIONS)
    return found


@compiled
def _both_minima(robot, solution, focal, work, count):
    """Fill both minima of a robot, refined from the start in ``work``."""
    rotations, ts, costs, optics = solution.rotations, solution.ts, solution.costs, robot.optics
    lit, others = lit_of(work, 0, count, work.information), lit_of(work, 1, count, work.information)
    start, start_t, centre = work.start, work.start_t, work.centre
    rotations[0] = start
    for i in range(3):
        ts[0, i] = start_t[i]
        for j in range(3):
            ts[0, i] += start[i, j] * centre[j]
    costs[0] = refine_shifted(rotations[0], ts[0], lit, optics, focal, ITERATIONS)
    costs[1] = _other(solution, 0, others, optics, focal)
    if costs[1] < costs[0]:
        # The start was the worse one's, perhaps too far from it to arrive: from the better it is near.
        work.kept[:, :], work.kept_t[:] = rotations[0], ts[0]
        kept_cost = costs[0]
        costs[0] = _other(solution, 1, lit, optics, focal)
        if costs[0] > kept_cost:
            rotations[0], ts[0], costs[0] = work.kept, work.kept_t, kept_cost
            correct_rays(rotations[0], ts[0], lit, optics)


@compiled
def largest(table, column):
    """The largest number of a column of a table (n, m) of numbers that are not negative."""
    largest = 0.0
    for k in range(table.shape[0]):
        largest = max(largest, table[k, column])
    return largest


@compiled
def refine_both(robot, measured, solution, focal, work):
    """Fill both minima of a robot, costs as of `refine_pose`, and leave ``work`` as they saw the spots.

    Residuals beyond the spots' noise, whatever causes them, count as noise of every spot: then both are refined again.
    Returns the better one and how many LEDs are visible.
    """
    rotations, ts, costs = solution.rotations, solution.ts, solution.costs
    room = Lit(work.points, work.seen[0], work.applied[0], work.information)
    extra, is_slight = 0.0, False
    better = count = 0
    work.told[1] = NO_SOLUTION
    for attempt in range(2):
        count = gather(robot.layout, robot.labels, measured, work.shifts, extra, focal, room, work.centre)
        work.seen[1, :, :] = work.seen[0]
        work.applied[1, :, :] = work.applied[0]
        if attempt == 0:
            _both_minima(robot, solution, focal, work, count)
        elif not is_slight:
            for which in range(2):
                if costs[which] < NO_SOLUTION:
                    lit = lit_of(work, which, count, work.information)
                    costs[which] = refine_shifted(rotations[which], ts[which], lit, robot.optics, focal, ITERATIONS)
        better = 0 if costs[0] <= costs[1] else 1
        if attempt == 1 or costs[better] >= NO_SOLUTION:
            break
        work.own[:count] = work.information[:count]
        lit = lit_of(work, better, count, work.information)
        known2 = (solution.learned[0] / ts[better, 2]) ** 2
        extra, cost = systematic(rotations[better], ts[better], lit, focal, known2)
        share = extra * (largest(lit.information, 0) + largest(lit.information, 2))
        if share < NEGLIGIBLE:
            work.told[0], work.told[1] = extra, cost
            break
        is_slight = share < SLIGHT
    return better, count


@compiled
def curvature(rotation, t, lit, work, covariance):
    """Fill the ``covariance`` (6, 6) of a pose about the visible LEDs' mean with what its minimum's curvature says.

    Returns minus the logarithm of its determinant.
    """
    a = work.a
    normal_equations(rotation, t, lit.points, lit.seen, lit.information, a, work.b)
    invert(a, covariance)
    # What is left in a is the inverse of its Cholesky factor's diagonal.
    product = 1.0
    for i in range(6):
        product *= a[i, i]
    return -2.0 * math.log(max(abs(product), 1e-300))


@compiled
def look_wide(rotation, t, lit, work, valley, covariance):
    """Fill a pose's ``covariance`` (6, 6) with its curvature's and, where it is seen nearly in front, the valley.

    Returns minus the logarithm of the covariance's determinant and the step of the valley's grid, 0 for no valley.
    """
    narrow = curvature(rotation, t, lit, work, covariance)
    if not is_frontal(rotation, t, covariance, valley) or not survey(rotation, t, lit, work.centre, valley):
        return narrow, 0.0
    x, y = tilt_of(rotation, valley)
    return narrow, look_around(x, y, valley)


@compiled
def find_missed(robot, solution, better, count, focal, work, valley):
    """Look for a minimum that was missed, where the better one is seen nearly in front.

    Returns which is the better one then, and what `look_wide` says of it.
    """
    rotations, ts, costs = solution.rotations, solution.ts, solution.costs
    narrow = step = 0.0
    for _ in range(2):
        other = 1 - better
        lit, others = lit_of(work, better, count, work.information), lit_of(work, other, count, work.information)
        narrow, step = look_wide(rotations[better], ts[better], lit, work, valley, solution.covariances[better])
        if step == 0.0:
            break
        work.told[1] = NO_SOLUTION
        x, y = tilt_of(rotations[better], valley)
        other_x, other_y = tilt_of(rotations[other], valley) if costs[other] < NO_SOLUTION else (x, y)
        at_x, at_y, found = missed(x, y, other_x, other_y, step, valley)
        if not found:
            break
        fill_pose(at_x, at_y, rotations[better], lit, valley, work.kept, work.kept_t)
        cost = refine_shifted(work.kept, work.kept_t, others, robot.optics, focal, ITERATIONS)
        if cost >= costs[other] or angle_between(work.kept, rotations[better]) < SAME_RAD:
            if costs[other] < NO_SOLUTION:
                correct_rays(rotations[other], ts[other], others, robot.optics)
            break
        rotations[other], ts[other], costs[other] = work.kept, work.kept_t, cost
        if cost >= costs[better]:
            break
        better = other
    return better, narrow, step
