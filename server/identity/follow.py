"""Warm matching: robots that were there a moment ago claim the spots near where they should be now.

Every LED of a predicted pose takes the nearest free spot of like brightness within its gate; a spot that two LEDs
want goes to the nearer. The pose is refined from the prediction; spots that do not fit are given up one at a time. What
does not fit then is left to the cold search of the same frame.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.identity.neighbours import first_from
from asterism.server.pose.fit import LEDS, SYSTEMATIC_PX, fit_room
from asterism.server.pose.planar import NO_SOLUTION, refine_pose
from asterism.server.pose.rotations import mapped
from asterism.server.pose.spot_shift import has_offset, spot_shifts
from asterism.server.pose.track import HEIGHT, KNOWN, NEWEST, predict, predict_room
from asterism.server.segmentation.order import ascending

WIDEST_GATE = 0.25  # of a constellation's image; beyond that a prediction is no help
GATHER_PX = 1.5  # a found robot's missing LED is looked for this near to its place
LEAST_LEDS = 4
ROOM = 1.5  # times what a robot's LEDs were off: what they may be after the next step
BRIGHTNESS_STEP = 2.5  # a LED is not that much brighter or dimmer than it was a frame ago
# 99.9 % of chi squared for 2, 4 and 6 degrees of freedom.
CHI2 = np.array([0.0, 0.0, 0.0, 0.0, 13.8, 18.5, 22.5])


@compiled
def gate_px(sigmas, extent, focal, depth):
    """Radius of a robot's gates, px: three sigma of where an LED may be, and two pixels.

    ``sigmas`` (2,) of its position, m, and rotation, rad; ``extent`` of its constellation and ``depth``, m.
    """
    swing = 0.5 * extent * sigmas[1]
    return 2.0 + 3.0 * focal / depth * math.sqrt(sigmas[0] ** 2 + swing**2)


@compiled
def _expect(tracks, exposed_ns, extents, focal, expected, gates):
    """Fill ``expected`` (`track.Predicted`) and ``gates`` (m,) px with the robots whose prediction is good enough to
    follow them; returns how many there are.
    """
    count = 0
    for k in range(predict(tracks, exposed_ns, expected)):
        robot, z = expected.robots[k], expected.ts[k, 2]
        depth = max(z, 1e-6)
        gate = gate_px(expected.sigmas[k], extents[robot], focal, depth)
        if z > 0.0 and gate <= WIDEST_GATE * extents[robot] * focal / depth:
            expected.robots[count], expected.ts[count] = robot, expected.ts[k]
            expected.rotations[count] = expected.rotations[k]
            gates[count] = gate
            count += 1
    return count


@compiled
def tolerance_px(misfits, focal, depth):
    """What a robot's LEDs may be off, one sigma, px: as much as they were in the newest frame, or as was learned."""
    return max(SYSTEMATIC_PX, ROOM * focal / depth * max(misfits[KNOWN], misfits[NEWEST]))


@compiled
def _alike(height, wanted):
    """Whether a spot is not that much brighter or dimmer than its robot's were."""
    return height * BRIGHTNESS_STEP > wanted and height < wanted * BRIGHTNESS_STEP


