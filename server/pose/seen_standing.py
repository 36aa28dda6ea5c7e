"""What the standing of one robot is found with: its spots as light sees them, and what light alone says of it."""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.covariance import move_origin
from asterism.server.pose.fit import LEDS
from asterism.server.pose.matched import Lit, gather
from asterism.server.pose.minima import NEGLIGIBLE, largest
from asterism.server.pose.on_surface import fill_stance, stance_room
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.shared_errors import fill_light, shared_room
from asterism.server.pose.spot_shift import correct_rays
from asterism.server.pose.systematic import systematic


class Work(NamedTuple):
    """Scratch of one robot: its visible LEDs, ``own`` (6, 3) the information of the spots' own noise; poses that were
    begun from both minima and from the surface, their costs; the matrices of a step.
    """

    room: Any
    own: Any
    centre: Any
    rotations: Any  # (3, 3, 3)
    ts: Any  # (3, 3)
    costs: Any  # (3,)
    stance: Any
    shared: Any
    light: Any  # (6, 6): light's information
    alone: Any  # (6, 6): without what its errors share
    a: Any  # (6, 6)
    covariance: Any  # (6, 6)
    b: Any  # (6,)
    gain: Any  # (6,)
    arm: Any  # (3,)
    shifts: Any  # (6, 2)


@compiled
def standing_room():
    room = Lit(np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 2)), np.empty((LEDS, 3)))
    six = np.empty((4, 6, 6))
    return Work(
        room, np.empty((LEDS, 3)), np.empty(3), np.empty((3, 3, 3)), np.empty((3, 3)), np.empty(3), stance_room(),
        shared_room(), six[0], six[1], six[2], six[3], np.empty(6), np.empty(6), np.empty(3), np.zeros((LEDS, 2)),
    )  # fmt: skip


@compiled
def seen_of(work, count, information):
    """The ``count`` visible LEDs."""
    return Lit(work.room.points[:count], work.room.seen[:count], work.room.applied[:count], information[:count])


@compiled
def fill_seen_pose(rotation, t, centre, out, out_t):
    """Fill ``out`` (3, 3) and ``out_t`` (3,) with a plane's pose about the visible LEDs' mean."""
    out[:, :] = rotation
    for i in range(3):
        out_t[i] = t[i]
        for j in range(3):
            out_t[i] += rotation[i, j] * centre[j]


@compiled
def gather_lit(robot, alone, k, which, focal, work):
    """Fill the visible LEDs, with what the residuals of light's pose say is missing; returns how many they are."""
    solutions, zero = alone.solutions, work.shifts
    zero[:, :] = 0.0
    rotation, t = work.rotations[which], work.ts[which]
    count = gather(robot.layout, robot.labels, alone.measured, zero, 0.0, focal, work.room, work.centre)
    work.own[:count] = work.room.information[:count]
    fill_seen_pose(solutions.rotations[k, which], solutions.ts[k, which], work.centre, rotation, t)
    lit = seen_of(work, count, work.own)
    correct_rays(rotation, t, lit, robot.optics)
    known2 = (solutions.learned[k] / t[2]) ** 2
    extra, _ = systematic(rotation, t, lit, focal, known2)
    if extra * (largest(lit.information, 0) + largest(lit.information, 2)) >= NEGLIGIBLE:
        gather(robot.layout, robot.labels, alone.measured, zero, extra, focal, work.room, work.centre)
    return count


@compiled
def take_place(number, rotation, alone, k, underfoot, work):
    """Fill what the stance and shared errors are of a robot, by its row and its ``number`` in the rig."""
    stance, shared, feet, arm = work.stance, work.shared, underfoot.feet, work.arm
    for i in range(3):
        stance.point[i] = feet.points[number, i] - work.centre[i]
        stance.axis[i] = feet.axes[number, i]
        stance.move[i] = alone.moves[k, i]
        shared.common[i] = alone.commons[k, i]
        arm[i] = 0.0
        for j in range(3):
            arm[i] += rotation[i, j] * work.centre[j]
    shared.terms[:, :] = alone.terms[k]
    move_origin(shared.terms, arm)


@compiled
def light_alone(robot, solutions, k, underfoot, count, work):
    """What the cheaper of light's minima costs with these spots; and how far its axis is from the normal, of whichever
    is nearer to it, with the sigma of that: by ``a`` pose's own covariance.
    """
    least, nearest, sigma = NO_SOLUTION, math.inf, 0.0
    rotation, t, stance, covariance = work.rotations[2], work.ts[2], work.stance, work.covariance
    for which in range(2):
        if not solutions.costs[k, which] < NO_SOLUTION:
            continue
        fill_seen_pose(solutions.rotations[k, which], solutions.ts[k, which], work.centre, rotation, t)
        lit = seen_of(work, count, work.room.information)
        correct_rays(rotation, t, lit, robot.optics)
        least = min(least, fill_light(rotation, t, lit, robot.optics, work.shared, work.light, work.b))
        if not fill_stance(rotation, t, stance, underfoot, True):
            continue
        tilt = math.sqrt(stance.off[1] ** 2 + stance.off[2] ** 2)
        if tilt < nearest:
            nearest = tilt
            covariance[:, :] = solutions.covariances[k, which]
            for i in range(3):
                work.arm[i] = 0.0
                for j in range(3):
                    work.arm[i] += rotation[i, j] * work.centre[j]
            move_origin(covariance, work.arm)
            sigma = math.sqrt(tilt_variance(stance, covariance) + 1.0 / max(stance.weights[1], 1e-12))
    return least, nearest, sigma


@compiled
def tilt_variance(stance, covariance):
    """The variance of the tilt against the normal, along the tilt itself."""
    off, by_pose, gain = stance.off, stance.by_pose, np.empty(6)
    size = math.sqrt(off[1] ** 2 + off[2] ** 2)
    x, y = (off[1] / size, off[2] / size) if size > 0.0 else (1.0, 0.0)
    total = 0.0
    for i in range(6):
        gain[i] = x * by_pose[1, i] + y * by_pose[2, i]
    for i in range(6):
        for j in range(6):
            total += gain[i] * covariance[i, j] * gain[j]
    return total
