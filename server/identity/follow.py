"""Warm matching: robots that were there a moment ago claim the spots near where they should be now.

Every LED of a predicted pose takes the nearest free spot of like brightness within its gate; a spot that two LEDs
want goes to the nearer. The pose is refined from the prediction; spots that do not fit are given up one at a time. What
does not fit then is left to the cold search of the same frame.
"""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.identity.neighbours import first_from
from asterism.server.pose.fit import LEDS, SYSTEMATIC_PX
from asterism.server.pose.planar import NO_SOLUTION, refine_pose
from asterism.server.pose.spot_shift import has_offset, spot_shifts
from asterism.server.segmentation.order import ascending

LEAST_LEDS = 4
BRIGHTNESS_STEP = 2.5  # a LED is not that much brighter or dimmer than it was a frame ago
# 99.9 % of chi squared for 2, 4 and 6 degrees of freedom.
CHI2 = np.array([0.0, 0.0, 0.0, 0.0, 13.8, 18.5, 22.5])


@compiled
def _fit(
    layout,
    spots,
    rays,
    variances,
    systematic2,
    start_rotation,
    start_t,
    points,
    seen,
    information,
    rotation,
    t,
):
    """Refine a pose from its prediction on the spots that are not -1; returns their count and the cost."""
    count = 0
    for led in range(LEDS):
        spot = spots[led]
        if spot < 0:
            continue
        points[count] = layout[led]
        seen[count] = rays[spot]
        information[count, 0] = information[count, 2] = 1.0 / (variances[spot] + systematic2)
        information[count, 1] = 0.0
        count += 1
    rotation[:, :] = start_rotation
    t[:] = start_t
    if count < LEAST_LEDS:
        return count, NO_SOLUTION
    return count, refine_pose(rotation, t, points[:count], seen[:count], information[:count], 8)


