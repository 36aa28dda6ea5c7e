"""How much likelier spots of several cameras are as the LEDs of one robot than as other lights."""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.fusing.look import noise_of
from asterism.server.pose.fit import LEDS

HIDDEN = 0.5  # nats that an LED costs which a camera should see and does not
AWAY = 1.5  # and all of them, where a camera sees none: something stands before the robot
AROUND = 0.75  # of a constellation's extent: how far from its middle other lights are around it
POINT_CHI2 = 9.0  # more than that two cameras' spots of one light are not off


@compiled
def log_det(a):
    """Logarithm of the determinant of a symmetric matrix (n, n), which is destroyed; -inf if it is not positive."""
    total = 0.0
    for j in range(a.shape[0]):
        s = a[j, j]
        for k in range(j):
            s -= a[j, k] * a[j, k]
        if not s > 0.0:
            return -np.inf
        a[j, j] = math.sqrt(s)
        total += math.log(s)
        for i in range(j + 1, a.shape[0]):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            a[i, j] = s / a[j, j]
    return total


@compiled
def _surround(scene, extent, labels, room, around):
    """Fill ``around`` (C, 2): how many spots stand where a robot is, and in what area, rays; returns what LEDs that are
    not seen cost.
    """
    against = 0.0
    for c in range(labels.shape[0]):
        x = y = depth = 0.0
        count = hidden = 0
        for led in range(LEDS):
            x += room.rays[c, led, 0] / LEDS
            y += room.rays[c, led, 1] / LEDS
            depth += room.depths[c, led] / LEDS
            if labels[c, led] >= 0:
                count += 1
            elif room.visible[c, led] > 0.0:
                hidden += 1
        against += min(HIDDEN * hidden, AWAY) if count == 0 else HIDDEN * hidden
        reach = AROUND * extent / max(depth, 1e-3)
        near = 0
        for spot in range(scene.first[c], scene.first[c + 1]):
            if (scene.rays[spot, 0] - x) ** 2 + (scene.rays[spot, 1] - y) ** 2 < reach * reach:
                near += 1
        around[c, 0], around[c, 1] = max(near, count, 1), math.pi * reach * reach
    return against


@compiled
def weigh(scene, body, extent, labels, room, state, prior, chi2):
    """Logarithm of the odds, in nats, that the spots ``labels`` (C, 6) are this robot's LEDs, against other lights.

    The room is filled as of the pose, ``state``, with the information of all spots and the ``prior`` (`look.State`);
    ``chi2`` is that of all spots. The evidence of the robot is that of its spots, integrated over its pose (Laplace's
    method), which may be anything in its own space or what was foreseen. Against it stands for each LED that there are
    as many other lights around: anywhere in each image, or, where several cameras see it, one light anywhere in space,
    which they see at one place whosever it is. LEDs that should be seen and are not count against it.
    """
    around = np.empty((labels.shape[0], 2))
    against = _surround(scene, extent, labels, room, around)
    space = math.log((2.0 * AROUND * extent) ** 3)
    total = 0.0
    a, b = np.empty((3, 3)), np.empty(3)
    factor = np.empty((3, 3))
    for led in range(LEDS):
        a[:, :] = 0.0
        b[:] = 0.0
        apart, own2, most, cameras = 0.0, 0.0, 1.0, 0
        for c in range(labels.shape[0]):
            spot = labels[c, led]
            if spot < 0:
                continue
            xx, xy, yy = noise_of(scene, body, c, spot, room.depths[c, led])
            det = xx * yy - xy * xy
            wxx, wxy, wyy = yy / det, -xy / det, xx / det
            rx, ry = scene.rays[spot, 0] - room.rays[c, led, 0], scene.rays[spot, 1] - room.rays[c, led, 1]
            jacobian = room.jacobians[c, led]
            for i in range(3):
                wx = wxx * jacobian[0, i] + wxy * jacobian[1, i]
                wy = wxy * jacobian[0, i] + wyy * jacobian[1, i]
                b[i] += wx * rx + wy * ry
                for j in range(3):
                    a[i, j] += wx * jacobian[0, j] + wy * jacobian[1, j]
            own2 += wxx * rx * rx + 2.0 * wxy * rx * ry + wyy * ry * ry
            apart += math.log(around[c, 1] / around[c, 0]) - math.log(2.0 * math.pi * math.sqrt(det))
            most = max(most, around[c, 0])
            cameras += 1
        if cameras == 0:
            continue
        if cameras > 1:
            # One light in space: how far its spots are off the best place for it, and how well they tell that place.
            factor[:, :] = a
            spread = log_det(factor)
            if spread > -np.inf:
                for i in range(3):
                    for k in range(i):
                        b[i] -= factor[i, k] * b[k]
                    b[i] /= factor[i, i]
                    own2 -= b[i] * b[i]
                own2 = min(max(own2, 0.0), POINT_CHI2)
                one = space - math.log(most) + 0.5 * own2 - 1.5 * math.log(2.0 * math.pi) + 0.5 * spread
                apart = min(apart, one)
        total += apart
    spread = log_det(state.information.copy())
    if spread == -np.inf:
        return -np.inf
    free = space + math.log(4.0 * math.pi**2)
    foreseen = log_det(prior.information.copy())
    if foreseen > -np.inf:
        free = min(free, 3.0 * math.log(2.0 * math.pi) - 0.5 * foreseen)
    return total - 0.5 * chi2 + 3.0 * math.log(2.0 * math.pi) - 0.5 * spread - free - against
