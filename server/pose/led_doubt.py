"""What is not known of LEDs' own light, as their led.yaml tells it (`protocol.led_offset`), in spots and in poses.

Errors of single spots widen these. Errors that all LEDs of a robot share leave no residuals, and fewer spots' noise
would hide them however many spots there are; so they are carried through the solved pose one by one.
"""

import math

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import MOST_KNOTS, LedOffset
from asterism.server.compiled import compiled
from asterism.server.pose.covariance import invert, move_origin
from asterism.server.pose.planar import normal_equations
from asterism.server.pose.spot_shift import AXIS, DOUBT, DOUBTS, along_axis

SMALL = 1e-8  # m: so that the robust loss sees no outlier in it


def own_scatter(offset: LedOffset | None, strange: Floats) -> Floats:
    """What is to be added to the variances of spots (n,), px^2: the LEDs' own scatter in place of what the estimator
    of centres allows for ``strange`` light (n,) px.
    """
    if offset is None or math.isnan(offset.scatter_px):
        return np.zeros(len(strange))
    change: Floats = np.where(strange <= offset.strange_px, offset.scatter_px**2 - strange**2, 0.0)
    return change


@compiled
def add_doubts(rotation, t, lit, optics, arm, covariance):
    """Add to a pose's ``covariance`` (6, 6), about the plane's origin, how wrong the shift of its LEDs' light may be.

    ``rotation`` and ``t`` are T_camera_plane as of ``lit`` (`matched.Lit`), ``arm`` (3,) the origin as seen from the
    LEDs' mean: an error v of the spots moves the pose by (J' W J)^-1 J' W v, J the derivatives, W the information.
    """
    n = lit.points.shape[0]
    angles, by_shift, a, seen = np.empty(n), np.empty((n, 6)), np.empty((6, 6)), np.empty((1, 2))
    axis = np.empty(3)
    for i in range(3):
        axis[i] = 0.0
        for j in range(3):
            axis[i] += rotation[i, j] * optics[AXIS + j]
    for k in range(n):
        x, y, z = t[0], t[1], t[2]
        for j in range(3):
            x += rotation[0, j] * lit.points[k, j]
            y += rotation[1, j] * lit.points[k, j]
            z += rotation[2, j] * lit.points[k, j]
        dot = axis[0] * x + axis[1] * y + axis[2] * z
        angles[k] = math.asin(math.sqrt(max(1.0 - dot * dot / (x * x + y * y + z * z), 0.0)))
        # J' W v of this LED's spot, moved along the axis.
        seen[0, 0] = x / z + SMALL * (axis[0] - x / z * axis[2]) / z
        seen[0, 1] = y / z + SMALL * (axis[1] - y / z * axis[2]) / z
        one = slice(k, k + 1)
        normal_equations(rotation, t, lit.points[one], seen, lit.information[one], a, by_shift[k])
    noise, right, moved, doubts = np.empty((6, 6)), np.empty(6), np.empty(6), np.zeros((6, 6))
    normal_equations(rotation, t, lit.points, lit.seen, lit.information, a, moved)
    invert(a, noise)
    for row in range(int(optics[DOUBTS])):
        right[:] = 0.0
        for k in range(n):
            shift = along_axis(optics, DOUBT + row * MOST_KNOTS, angles[k]) / SMALL
            for i in range(6):
                right[i] += shift * by_shift[k, i]
        for i in range(6):
            moved[i] = 0.0
            for j in range(6):
                moved[i] += noise[i, j] * right[j]
        for i in range(6):
            for j in range(6):
                doubts[i, j] += moved[i] * moved[j]
    move_origin(doubts, arm)
    covariance += doubts
