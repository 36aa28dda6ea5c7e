"""How much likelier spots of several cameras are as the LEDs of one robot than as chance."""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.fusing.look import noise_of
from asterism.server.pose.fit import LEDS

HIDDEN = 1.0  # nats that an LED costs which a camera should see and does not
AWAY = 2.0  # and all of them, where a camera sees none: something stands before the robot
AROUND = 0.75  # of a constellation's extent: how far from its middle spots are around it


@compiled
def weigh(scene, body, extent, labels, room, chi2):
    """Logarithm of the odds, in nats, that the spots ``labels`` (C, 6) of a robot fit so well by no chance.

    The room is filled as of the pose, whose ``chi2`` is that of all spots. Three spots are spent on the pose; every
    further one lands within its variance of its place by chance with probability 2 pi sigma^2 times the density of
    spots there. LEDs that should be seen and are not count against it.
    """
    total, seen, against = 0.0, 0, 0.0
    for c in range(labels.shape[0]):
        x = y = depth = 0.0
        count = hidden = 0
        for led in range(LEDS):
            if not room.depths[c, led] > 1e-3:
                continue
            x += room.rays[c, led, 0] / LEDS
            y += room.rays[c, led, 1] / LEDS
            depth += room.depths[c, led] / LEDS
            if labels[c, led] >= 0:
                count += 1
            elif room.visible[c, led] > 0.0:
                hidden += 1
        against += min(HIDDEN * hidden, AWAY) if count == 0 else HIDDEN * hidden
        if count == 0:
            continue
        reach = AROUND * extent / depth
        around = 0
        for spot in range(scene.first[c], scene.first[c + 1]):
            if (scene.rays[spot, 0] - x) ** 2 + (scene.rays[spot, 1] - y) ** 2 < reach * reach:
                around += 1
        for led in range(LEDS):
            spot = labels[c, led]
            if spot >= 0:
                xx, xy, yy = noise_of(scene, body, c, spot, room.depths[c, led])
                total += math.log(0.5 * reach * reach / math.sqrt(xx * yy - xy * xy)) - math.log(max(around, count))
        seen += count
    if seen == 0:
        return -np.inf
    return total * (1.0 - 3.0 / seen) - 0.5 * chi2 - against
