"""A robot's spots in all cameras, from where it should be: those that lie where its LEDs project, one after another.

What is known of the pose - before, or from the spots of one camera - says where each LED should be in every camera and
how surely. A spot is taken where it lies within that gate and nothing else comes near to explaining it: no other spot
the LED, no other LED of the robot the spot. With every spot taken the pose is known better, so that what was open
becomes clear. Source of the idea: Neira and Tardos, "Data association in stochastic mapping using the joint
compatibility test", IEEE T-RA 2001.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.fusing.look import fit, noise_of
from asterism.server.pose.covariance import invert
from asterism.server.pose.fit import LEDS
from asterism.server.pose.planar import NO_SOLUTION

GATE = 18.4  # squared sigmas: 99.99 % of chi squared for two degrees of freedom
OFF = 27.6  # beyond 99.9999 %: a spot is no LED's
CLEARLY = 12.0  # squared sigmas by which the next best must be worse: 400 times less likely
WIDEST = 0.25  # of a constellation's image: a gate whose one sigma is wider is no help
ROUNDS = 8
STEPS = 3


@compiled
def spread_in(scene, room, c, prior, spread):
    """Fill ``spread`` (6, 6): how well the pose that camera c sees is known, from all. ``prior`` (6, 6) information."""
    work = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            work[i, j] = prior[i, j]
            for other in range(scene.turns.shape[0]):
                if other != c:
                    work[i, j] += room.shared[other, i, j]
        work[i, i] += 1e-6
    invert(work, spread)
    for i in range(6):
        for j in range(6):
            work[i, j] = spread[i, j] + room.doubts[c, i, j]
    invert(work, spread)
    for i in range(6):
        for j in range(6):
            work[i, j] = spread[i, j] + room.own[c, i, j]
    invert(work, spread)


@compiled
def gate_of(room, c, led, spread, gate):
    """Fill ``gate`` (3,): the covariance of where an LED should be in camera c, in rays: xx, xy, yy."""
    jacobian = room.jacobians[c, led]
    gate[:] = 0.0
    for i in range(6):
        x = y = 0.0
        for j in range(6):
            x += spread[i, j] * jacobian[0, j]
            y += spread[i, j] * jacobian[1, j]
        gate[0] += jacobian[0, i] * x
        gate[1] += jacobian[0, i] * y
        gate[2] += jacobian[1, i] * y


@compiled
def _extent(layout):
    """The largest distance between two LEDs (6, 3), m."""
    largest2 = 0.0
    for i in range(LEDS):
        for j in range(i):
            away2 = 0.0
            for axis in range(3):
                away2 += (layout[i, axis] - layout[j, axis]) ** 2
            largest2 = max(largest2, away2)
    return math.sqrt(largest2)


@compiled
def _costs(scene, body, c, labels, free, room, spread, costs):
    """Fill ``costs`` (6, spots of camera c): squared sigmas and the logarithm of the gate's area for LEDs that lack a
    spot and spots within the gate, inf elsewhere. Returns whether there is any.
    """
    costs[:, :] = np.inf
    gate, extent = np.empty(3), _extent(body.layout)
    start, end = scene.first[c], scene.first[c + 1]
    some = False
    for led in range(LEDS):
        if labels[led] >= 0 or room.visible[c, led] == 0.0:
            continue
        depth = room.depths[c, led]
        gate_of(room, c, led, spread, gate)
        if not max(gate[0], gate[2]) < (WIDEST * extent / depth) ** 2:
            continue
        for spot in range(start, end):
            if not free[spot]:
                continue
            nxx, nxy, nyy = noise_of(scene, body, c, spot, depth)
            xx, xy, yy = gate[0] + nxx, gate[1] + nxy, gate[2] + nyy
            x, y = scene.rays[spot, 0] - room.rays[c, led, 0], scene.rays[spot, 1] - room.rays[c, led, 1]
            if x * x > GATE * xx or y * y > GATE * yy:
                continue
            det = xx * yy - xy * xy
            away = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / det
            if away < GATE:
                costs[led, spot - start] = away + math.log(det)
                some = True
    return some


@compiled
def _take_clear(costs, start, labels, free):
    """Give LEDs the spots that are clearly theirs; returns how many."""
    taken = 0
    for led in range(costs.shape[0]):
        best = -1
        for k in range(costs.shape[1]):
            if costs[led, k] < np.inf and (best < 0 or costs[led, k] < costs[led, best]):
                best = k
        if best < 0:
            continue
        cost, clear = costs[led, best], True
        for k in range(costs.shape[1]):
            clear &= k == best or costs[led, k] > cost + CLEARLY
        for other in range(costs.shape[0]):
            clear &= other == led or costs[other, best] > cost + CLEARLY
        if clear:
            labels[led] = start + best
            free[start + best] = False
            taken += 1
    return taken


@compiled
def _worst(scene, body, labels, room):
    """The label that is farthest off: camera, LED and squared sigmas."""
    worst_c, worst_led, worst = -1, -1, 0.0
    for c in range(labels.shape[0]):
        for led in range(LEDS):
            spot = labels[c, led]
            if spot < 0:
                continue
            xx, xy, yy = noise_of(scene, body, c, spot, room.depths[c, led])
            # What all spots of the camera are off together is not the fault of one.
            dxx, dyy = 0.0, 0.0
            for i in range(3):
                dxx += room.jacobians[c, led, 0, i] ** 2 * room.doubts[c, i, i]
                dyy += room.jacobians[c, led, 1, i] ** 2 * room.doubts[c, i, i]
            xx, yy = xx + dxx, yy + dyy
            x, y = scene.rays[spot, 0] - room.rays[c, led, 0], scene.rays[spot, 1] - room.rays[c, led, 1]
            off = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
            if off > worst:
                worst_c, worst_led, worst = c, led, off
    return worst_c, worst_led, worst


@compiled
def gather(scene, body, course, prior, state, labels, free, room):
    """Find a robot's spots in all cameras: ``labels`` (C, 6), which holds those that are known already, -1 elsewhere.

    ``prior`` as in `look.fit`; from ``state`` on, which becomes the pose that they tell. ``free`` (n,) spots may be
    taken, and are no longer free then. Returns chi squared and the count.
    """
    widest = 1
    for c in range(labels.shape[0]):
        widest = max(widest, scene.first[c + 1] - scene.first[c])
    all_costs, spread = np.empty((LEDS, widest)), np.empty((6, 6))
    chi2, count = fit(scene, body, course, labels, prior, state, STEPS, room)
    for _ in range(ROUNDS):
        if chi2 >= NO_SOLUTION:
            break
        taken = 0
        for c in range(labels.shape[0]):
            start, end = scene.first[c], scene.first[c + 1]
            if start == end:
                continue
            spread_in(scene, room, c, prior.information, spread)
            costs = all_costs[:, : end - start]
            if _costs(scene, body, c, labels[c], free, room, spread, costs):
                taken += _take_clear(costs, start, labels[c], free)
        if taken == 0:
            break
        chi2, count = fit(scene, body, course, labels, prior, state, STEPS, room)
        while chi2 < NO_SOLUTION and count > 1:
            c, led, off = _worst(scene, body, labels, room)
            if off < OFF:
                break
            labels[c, led] = -1  # and its spot stays taken: it is not tried again
            chi2, count = fit(scene, body, course, labels, prior, state, STEPS, room)
    return chi2, count
