"""How the surface bends that flat triangles were made from, told by how their neighbours are turned.

A drawing's facets lie up to its tolerance beside the surface, and are turned against it by much more than a robot's
tilt is known. Over a triangle the surface is taken for a quadratic: along each side it rises above the chord by what
the normals at its two ends say. A normal is the mean of the facets around, by Max's weights, which are exact on spheres
("Weights for computing vertex normals from facet normals", 1999). Where facets meet in an edge, or one is far larger
than the bend beside it allows (a flat face at a fillet), nothing is bent.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats

_SHARP = np.cos(np.radians(20.0))  # of a facet and the mean around a corner: beyond it they meet in an edge
_FLAT = 0.1  # of the bend by Max's weights: below it by those of area, the side belongs to a flat face
_MOST_M = 1e-3  # above a chord: no drawing is that coarse
_WEDGE = 0.02  # rad

Bools = NDArray[np.bool_]


class _Corners(NamedTuple):
    """Of every triangle's three corners (n, 3, ...): slopes by Max's weights and by the squares of areas; whether all
    facets around are alike; which way those around lie, and the cosine of half the angle that they fill.
    """

    slopes: Floats
    by_area: Floats
    smooth: Bools
    middle: Floats
    least: Floats


def facet_bends(triangles: Floats, used: Bools) -> Floats:
    """How far, times 8, the surface is above the middle of the sides 0-1, 1-2, 2-0 of each triangle: (n, 3) m.

    ``used`` (n,) are those whose facets are of the surface; others get 0.
    """
    bends = np.zeros((len(triangles), 3))
    bends[used] = _bends(triangles[used])
    return bends


def bent(u: Floats, v: Floats, bends: Floats) -> Floats:
    """How far the surface is above its triangle at the share u (n,) of corner 1 and v of corner 2, with the ``bends``
    (n, 3) of `facet_bends`.
    """
    w = 1.0 - u - v
    above: Floats = 0.5 * (w * u * bends[:, 0] + u * v * bends[:, 1] + v * w * bends[:, 2])
    return above


def _bends(t: Floats) -> Floats:
    corners = _corners(t)
    sides = t[:, [1, 2, 0]] - t
    out = np.zeros((len(t), 3))
    for k in range(3):
        here, there = _half(corners, k, sides[:, k]), _half(corners, (k + 1) % 3, -sides[:, k])
        bend = np.where(np.isnan(here), 2.0 * there, np.where(np.isnan(there), 2.0 * here, here + there))
        bend[(here * there < 0.0) | (here == 0.0) | (there == 0.0)] = 0.0  # it turns within the side, or is flat
        out[:, k] = np.where(np.abs(bend) > 8.0 * _MOST_M, 0.0, bend)
    return _told_by_others(out, sides[:, :, :2])


def _told_by_others(bends: Floats, sides: Floats) -> Floats:
    """Sides that neither of their ends tells of, nan, bend as the one of their triangle that bends most has it, in its
    direction; as the diagonals do of a cylinder's strips.
    """
    told = np.nan_to_num(bends)
    most = np.abs(told).argmax(axis=1)
    every = np.arange(len(bends))
    by, bend = sides[every, most], told[every, most]
    share = (sides * by[:, None]).sum(axis=2) / np.maximum((by**2).sum(axis=1), 1e-300)[:, None]
    filled: Floats = np.where(np.isnan(bends), bend[:, None] * np.minimum(share**2, 1.0), bends)
    return filled


def _half(corners: _Corners, k: int, d: Floats) -> Floats:
    """Half the bend of sides d (n, 3) that leave corner k, as that corner tells it; nan where it tells nothing."""
    xy = d[:, :2]
    half = (corners.slopes[:, k] * xy).sum(axis=1) - d[:, 2]
    guarded = (corners.by_area[:, k] * xy).sum(axis=1) - d[:, 2]
    half = np.where(guarded * np.sign(half) >= _FLAT * np.abs(half), half, 0.0)
    # A mean of facets tells how the surface leaves along a side only if there are facets behind, too.
    behind = -(corners.middle[:, k] * xy).sum(axis=1) >= corners.least[:, k] * np.linalg.norm(xy, axis=1)
    told: Floats = np.where(corners.smooth[:, k] & behind, half, np.nan)
    return told


def _corners(t: Floats) -> _Corners:
    vertex, count = _vertices(t)
    normals = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])  # twice the area long
    area = np.linalg.norm(normals, axis=1)
    ahead, back = t[:, [1, 2, 0]] - t, t[:, [2, 0, 1]] - t
    long = (ahead**2).sum(axis=2) * (back**2).sum(axis=2)

    def summed(values: Floats) -> Floats:
        flat = values.reshape(len(vertex), -1)
        sums = [np.bincount(vertex, flat[:, axis], count) for axis in range(flat.shape[1])]
        return np.stack(sums, axis=1)

    by_max = summed(normals[:, None] / long[..., None])
    by_area = summed(np.repeat(normals * area[:, None], 3, axis=0))
    facing = (np.repeat(normals, 3, axis=0) * by_max[vertex]).sum(axis=1)
    sharp = facing < _SHARP * np.repeat(area, 3) * np.linalg.norm(by_max, axis=1)[vertex]
    smooth = np.bincount(vertex, sharp, count) == 0
    u1, u2 = _unit(ahead[..., :2]), _unit(back[..., :2])
    angle = np.arctan2(u1[..., 0] * u2[..., 1] - u1[..., 1] * u2[..., 0], (u1 * u2).sum(axis=2))
    turned = u2 - u1  # the integral of the directions of a wedge is this, turned by -90 degrees
    middle = _unit(summed(np.stack([turned[..., 1], -turned[..., 0]], axis=-1)))
    filled = summed(angle)[:, 0]
    least = np.where(filled > 2.0 * np.pi - _WEDGE, -np.inf, np.cos(np.minimum(filled / 2.0 + _WEDGE, np.pi)))
    shape = (len(t), 3)

    def of(values: Floats) -> Floats:
        out: Floats = values[vertex].reshape(*shape, *values.shape[1:])
        return out

    return _Corners(of(_slopes(by_max)), of(_slopes(by_area)), smooth[vertex].reshape(shape), of(middle), of(least))


def _slopes(normals: Floats) -> Floats:
    slopes: Floats = -normals[:, :2] / normals[:, 2:]
    return slopes


def _unit(vectors: Floats) -> Floats:
    unit: Floats = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
    return unit


def _vertices(t: Floats) -> tuple[NDArray[np.int64], int]:
    """Which vertex every corner (3 n,) is, of how many: corners at the very same place are one."""
    bits = (t.reshape(-1, 3) + 0.0).view(np.uint64)  # -0.0 is 0.0
    mixed = np.zeros(len(bits), np.uint64)
    for axis, odd in enumerate((0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)):
        mixed = (mixed ^ bits[:, axis]) * np.uint64(odd)
        mixed ^= mixed >> np.uint64(29)
    found, vertex = np.unique(mixed, return_inverse=True)
    return vertex.astype(np.int64), len(found)
