"""A tool's way over the patches of a surface: for how long each patch's middle is under the disc, exactly, for a
straight way at an even speed between one pose and the next.

The disc lies in the surface's tangent plane. There a step (dx, dy) of the frame is as long as the root of dx^2 + dy^2 +
(slope . (dx, dy))^2, so that over x and y the disc is an ellipse, and a middle is under it between the two roots of a
quadratic equation in time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled

SPEED_OVER_S = 0.1  # speed and direction are those over so long a way: noise from frame to frame looks like speed
_STILL_M2 = 1e-18  # a way of a nanometre, squared: none


class Way(NamedTuple):
    """Where a tool was, in the order of time, n times: ``times_ns`` (n,); ``feet`` (n, 3) m on the surface and
    ``slopes`` (n, 2) of it, in its frame; ``leaves`` (n,) m, how far beyond its rim a patch must be to be left;
    ``joined`` (n,): it came there straight from the one before.
    """

    times_ns: NDArray[np.int64]
    feet: Floats
    slopes: Floats
    leaves: Floats
    joined: NDArray[np.bool_]


class Lattice(NamedTuple):
    """Patches as in a grid: ``inside`` (rows, columns), ``pitch`` m, the first ``column`` and ``row``."""

    inside: NDArray[np.bool_]
    pitch: float
    column: int
    row: int


class Sums(NamedTuple):
    """What is added to, arrays (rows, columns) as of `Visits`; ``near`` is the step after which the tool had not yet
    left the patch.
    """

    dwell: Floats
    passes: NDArray[np.int64]
    path: Floats
    shift: Floats
    last_ns: NDArray[np.int64]
    near: NDArray[np.int64]


@compiled
def sweep(way, first, step, radius, lattice, sums):
    """Add a tool's way from its place ``first`` (1 at least; those before were added already) on; ``step`` is the
    number of the step that led to the one before. Returns the number of the last step.
    """
    for i in range(first, len(way.times_ns)):
        step += 1
        if not way.joined[i]:
            step += 1  # what it was over, it has left
            continue
        vx, vy, speed = _motion(way, i)
        _segment(way, i, step, radius, (vx, vy, speed), lattice, sums)
    return step


@compiled
def _motion(way, i):
    """Velocity along x and y, as long as the speed on the surface, and that speed, m/s, about the way to place i."""
    half = 0.5e9 * SPEED_OVER_S
    a, b = i - 1, i
    while a > 0 and way.joined[a] and way.times_ns[i - 1] - way.times_ns[a - 1] <= half:
        a -= 1
    while b + 1 < len(way.times_ns) and way.joined[b + 1] and way.times_ns[b + 1] - way.times_ns[i] <= half:
        b += 1
    dt = (way.times_ns[b] - way.times_ns[a]) * 1e-9
    dx, dy = way.feet[b, 0] - way.feet[a, 0], way.feet[b, 1] - way.feet[a, 1]
    dz = way.feet[b, 2] - way.feet[a, 2]
    speed = np.sqrt(dx * dx + dy * dy + dz * dz) / dt
    flat = np.sqrt(dx * dx + dy * dy)
    if flat == 0.0:
        return 0.0, 0.0, speed
    return dx / flat * speed, dy / flat * speed, speed


@compiled
def _segment(way, i, step, radius, motion, lattice, sums):
    """Add the straight way to place i."""
    t0, dt = way.times_ns[i - 1], (way.times_ns[i] - way.times_ns[i - 1]) * 1e-9
    x0, y0 = way.feet[i - 1, 0], way.feet[i - 1, 1]
    dx, dy = way.feet[i, 0] - x0, way.feet[i, 1] - y0
    sx = 0.5 * (way.slopes[i - 1, 0] + way.slopes[i, 0])
    sy = 0.5 * (way.slopes[i - 1, 1] + way.slopes[i, 1])
    gxx, gxy, gyy = 1.0 + sx * sx, sx * sy, 1.0 + sy * sy
    a = gxx * dx * dx + 2.0 * gxy * dx * dy + gyy * dy * dy
    outer = radius + max(way.leaves[i - 1], way.leaves[i])
    inner2, outer2 = radius * radius, outer * outer
    det = 1.0 + sx * sx + sy * sy
    rows, columns = lattice.inside.shape
    half_x, half_y = outer * np.sqrt(gyy / det), outer * np.sqrt(gxx / det)
    j0, j1 = _between(min(x0, x0 + dx) - half_x, max(x0, x0 + dx) + half_x, lattice.pitch, lattice.column, columns)
    i0, i1 = _between(min(y0, y0 + dy) - half_y, max(y0, y0 + dy) + half_y, lattice.pitch, lattice.row, rows)
    for r in range(i0, i1):
        ey = (lattice.row + r + 0.5) * lattice.pitch - y0
        for c in range(j0, j1):
            if not lattice.inside[r, c]:
                continue
            ex = (lattice.column + c + 0.5) * lattice.pitch - x0
            gx, gy = gxx * ex + gxy * ey, gxy * ex + gyy * ey
            off2, b = ex * gx + ey * gy, dx * gx + dy * gy
            u0, u1, ends_near = _under(a, b, off2, inner2, outer2)
            over = sums.near[r, c] == step - 1
            if u1 > u0:
                if not over:
                    sums.passes[r, c] += 1
                over = True
                dwell = (u1 - u0) * dt
                sums.dwell[r, c] += dwell
                sums.path[r, c] += motion[2] * dwell
                sums.shift[r, c, 0] += motion[0] * dwell
                sums.shift[r, c, 1] += motion[1] * dwell
                sums.last_ns[r, c] = t0 + np.int64(u1 * dt * 1e9)
            if over and ends_near:
                sums.near[r, c] = step


@compiled
def _under(a, b, off2, inner2, outer2):
    """Between which shares of the way a middle is under the disc (none: two that are equal), and whether at the end it
    is not yet left: ``off2`` is its squared distance at the start, off2 - 2 b u + a u^2 after a share u.
    """
    end2 = off2 - 2.0 * b + a
    ends_near = end2 <= outer2
    if off2 <= inner2 and end2 <= inner2:
        return 0.0, 1.0, ends_near
    root2 = b * b - a * (off2 - inner2)
    if a <= _STILL_M2 or root2 <= 0.0:
        return 0.0, 0.0, ends_near
    root = np.sqrt(root2)
    u0, u1 = max(0.0, (b - root) / a), min(1.0, (b + root) / a)
    return u0, max(u0, u1), ends_near


@compiled
def _between(least, most, pitch, first, count):
    """The patches, from the first to before the last of a grid's ``count``, whose middles are between the two."""
    begin = np.int64(np.ceil(least / pitch - 0.5)) - first
    end = np.int64(np.floor(most / pitch - 0.5)) + 1 - first
    return max(begin, 0), max(min(end, count), 0)
