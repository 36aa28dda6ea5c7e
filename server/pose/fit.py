"""Poses of labelled spots: how well six spots, or fewer, are the LEDs of a robot."""

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.planar import NO_SOLUTION, homography_ls, refine_pose, translation, two_rotations

LEDS = 6
SYSTEMATIC_PX = 0.25  # what calibration and LED positions may be off, one sigma
CHI2 = np.array([0.0, 0.0, 0.0, 0.0, 13.8, 18.5, 22.5])  # 99.9 % for two, four and six degrees of freedom


@compiled
def fit_labelled(layout, spots, rays, variances, systematic2, iterations, points, seen, information, rotations, ts, h):
    """Pose of a robot whose LEDs are the given spots (-1: not visible), turned towards the camera.

    Returns how many LEDs it rests on, the cost (squared sigmas) and which of ``rotations``, ``ts`` holds the pose;
    a negative index if there is none. ``points``, ``seen``, ``information``, ``h`` are scratch of six rows.
    """
    count = 0
    cx = cy = cz = 0.0
    for led in range(LEDS):
        spot = spots[led]
        if spot < 0:
            continue
        points[count, 0], points[count, 1], points[count, 2] = layout[led, 0], layout[led, 1], layout[led, 2]
        cx += layout[led, 0]
        cy += layout[led, 1]
        cz += layout[led, 2]
        seen[count, 0], seen[count, 1] = rays[spot, 0], rays[spot, 1]
        information[count, 0] = information[count, 2] = 1.0 / (variances[spot] + systematic2)
        information[count, 1] = 0.0
        count += 1
    cx /= count
    cy /= count
    cz /= count
    for k in range(count):
        points[k, 0] -= cx
        points[k, 1] -= cy
        points[k, 2] -= cz
    p, s, w = points[:count], seen[:count], information[:count]
    if not homography_ls(p, s, h) or not two_rotations(h, rotations[0], rotations[1]):
        return count, NO_SOLUTION, -1
    best, best_cost = -1, NO_SOLUTION
    for which in range(2):
        translation(rotations[which], p, s, ts[which])
        if not ts[which, 2] > 0.0:
            continue
        cost = refine_pose(rotations[which], ts[which], p, s, w, iterations)
        towards = 0.0
        for i in range(3):
            towards += rotations[which, i, 2] * ts[which, i]
        if cost < best_cost and towards < 0.0:
            best, best_cost = which, cost
    if best >= 0:
        for i in range(3):
            ts[best, i] -= rotations[best, i, 0] * cx + rotations[best, i, 1] * cy + rotations[best, i, 2] * cz
    return count, best_cost, best


@compiled
def misfit(layout, led, rotation, t, ray):
    """Squared distance, in ray units, between a ray and where a pose puts an LED."""
    x, y, z = t[0], t[1], t[2]
    for j in range(3):
        x += rotation[0, j] * layout[led, j]
        y += rotation[1, j] * layout[led, j]
        z += rotation[2, j] * layout[led, j]
    return (x / z - ray[0]) ** 2 + (y / z - ray[1]) ** 2


@compiled
def median_of(numbers, spots):
    """Median of the numbers (n,) of a robot's visible spots."""
    values = np.empty(LEDS)
    count = 0
    for led in range(LEDS):
        if spots[led] >= 0:
            k = count
            while k > 0 and values[k - 1] > numbers[spots[led]]:
                values[k] = values[k - 1]
                k -= 1
            values[k] = numbers[spots[led]]
            count += 1
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])
