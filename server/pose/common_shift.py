"""Errors that all spots of a robot share (light to one side of all its LEDs alike), carried through the solved pose.

They leave no residual, and fewer spots' noise would hide them however many there are; so they are no variance of spots
but a term of the pose's covariance: an error v of all rays moves the pose by (J' W J)^-1 J' W v, J the derivatives, W
the information, and a covariance of v with it (as `led_doubt` does for what is not known of an LED's own light).
"""

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.covariance import invert
from asterism.server.pose.fit import LEDS
from asterism.server.pose.matched import LEAST_SIGMA_PX
from asterism.server.pose.planar import NO_SOLUTION, normal_equations
from asterism.server.pose.rotations import mapped

SMALL = 1e-8  # of a ray: so that the robust loss sees no outlier in it


@compiled
def _moved_by(rotation, t, layout, labels, measured, focal, moved):
    """Fill ``moved`` (2, 6): how a pose moves (of the plane's origin, and rotation) with all rays' x, and y."""
    points, rays, information = np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 3))
    a, noise, right = np.empty((6, 6)), np.empty((6, 6)), np.empty(6)
    floor = (LEAST_SIGMA_PX / focal) ** 2
    count = 0
    for led in range(LEDS):
        spot = labels[led]
        if spot < 0:
            continue
        xx, xy = measured.covariances[spot, 0] + floor, measured.covariances[spot, 1]
        yy = measured.covariances[spot, 2] + floor
        det = xx * yy - xy * xy
        points[count] = layout[led]
        information[count, 0], information[count, 1], information[count, 2] = yy / det, -xy / det, xx / det
        count += 1
    for axis in range(2):
        for k in range(count):
            x, y, z = mapped(rotation, t, points[k])
            rays[k, 0], rays[k, 1] = x / z, y / z
            rays[k, axis] += SMALL
        normal_equations(rotation, t, points[:count], rays[:count], information[:count], a, right)
        invert(a, noise)
        for i in range(6):
            moved[axis, i] = 0.0
            for j in range(6):
                moved[axis, i] += noise[i, j] * right[j] / SMALL


@compiled
def add_common_shifts(constellations, matched, measured, commons, focal, solutions):
    """Add to the covariances of the `Solutions` what errors do that all spots of a robot share.

    ``commons`` (m, 3) xx, xy, yy are their covariances, of rays; ``focal`` px; the rest as in `solve.solve_robots`.
    """
    moved = np.empty((2, 6))
    for k in range(matched.robots.shape[0]):
        xx, xy, yy = commons[k, 0], commons[k, 1], commons[k, 2]
        for which in range(2):
            if not xx + yy > 0.0 or not solutions.costs[k, which] < NO_SOLUTION:
                continue
            rotation, t = solutions.rotations[k, which], solutions.ts[k, which]
            layout = constellations.layouts[matched.robots[k]]
            _moved_by(rotation, t, layout, matched.assignment[k], measured, focal, moved)
            covariance = solutions.covariances[k, which]
            for i in range(6):
                for j in range(6):
                    u, v = moved[0, i], moved[1, i]
                    covariance[i, j] += u * (xx * moved[0, j] + xy * moved[1, j])
                    covariance[i, j] += v * (xy * moved[0, j] + yy * moved[1, j])
