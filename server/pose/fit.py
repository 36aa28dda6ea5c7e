"""Poses of labelled spots: how well six spots, or fewer, are the LEDs of a robot."""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.planar import NO_SOLUTION, homography_ls, refine_pose, translation, two_rotations
from asterism.server.pose.sphere import project, touch

LEDS = 6
SYSTEMATIC_PX = 0.25  # what calibration and LED positions may be off, one sigma
CHI2 = np.array([0.0, 0.0, 0.0, 0.0, 13.8, 18.5, 22.5])  # 99.9 % for two, four and six degrees of freedom


class FitRoom(NamedTuple):
    """Room for fits of one robot: ``points`` (6, 3), ``seen`` (6, 2) and ``information`` (6, 3) of its visible LEDs;
    ``rotations`` (2, 3, 3) and ``ts`` (2, 3) of the poses that are found, T_camera_plane, m; ``h`` (3, 3).
    """

    points: Any
    seen: Any
    information: Any
    rotations: Any
    ts: Any
    h: Any


@compiled
def fit_room():
    """Empty `FitRoom`."""
    points, seen, information = np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 3))
    return FitRoom(points, seen, information, np.empty((2, 3, 3)), np.empty((2, 3)), np.empty((3, 3)))


@compiled
def _turn_back(frame, rotation, t):
    """A pose (3, 3), (3,) in the axes ``frame`` becomes one in the camera's, in place."""
    for column in range(4):
        x, y, z = (rotation[0, column], rotation[1, column], rotation[2, column]) if column < 3 else (t[0], t[1], t[2])
        for i in range(3):
            value = frame[0, i] * x + frame[1, i] * y + frame[2, i] * z
            if column < 3:
                rotation[i, column] = value
            else:
                t[i] = value


@compiled
def _gather(layout, labels, rays, room, frame):
    """Fill the room's visible ``points`` about their mean, where they are ``seen`` in the plane that touches the sphere
    of directions in their midst, and its ``frame`` (3, 3). Returns their count and their mean, m.
    """
    points, seen = room.points, room.seen
    count = 0
    cx = cy = cz = mx = my = mz = 0.0
    for led in range(LEDS):
        spot = labels[led]
        if spot < 0:
            continue
        points[count, 0], points[count, 1], points[count, 2] = layout[led, 0], layout[led, 1], layout[led, 2]
        cx += layout[led, 0]
        cy += layout[led, 1]
        cz += layout[led, 2]
        x, y = rays[spot, 0], rays[spot, 1]
        length = math.sqrt(1.0 + x * x + y * y)
        mx += x / length
        my += y / length
        mz += 1.0 / length
        count += 1
    cx /= count
    cy /= count
    cz /= count
    length = math.sqrt(mx * mx + my * my + mz * mz)
    touch((mx / length, my / length, mz / length), frame)
    k = 0
    for led in range(LEDS):
        spot = labels[led]
        if spot >= 0:
            points[k, 0] -= cx
            points[k, 1] -= cy
            points[k, 2] -= cz
            seen[k, 0], seen[k, 1] = project(frame, (rays[spot, 0], rays[spot, 1], 1.0))
            k += 1
    return count, cx, cy, cz


@compiled
def fit_labelled(layout, labels, rays, variances, systematic2, iterations, room):
    """Pose of a robot whose LEDs are the spots ``labels`` (6,; -1: not visible), turned towards the camera.

    ``layout`` (6, 3) m; ``rays`` (n, 2) of all spots with the ``variances`` (n,) of their directions, rad^2, to which
    ``systematic2`` is added. Returns how many LEDs the pose rests on, the cost (squared sigmas) and which of the
    `FitRoom`'s poses it is; a negative index if there is none.
    """
    information, rotations, ts, frame = room.information, room.rotations, room.ts, np.empty((3, 3))
    count, cx, cy, cz = _gather(layout, labels, rays, room, frame)
    k = 0
    for led in range(LEDS):
        if labels[led] >= 0:
            information[k, 0] = information[k, 2] = 1.0 / (variances[labels[led]] + systematic2)
            information[k, 1] = 0.0
            k += 1
    p, s, w = room.points[:count], room.seen[:count], information[:count]
    if not homography_ls(p, s, room.h) or not two_rotations(room.h, rotations[0], rotations[1]):
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
        _turn_back(frame, rotations[best], ts[best])
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