@compiled
def _claim(spots, constellations, expected, gates, brightness, focal, assignment):
    """Fill ``assignment`` (m, 6): every LED takes the nearest free spot of like ``brightness`` (m,) within its gate."""
    flat, free, heights = spots.flat, spots.free, spots.heights
    n = flat.shape[0]
    order = ascending(flat[:, 0])
    xs = flat[order, 0]
    wanted_by = np.full(n, -1)
    wanted_at = np.full(n, np.inf)
    shifts = np.zeros((LEDS, 2))
    for k in range(gates.shape[0]):
        gate, rotation, t = gates[k], expected.rotations[k], expected.ts[k]
        layout, optics = constellations.layouts[expected.robots[k]], constellations.optics[expected.robots[k]]
        # The perspective's shift is far below the gate, that of the LEDs' optics is not.
        if has_offset(optics):
            spot_shifts(rotation, t, layout, optics, shifts)
        else:
            shifts[:, :] = 0.0
        for led in range(LEDS):
            assignment[k, led] = -1
            x, y, z = mapped(rotation, t, layout[led])
            if not z > 0.0:
                continue
            px, py = focal * (x / z + shifts[led, 0]), -focal * (y / z + shifts[led, 1])
            best, best2 = -1, gate * gate
            place = first_from(xs, px - gate)
            while place < n and xs[place] <= px + gate:
                spot = order[place]
                place += 1
                if not free[spot]:
                    continue
                away2 = (flat[spot, 0] - px) ** 2 + (flat[spot, 1] - py) ** 2
                if away2 < best2 and _alike(heights[spot], brightness[k]):
                    best, best2 = spot, away2
            if best >= 0 and best2 < wanted_at[best]:
                if wanted_by[best] >= 0:
                    assignment[wanted_by[best] // LEDS, wanted_by[best] % LEDS] = -1
                wanted_by[best] = k * LEDS + led
                wanted_at[best] = best2
                assignment[k, led] = best


@compiled
def _fit(layout, labels, spots, systematic2, rotation, t, room, which):
    """Refine a pose from its prediction on the spots ``labels`` (6,) that are not -1; returns their count and the cost.

    The result is pose ``which`` of the ``room`` (`fit.FitRoom`).
    """
    points, seen, information = room.points, room.seen, room.information
    rays, variances = spots.rays, spots.variances
    count = 0
    for led in range(LEDS):
        spot = labels[led]
        if spot < 0:
            continue
        points[count] = layout[led]
        seen[count] = rays[spot]
        information[count, 0] = information[count, 2] = 1.0 / (variances[spot] + systematic2)
        information[count, 1] = 0.0
        count += 1
    room.rotations[which] = rotation
    room.ts[which] = t
    if count < LEAST_LEDS:
        return count, NO_SOLUTION
    p, s, w = points[:count], seen[:count], information[:count]
    return count, refine_pose(room.rotations[which], room.ts[which], p, s, w, 8)


@compiled
def _settle(layout, labels, spots, systematic2, rotation, t, room, trial):
    """Whether the spots ``labels`` (6,) of a robot explain it; those that do not fit are given up one at a time.

    ``rotation`` and ``t``, the prediction, become the pose; its spots are then no longer free. ``systematic2``: the
    variance of the rays beyond their own. ``trial`` (6,) is scratch.
    """
    best, other = 0, 1  # poses of the room
    count, cost = _fit(layout, labels, spots, systematic2, rotation, t, room, best)
    while count > LEAST_LEDS and cost > CHI2[count]:
        # Give up the one spot without which the others fit best.
        best_led, best_cost = -1, NO_SOLUTION
        for led in range(LEDS):
            if labels[led] < 0:
                continue
            trial[:] = labels
            trial[led] = -1
            _, without = _fit(layout, trial, spots, systematic2, rotation, t, room, other)
            if without < best_cost:
                best_led, best_cost = led, without
                best, other = other, best
        if best_led < 0:
            break
        labels[best_led] = -1
        count, cost = count - 1, best_cost
    if count < LEAST_LEDS or not cost <= CHI2[count]:
        return False
    rotation[:, :] = room.rotations[best]
    t[:] = room.ts[best]
    for led in range(LEDS):
        if labels[led] >= 0:
            spots.free[labels[led]] = False
    return True


@compiled
def _gather_missing(layout, labels, spots, focal, rotation, t, seen):
    """Give a robot the free spots near its missing LEDs: ``seen`` are the height of its others, and how near, px."""
    height, reach = seen
    flat, free, heights = spots.flat, spots.free, spots.heights
    for led in range(LEDS):
        if labels[led] >= 0:
            continue
        x, y, z = mapped(rotation, t, layout[led])
        px, py = focal * x / z, -focal * y / z
        best, best2 = -1, reach * reach
        for spot in range(flat.shape[0]):
            away2 = (flat[spot, 0] - px) ** 2 + (flat[spot, 1] - py) ** 2
            if free[spot] and away2 < best2 and _alike(heights[spot], height):
                best, best2 = spot, away2
        if best >= 0:
            labels[led] = best
            free[best] = False


@compiled
def follow(spots, constellations, extents, focal, tracks, exposed_ns, matched):
    """Match the robots that were there a moment ago to spots: fill ``matched``, and return how many were found.

    ``spots`` are `neighbours.Spots`, which are then no longer free; ``constellations`` are `matched.Constellations`
    with their ``extents`` (robots,) m.
    """
    n = extents.shape[0]
    expected, gates = predict_room(n), np.empty(n)
    count = _expect(tracks, exposed_ns, extents, focal, expected, gates)
    if count == 0:
        return 0
    brightness, assignment = np.empty(count), np.empty((count, LEDS), np.int64)
    for k in range(count):
        brightness[k] = tracks.numbers[expected.robots[k], HEIGHT]
    _claim(spots, constellations, expected, gates[:count], brightness, focal, assignment)
    room, trial = fit_room(), np.empty(LEDS, np.int64)
    found = 0
    for k in range(count):
        robot, rotation, t = expected.robots[k], expected.rotations[k], expected.ts[k]
        layout = constellations.layouts[robot]
        systematic2 = (tolerance_px(tracks.misfits[robot], focal, t[2]) / focal) ** 2
        if _settle(layout, assignment[k], spots, systematic2, rotation, t, room, trial):
            matched.robots[found], matched.assignment[found] = robot, assignment[k]
            matched.rotations[found], matched.ts[found] = rotation, t
            brightness[found] = brightness[k]
            found += 1
    for k in range(found):
        layout, labels = constellations.layouts[matched.robots[k]], matched.assignment[k]
        off_px = tolerance_px(tracks.misfits[matched.robots[k]], focal, matched.ts[k, 2])
        seen = (brightness[k], GATHER_PX * off_px / SYSTEMATIC_PX)
        _gather_missing(layout, labels, spots, focal, matched.rotations[k], matched.ts[k], seen)
    return found