@compiled
def follow(
    flat, rays, variances, heights, free, layouts, optics, rotations, ts, gates, brightness, focal, assignment, costs
):  # fmt: skip
    """Match predicted robots to spots.

    ``flat`` (n, 2) ideal px, y up; ``rays`` (n, 2); ``variances`` (n,) of the rays; ``heights`` (n,); ``free`` (n,);
    ``layouts`` (m, 6, 3) m, ``optics`` (m, OPTICS) as in `spot_shift`, ``rotations`` (m, 3, 3) and ``ts`` (m, 3) the
    predicted T_camera_plane, ``gates`` (m,) px, ``brightness`` (m,) grey levels. Fills ``assignment`` (m, 6) with spots
    (-1: not visible), ``costs`` (m,) with squared sigmas of SYSTEMATIC_PX (NO_SOLUTION where the robot was not found),
    updates ``rotations`` and ``ts`` of robots that were found, and takes their spots out of ``free``.
    """
    n, robots = flat.shape[0], layouts.shape[0]
    order = ascending(flat[:, 0])
    xs = flat[order, 0]
    wanted_by = np.full(n, -1)
    wanted_at = np.full(n, np.inf)
    systematic2 = (SYSTEMATIC_PX / focal) ** 2
    shifts = np.zeros((LEDS, 2))
    for robot in range(robots):
        gate = gates[robot]
        # The perspective's shift is far below the gate, that of the LEDs' optics is not.
        if has_offset(optics[robot]):
            spot_shifts(rotations[robot], ts[robot], layouts[robot], optics[robot], shifts)
        else:
            shifts[:, :] = 0.0
        for led in range(LEDS):
            assignment[robot, led] = -1
            x, y, z = ts[robot, 0], ts[robot, 1], ts[robot, 2]
            for j in range(3):
                x += rotations[robot, 0, j] * layouts[robot, led, j]
                y += rotations[robot, 1, j] * layouts[robot, led, j]
                z += rotations[robot, 2, j] * layouts[robot, led, j]
            if not z > 0.0:
                continue
            px, py = focal * (x / z + shifts[led, 0]), -focal * (y / z + shifts[led, 1])
            best, best2 = -1, gate * gate
            place = first_from(xs, px - gate)
            while place < n and xs[place] <= px + gate:
                spot = order[place]
                place += 1
                if not free[spot]:
                    continue
                away2 = (flat[spot, 0] - px) ** 2 + (flat[spot, 1] - py) ** 2
                if (
                    away2 < best2
                    and heights[spot] * BRIGHTNESS_STEP > brightness[robot]
                    and heights[spot] < brightness[robot] * BRIGHTNESS_STEP
                ):
                    best, best2 = spot, away2
            if best >= 0 and best2 < wanted_at[best]:
                if wanted_by[best] >= 0:
                    assignment[wanted_by[best] // LEDS, wanted_by[best] % LEDS] = -1
                wanted_by[best] = robot * LEDS + led
                wanted_at[best] = best2
                assignment[robot, led] = best
    points, seen, information = np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 3))
    rotation, t = np.empty((3, 3)), np.empty(3)
    trial_rotation, trial_t = np.empty((3, 3)), np.empty(3)
    trial = np.empty(LEDS, np.int64)
    for robot in range(robots):
        layout, spots = layouts[robot], assignment[robot]
        count, cost = _fit(
            layout, spots, rays, variances, systematic2, rotations[robot], ts[robot],
            points, seen, information, rotation, t,
        )  # fmt: skip
        while count > LEAST_LEDS and cost > CHI2[count]:
            # Give up the one spot without which the others fit best.
            best_led, best_cost = -1, NO_SOLUTION
            for led in range(LEDS):
                if spots[led] < 0:
                    continue
                trial[:] = spots
                trial[led] = -1
                _, without = _fit(
                    layout, trial, rays, variances, systematic2, rotations[robot], ts[robot],
                    points, seen, information, trial_rotation, trial_t,
                )  # fmt: skip
                if without < best_cost:
                    best_led, best_cost = led, without
                    rotation[:, :] = trial_rotation
                    t[:] = trial_t
            if best_led < 0:
                break
            spots[best_led] = -1
            count, cost = count - 1, best_cost
        if count < LEAST_LEDS or not cost <= CHI2[count]:
            costs[robot] = NO_SOLUTION
            spots[:] = -1
            continue
        costs[robot] = cost
        rotations[robot] = rotation
        ts[robot] = t
        for led in range(LEDS):
            if spots[led] >= 0:
                free[spots[led]] = False


@compiled
def gather_missing(flat, heights, free, layouts, rotations, ts, costs, brightness, focal, reach, assignment):
    """Give robots that were found the free spots that lie within ``reach`` px of their missing LEDs."""
    for robot in range(layouts.shape[0]):
        if costs[robot] >= NO_SOLUTION:
            continue
        for led in range(LEDS):
            if assignment[robot, led] >= 0:
                continue
            x, y, z = ts[robot, 0], ts[robot, 1], ts[robot, 2]
            for j in range(3):
                x += rotations[robot, 0, j] * layouts[robot, led, j]
                y += rotations[robot, 1, j] * layouts[robot, led, j]
                z += rotations[robot, 2, j] * layouts[robot, led, j]
            px, py = focal * x / z, -focal * y / z
            best, best2 = -1, reach * reach
            for spot in range(flat.shape[0]):
                away2 = (flat[spot, 0] - px) ** 2 + (flat[spot, 1] - py) ** 2
                if (
                    free[spot]
                    and away2 < best2
                    and heights[spot] * BRIGHTNESS_STEP > brightness[robot]
                    and heights[spot] < brightness[robot] * BRIGHTNESS_STEP
                ):
                    best, best2 = spot, away2
            if best >= 0:
                assignment[robot, led] = best
                free[best] = False


def gates_px(position_sigmas: Floats, rotation_sigmas: Floats, extents: Floats, focal: float, depths: Floats) -> Floats:
    """Radii (m,) of the gates, px: three sigma of where an LED may be, and two pixels."""
    swing = 0.5 * extents * rotation_sigmas
    gates: Floats = 2.0 + 3.0 * focal / depths * np.sqrt(position_sigmas**2 + swing**2)
    return gates
