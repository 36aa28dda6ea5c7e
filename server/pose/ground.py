"""The rig's surface for the kernels: `protocol.surface` compiled, a place at a time; the point of it that is nearest.

`protocol.surface` says what the numbers mean, and is the slow way to the same ones; tests hold the two together.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import STEEPEST, TERMS, Heights, Surface
from asterism.server.compiled import compiled

STEPS = 8  # of Newton's method, from a point to the nearest of the surface
NEAR = 1e-11  # m: a step that moves the foot less is the last
Z, ZX, ZY, ZXX, ZXY, ZYY = range(6)  # of what a surface is at a place: height, slopes, bends


class Terrain(NamedTuple):
    """A surface in its own frame: ``terms`` (10,) about ``about`` (3,) of a quadric; of a grid ``values`` and
    ``sigmas`` (nx, ny), both (0, 0) where it is none, with ``grid`` (2, 2): origin and step; ``edge`` (k, 2); ``known``
    (2,): sigma, m, and tilt sigma, rad.
    """

    terms: Floats
    about: Floats
    values: Floats
    sigmas: Floats
    grid: Floats
    edge: Floats
    known: Floats

    @staticmethod
    def of(surface: Surface) -> "Terrain":
        """That of a surface; arrays are its own: kernels are compiled anew for read-only ones."""
        shape, edge = surface.shape, np.array(surface.edge)
        known = np.array([surface.sigma_m, surface.tilt_sigma_rad])
        if isinstance(shape, Heights):
            grid = np.array([shape.origin, shape.step])
            nothing = np.zeros(len(TERMS)), np.zeros(3)
            return Terrain(*nothing, np.array(shape.values), np.array(shape.sigmas), grid, edge, known)
        none = np.zeros((0, 0))
        return Terrain(np.array(shape.terms), np.array(shape.about), none, none, np.ones((2, 2)), edge, known)


class Touching(NamedTuple):
    """Where a point touches a surface, scratch: ``foot`` (2,) of the surface's x and y, and what it is there, ``here``
    (6,); ``patch`` (4, 4) and ``weights`` (6, 4) of a grid.
    """

    foot: Any
    here: Any
    patch: Any
    weights: Any


@compiled
def touching_room():
    """Room for one point's."""
    return Touching(np.zeros(2), np.zeros(6), np.zeros((4, 4)), np.zeros((6, 4)))


@compiled
def _fill_quadric(terms, about, at_x, at_y, here):
    """Fill ``here`` (6,) with a quadric at a place; whether it is there."""
    x, y = at_x - about[0], at_y - about[1]
    b = terms[3] + terms[8] * x + terms[9] * y
    c = terms[0] + terms[1] * x + terms[2] * y + terms[4] * x * x + terms[5] * y * y + terms[7] * x * y
    square = b * b - 4.0 * terms[6] * c
    if not square > 0.0:
        return False
    root = math.sqrt(square)
    z = -2.0 * c / (b + root)
    if not math.isfinite(z):
        return False
    fx = terms[1] + 2.0 * terms[4] * x + terms[7] * y + terms[8] * z
    fy = terms[2] + 2.0 * terms[5] * y + terms[7] * x + terms[9] * z
    zx, zy = -fx / root, -fy / root
    here[Z], here[ZX], here[ZY] = z + about[2], zx, zy
    here[ZXX] = -(2.0 * terms[4] + 2.0 * terms[8] * zx + 2.0 * terms[6] * zx * zx) / root
    here[ZXY] = -(terms[7] + terms[8] * zy + terms[9] * zx + 2.0 * terms[6] * zx * zy) / root
    here[ZYY] = -(2.0 * terms[5] + 2.0 * terms[9] * zy + 2.0 * terms[6] * zy * zy) / root
    return True


@compiled
def _weigh(t, value, slope, bend):
    """Fill what four values at -1, 0, 1, 2 count at t from 0 to 1, and the derivatives of that (Keys, 1981)."""
    value[0], slope[0], bend[0] = t * (-0.5 + t * (1.0 - 0.5 * t)), -0.5 + t * (2.0 - 1.5 * t), 2.0 - 3.0 * t
    value[1], slope[1], bend[1] = 1.0 + t * t * (1.5 * t - 2.5), t * (4.5 * t - 5.0), 9.0 * t - 5.0
    value[2], slope[2], bend[2] = t * (0.5 + t * (2.0 - 1.5 * t)), 0.5 + t * (4.0 - 4.5 * t), 4.0 - 9.0 * t
    value[3], slope[3], bend[3] = t * t * (0.5 * t - 0.5), t * (1.5 * t - 1.0), 3.0 * t - 1.0


@compiled
def _joined(patch, by_x, by_y):
    total = 0.0
    for a in range(4):
        row = 0.0
        for b in range(4):
            row += patch[a, b] * by_y[b]
        total += by_x[a] * row
    return total


@compiled
def _cell(place, last):
    """Which cell of a grid a place, in steps, lies in; -1 beyond it."""
    if not 0.0 <= place <= last or last < 1:
        return -1
    return min(int(place), last - 1)


