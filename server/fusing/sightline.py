"""The line of sight to a robot that one camera may see: where along it other cameras' spots bear it out."""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled

AROUND = 0.75  # of a constellation's extent: how far from its middle its LEDs are at most


class Borne(NamedTuple):
    """Room for n spots of other cameras that bear a robot out: their ``depths`` (n,) along a line of sight, m, by how
    much a robot's own may be another, ``slack`` (n,), m, and which they are, ``near`` (n, 2): camera and row.
    """

    depths: Any
    slack: Any
    near: Any


@compiled
def world_direction(scene, c, direction, out):
    """Fill ``out`` (3,): a direction of camera c in the world."""
    for i in range(3):
        out[i] = 0.0
        for j in range(3):
            out[i] += scene.turns[c, j, i] * direction[j]


@compiled
def supports_along(scene, free, directions, home, middle, extent, limits, borne):
    """Where other cameras' spots pass the line of sight ``middle`` (3,) of camera ``home``: fills the
    `Borne`; returns how many there are.
    """
    line, other = np.empty(3), np.empty(3)
    world_direction(scene, home, middle, line)
    count = 0
    for c in range(scene.turns.shape[0]):
        if c == home:
            continue
        wx = scene.origins[home, 0] - scene.origins[c, 0]
        wy = scene.origins[home, 1] - scene.origins[c, 1]
        wz = scene.origins[home, 2] - scene.origins[c, 2]
        for spot in range(scene.first[c], scene.first[c + 1]):
            if not free[spot]:
                continue
            world_direction(scene, c, directions[spot], other)
            b = line[0] * other[0] + line[1] * other[1] + line[2] * other[2]
            d = line[0] * wx + line[1] * wy + line[2] * wz
            e = other[0] * wx + other[1] * wy + other[2] * wz
            sine2 = 1.0 - b * b
            if sine2 < 1e-4:
                continue
            depth, there = (b * e - d) / sine2, (e - b * d) / sine2
            if not (depth > 0.0 and there > 0.0):
                continue
            gap2 = 0.0
            for i in range(3):
                w = wx if i == 0 else (wy if i == 1 else wz)
                gap2 += (w + depth * line[i] - there * other[i]) ** 2
            wide = AROUND * extent
            if gap2 < wide * wide and limits.near[home] - extent < depth < limits.far[home] + extent:
                borne.depths[count], borne.slack[count] = depth, wide / math.sqrt(sine2)
                borne.near[count, 0], borne.near[count, 1] = c, spot
                count += 1
    return count


@compiled
def agreeing(depths, slack, count, depth):
    """How many of the other cameras' spots may belong to a robot at that distance."""
    some = 0
    for k in range(count):
        if abs(depths[k] - depth) < slack[k]:
            some += 1
    return some


@compiled
def nearest_depth(depths, slack, count, needed):
    """The least distance at which enough of the other cameras' spots may belong to a robot; inf if there is none."""
    nearest = np.inf
    for k in range(count):
        for end in (-0.999, 0.999):
            depth = depths[k] + end * slack[k]
            if depth < nearest and agreeing(depths, slack, count, depth) >= needed:
                nearest = depth
    return nearest