@compiled
def _fill_grid(values, grid, at_x, at_y, touching):
    """Fill ``touching.here`` with a grid of heights at a place; whether it is there."""
    patch, weights, here = touching.patch, touching.weights, touching.here
    sx, sy = grid[1, 0], grid[1, 1]
    place_x, place_y = (at_x - grid[0, 0]) / sx, (at_y - grid[0, 1]) / sy
    nx, ny = values.shape
    i, j = _cell(place_x, nx - 1), _cell(place_y, ny - 1)
    if i < 0 or j < 0:
        return False
    for a in range(4):
        for b in range(4):
            p, q = i - 1 + a, j - 1 + b
            patch[a, b] = values[p, q] if 0 <= p < nx and 0 <= q < ny else math.nan
            if 1 <= a <= 2 and 1 <= b <= 2 and not math.isfinite(patch[a, b]):
                return False
    for b in range(4):
        if not math.isfinite(patch[0, b]):
            patch[0, b] = 2.0 * patch[1, b] - patch[2, b]
        if not math.isfinite(patch[3, b]):
            patch[3, b] = 2.0 * patch[2, b] - patch[1, b]
    for a in range(4):
        if not math.isfinite(patch[a, 0]):
            patch[a, 0] = 2.0 * patch[a, 1] - patch[a, 2]
        if not math.isfinite(patch[a, 3]):
            patch[a, 3] = 2.0 * patch[a, 2] - patch[a, 1]
    _weigh(place_x - i, weights[0], weights[1], weights[2])
    _weigh(place_y - j, weights[3], weights[4], weights[5])
    here[Z] = _joined(patch, weights[0], weights[3])
    here[ZX], here[ZY] = _joined(patch, weights[1], weights[3]) / sx, _joined(patch, weights[0], weights[4]) / sy
    here[ZXX], here[ZYY] = (
        _joined(patch, weights[2], weights[3]) / (sx * sx),
        _joined(patch, weights[0], weights[5]) / (sy * sy),
    )
    here[ZXY] = _joined(patch, weights[1], weights[4]) / (sx * sy)
    return True


@compiled
def fill_ground(terrain, x, y, touching):
    """Fill ``touching.here`` (6,) with what the surface is at a place of its frame; whether there is one, whatever its
    ``edge``.
    """
    here = touching.here
    if terrain.values.shape[0] > 0:
        there = _fill_grid(terrain.values, terrain.grid, x, y, touching)
    else:
        there = _fill_quadric(terrain.terms, terrain.about, x, y, here)
    return there and math.sqrt(here[ZX] ** 2 + here[ZY] ** 2) <= STEEPEST


@compiled
def sigma_at(terrain, x, y):
    """One sigma of the height along the normal, m, at a place where there is a surface."""
    known, sigmas, grid = terrain.known[0], terrain.sigmas, terrain.grid
    if sigmas.shape[0] == 0:
        return known
    place_x, place_y = (x - grid[0, 0]) / grid[1, 0], (y - grid[0, 1]) / grid[1, 1]
    i, j = _cell(place_x, sigmas.shape[0] - 1), _cell(place_y, sigmas.shape[1] - 1)
    if i < 0 or j < 0:
        return known
    a, b = place_x - i, place_y - j
    low = (1.0 - a) * sigmas[i, j] + a * sigmas[i + 1, j]
    high = (1.0 - a) * sigmas[i, j + 1] + a * sigmas[i + 1, j + 1]
    own = (1.0 - b) * low + b * high
    return math.sqrt(known * known + own * own)


@compiled
def is_within(edge, x, y):
    """Whether a place lies inside a polygon (k, 2), as `surface.within`; of none everything does."""
    count, inside = edge.shape[0], False
    for k in range(count):
        m = k + 1 if k + 1 < count else 0
        if (edge[k, 1] > y) != (edge[m, 1] > y):
            side = (y - edge[k, 1]) / (edge[m, 1] - edge[k, 1])
            if x < edge[k, 0] + side * (edge[m, 0] - edge[k, 0]):
                inside = not inside
    return inside or count == 0


@compiled
def touch(terrain, x, y, z, touching):
    """How far a point of the surface's frame is from it, along the normal, and whether there is a surface there.

    Fills ``touching`` with the nearest point's place and what the surface is there.
    """
    foot, here = touching.foot, touching.here
    foot[0], foot[1] = x, y
    for _ in range(STEPS):
        if not fill_ground(terrain, foot[0], foot[1], touching):
            return math.nan, False
        # The line from the point to its foot is along the normal: 0 = foot - point - above * slopes.
        above, zx, zy = z - here[Z], here[ZX], here[ZY]
        a = 1.0 + zx * zx - above * here[ZXX]
        b = zx * zy - above * here[ZXY]
        d = 1.0 + zy * zy - above * here[ZYY]
        off_x, off_y = foot[0] - x - above * zx, foot[1] - y - above * zy
        det = a * d - b * b
        if not abs(det) > 1e-12:
            return math.nan, False
        step_x, step_y = (d * off_x - b * off_y) / det, (a * off_y - b * off_x) / det
        foot[0] -= step_x
        foot[1] -= step_y
        if abs(step_x) + abs(step_y) < NEAR:
            break
    if not fill_ground(terrain, foot[0], foot[1], touching):
        return math.nan, False
    dx, dy, dz = x - foot[0], y - foot[1], z - here[Z]
    size = math.sqrt(1.0 + here[ZX] ** 2 + here[ZY] ** 2)
    nx, ny, nz = -here[ZX] / size, -here[ZY] / size, 1.0 / size
    distance = dx * nx + dy * ny + dz * nz
    off = math.sqrt((dx - distance * nx) ** 2 + (dy - distance * ny) ** 2 + (dz - distance * nz) ** 2)
    return distance, off <= 1e-7 + 1e-6 * abs(distance)
