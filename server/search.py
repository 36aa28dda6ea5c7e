"""Cold search: which spots are which robot's LEDs, without any idea where the robots are.

Every spot in turn, brightest first, is combined with three of its nearest neighbours; the quad table says which robots
and labels the four can be; the exact homography of the four predicts the other two LEDs; a calibrated pose of the
five or six decides. Six LEDs that fit, of a robot that cannot be mistaken at that residual, are claimed at once; all
else is a hypothesis that `assign` judges together with its rivals.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.planar import NO_SOLUTION, homography_ls, refine_pose, translation, two_rotations
from asterism.server.quads import CELLS, TOLERANCE, invariants

LEDS = 6
NEIGHBOURS = 24
DEPTHS = (8, 14, 24)  # nearest neighbours that are combined, in passes
MOST_QUADS = 400_000  # a frame; beyond that only the nearer combinations were tried
SMALLEST_QUAD_PX2 = 30.0  # twice the area: smaller ones say nothing
REACH_PX = 3.0  # how far a LED may lie from where the homography of four puts it
BRIGHTNESS_RATIO = 0.2  # of the dimmest to the brightest LED of a robot, at least
RADIUS_RATIO = 0.4  # of the smallest to the largest
MIRROR_RATIO = 0.6  # a second explanation of a robot is a mirror image if it is dimmer than this
SYSTEMATIC_PX = 0.25  # what calibration and LED positions may be off, one sigma
CHI2 = np.array([0.0, 0.0, 0.0, 0.0, 13.8, 18.5, 22.5])  # 99.9 % for two, four and six degrees of freedom

# Columns of a hypothesis beside its six spots (-1: not visible): robot, LEDs seen, cost in squared sigmas of
# SYSTEMATIC_PX, median height.
ROBOT, SEEN, COST, HEIGHT = range(4)
EVEN_HEIGHT = 1.7  # of the median height of a robot's spots: a brighter one among them may be another's


@compiled
def nearest_neighbours(flat, usable, most, reach, lists, counts):
    """For every usable point of ``flat`` (n, 2) its up to ``most`` nearest usable ones within ``reach``, in order."""
    n = flat.shape[0]
    order = np.argsort(flat[:, 0])
    distances = np.empty(most)
    for place in range(n):
        i = order[place]
        counts[i] = 0
        if not usable[i]:
            continue
        count = 0
        left, right = place - 1, place + 1
        while left >= 0 or right < n:
            # The next candidate by horizontal distance, from either side.
            gap_left = flat[i, 0] - flat[order[left], 0] if left >= 0 else np.inf
            gap_right = flat[order[right], 0] - flat[i, 0] if right < n else np.inf
            if gap_left <= gap_right:
                j, gap = order[left], gap_left
                left -= 1
            else:
                j, gap = order[right], gap_right
                right += 1
            limit = distances[count - 1] if count == most else reach
            if gap > limit:
                break
            if not usable[j]:
                continue
            distance = math.hypot(flat[j, 0] - flat[i, 0], flat[j, 1] - flat[i, 1])
            if distance > limit:
                continue
            k = count if count < most else most - 1
            while k > 0 and distances[k - 1] > distance:
                distances[k] = distances[k - 1]
                lists[i, k] = lists[i, k - 1]
                k -= 1
            distances[k] = distance
            lists[i, k] = j
            count = min(count + 1, most)
        counts[i] = count


@compiled
def _basis(points, order, out):
    """The projective basis (3, 3) of four points: columns scaled so that they sum to the fourth."""
    x0, y0 = points[order[0], 0], points[order[0], 1]
    x1, y1 = points[order[1], 0], points[order[1], 1]
    x2, y2 = points[order[2], 0], points[order[2], 1]
    x3, y3 = points[order[3], 0], points[order[3], 1]
    det = x0 * (y1 - y2) - y0 * (x1 - x2) + (x1 * y2 - x2 * y1)
    if abs(det) < 1e-15:
        return False
    l0 = (x3 * (y1 - y2) - y3 * (x1 - x2) + (x1 * y2 - x2 * y1)) / det
    l1 = (x0 * (y3 - y2) - y0 * (x3 - x2) + (x3 * y2 - x2 * y3)) / det
    l2 = 1.0 - l0 - l1
    if abs(l0) < 1e-6 or abs(l1) < 1e-6 or abs(l2) < 1e-6:
        return False
    out[0, 0], out[0, 1], out[0, 2] = l0 * x0, l1 * x1, l2 * x2
    out[1, 0], out[1, 1], out[1, 2] = l0 * y0, l1 * y1, l2 * y2
    out[2, 0], out[2, 1], out[2, 2] = l0, l1, l2
    return True


@compiled
def _homography4(source, source_order, target, target_order, h, left, right):
    """The exact homography h (3, 3) of four points (rows of ``source`` and ``target`` in the given orders)."""
    if not _basis(source, source_order, right) or not _basis(target, target_order, left):
        return False
    # h = left @ adjugate(right)
    for i in range(3):
        for j in range(3):
            a, b = (j + 1) % 3, (j + 2) % 3
            total = 0.0
            for k in range(3):
                c, d = (k + 1) % 3, (k + 2) % 3
                total += left[i, k] * (right[a, c] * right[b, d] - right[a, d] * right[b, c])
            h[i, j] = total
    if abs(h[2, 2]) < 1e-15:
        return False
    h /= h[2, 2]
    return True


@compiled
def _plausible(layout, leds, flat, spots, focal, near, far, most_tilt):
    """Whether the affine map of three points is one that a camera can see: scale within the range, tilt, no mirror."""
    ax, ay = layout[leds[0], 0], layout[leds[0], 1]
    ux, uy = layout[leds[1], 0] - ax, layout[leds[1], 1] - ay
    vx, vy = layout[leds[2], 0] - ax, layout[leds[2], 1] - ay
    det = ux * vy - vx * uy
    if abs(det) < 1e-12:
        return True
    bx, by = flat[spots[0], 0], flat[spots[0], 1]
    px, py = flat[spots[1], 0] - bx, flat[spots[1], 1] - by
    qx, qy = flat[spots[2], 0] - bx, flat[spots[2], 1] - by
    g00, g01 = (px * vy - qx * uy) / det, (qx * ux - px * vx) / det
    g10, g11 = (py * vy - qy * uy) / det, (qy * ux - py * vx) / det
    area = g00 * g11 - g01 * g10
    if area <= 0.0:
        return False
    size = g00 * g00 + g01 * g01 + g10 * g10 + g11 * g11
    large = math.sqrt(0.5 * (size + math.sqrt(max(size * size - 4.0 * area * area, 0.0))))
    small = area / large
    return 0.8 * focal / far <= large <= 1.25 * focal / near and small >= 0.8 * most_tilt * large


@compiled
def fit_labelled(layout, spots, rays, variances, systematic2, iterations, points, seen, information, rotations, ts, h):
    """Pose of a robot whose LEDs are the given spots (-1: not visible), turned towards the camera.

    Returns how many LEDs it rests on, the cost (squared sigmas) and which of ``rotations``, ``ts`` holds the pose;
    a negative index if there is none. ``points``, ``seen``, ``information``, ``h`` are scratch of six rows.
    """
    count = 0
    cx = cy = cz = 0.0
    for led in range(LEDS):
        spot = spots[led]
        if spot < 0:
            continue
        points[count, 0], points[count, 1], points[count, 2] = layout[led, 0], layout[led, 1], layout[led, 2]
        cx += layout[led, 0]
        cy += layout[led, 1]
        cz += layout[led, 2]
        seen[count, 0], seen[count, 1] = rays[spot, 0], rays[spot, 1]
        information[count, 0] = information[count, 2] = 1.0 / (variances[spot] + systematic2)
        information[count, 1] = 0.0
        count += 1
    cx /= count
    cy /= count
    cz /= count
    for k in range(count):
        points[k, 0] -= cx
        points[k, 1] -= cy
        points[k, 2] -= cz
    p, s, w = points[:count], seen[:count], information[:count]
    if not homography_ls(p, s, h) or not two_rotations(h, rotations[0], rotations[1]):
        return count, NO_SOLUTION, -1
    best, best_cost = -1, NO_SOLUTION
    for which in range(2):
        translation(rotations[which], p, s, ts[which])
        if not ts[which, 2] > 0.0:
            continue
        cost = refine_pose(rotations[which], ts[which], p, s, w, iterations)
        towards = 0.0
        for i in range(3):
            towards += rotations[which, i, 2] * ts[which, i]
        if cost < best_cost and towards < 0.0:
            best, best_cost = which, cost
    if best >= 0:
        for i in range(3):
            ts[best, i] -= rotations[best, i, 0] * cx + rotations[best, i, 1] * cy + rotations[best, i, 2] * cz
    return count, best_cost, best


@compiled
def _misfit(layout, led, rotation, t, ray):
    """Squared distance, in ray units, between a ray and where a pose puts an LED."""
    x, y, z = t[0], t[1], t[2]
    for j in range(3):
        x += rotation[0, j] * layout[led, j]
        y += rotation[1, j] * layout[led, j]
        z += rotation[2, j] * layout[led, j]
    return (x / z - ray[0]) ** 2 + (y / z - ray[1]) ** 2


@compiled
def median_of(numbers, spots):
    """Median of the numbers (n,) of a robot's visible spots."""
    values = np.empty(LEDS)
    count = 0
    for led in range(LEDS):
        if spots[led] >= 0:
            k = count
            while k > 0 and values[k - 1] > numbers[spots[led]]:
                values[k] = values[k - 1]
                k -= 1
            values[k] = numbers[spots[led]]
            count += 1
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])


@compiled
def search(
    flat,
    rays,
    variances,
    heights,
    radii,
    free,
    layouts,
    separations,
    claimed,
    brightness,
    convex,
    concave,
    focal,
    near,
    far,
    most_tilt,
    reach,
    fewest,
    claims,
    claim_values,
    claim_rotations,
    claim_ts,
    pending,
    pending_values,
    pending_rotations,
    pending_ts,
):
    """Search the spots that are ``free`` for the robots.

    ``flat`` (n, 2) ideal px, y up; ``rays`` (n, 2) the same as x / z, y / z (y down); ``variances`` (n,) of the rays,
    ``heights`` (n,), ``radii`` (n,) px; ``layouts`` (robots, 6, 3) m; ``separations`` (robots,) m, from any other
    robot and any other labelling; ``claimed`` (robots,) and ``brightness`` (robots,) of robots that are known
    already, for which only brighter rivals are of interest. ``convex`` and ``concave`` are the quad table.
    ``near`` and ``far`` m, ``most_tilt`` the cosine of the largest tilt, ``reach`` px between LEDs of one robot,
    ``fewest`` LEDs that make a hypothesis.

    Fills ``claims`` (m, 6) and its values, rotations and translations (T_camera_plane) with robots found beyond
    doubt, whose spots are then no longer free, and ``pending`` likewise with hypotheses. Returns both counts and the
    number of quads tried.
    """
    n = flat.shape[0]
    n_claims, n_pending, quads = 0, 0, 0
    lists = np.empty((n, NEIGHBOURS), np.int32)
    counts = np.zeros(n, np.int32)
    nearest_neighbours(flat, free, NEIGHBOURS, reach, lists, counts)
    by_height = np.argsort(-heights)
    four = np.empty((4, 2))
    order = np.empty(4, np.int64)
    values = np.empty(2)
    members = np.empty(4, np.int64)
    spots4 = np.empty(4, np.int64)
    leds4 = np.empty(4, np.int64)
    labels = np.empty(LEDS, np.int64)
    trial = np.empty(LEDS, np.int64)
    h, left, right, scratch_h = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    points, seen, information = np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 3))
    rotations, ts = np.empty((2, 3, 3)), np.empty((2, 3))
    systematic2 = (SYSTEMATIC_PX / focal) ** 2
    missing = 0
    for robot in range(layouts.shape[0]):
        missing += not claimed[robot]
    previous = 0
    for depth in DEPTHS:
        if missing == 0 and previous > 0:
            break  # rivals of robots that are found stand together, and were met in the first pass
        for rank in range(n):
            i = by_height[rank]
            if not free[i]:
                continue
            size = min(counts[i], depth)
            for a in range(size):
                j = lists[i, a]
                if not free[i]:
                    break
                if not free[j]:
                    continue
                for b in range(a + 1, size):
                    k = lists[i, b]
                    if not free[i] or not free[j]:
                        break
                    if not free[k] or abs(flat[j, 0] - flat[k, 0]) > reach or abs(flat[j, 1] - flat[k, 1]) > reach:
                        continue
                    for c in range(max(b + 1, previous), size):
                        l = lists[i, c]  # noqa: E741
                        if not (free[i] and free[j] and free[k]):
                            break
                        if not free[l]:
                            continue
                        members[0], members[1], members[2], members[3] = i, j, k, l
                        low, high, small, large = heights[i], heights[i], radii[i], radii[i]
                        for m in range(1, 4):
                            low, high = min(low, heights[members[m]]), max(high, heights[members[m]])
                            small, large = min(small, radii[members[m]]), max(large, radii[members[m]])
                        if low < BRIGHTNESS_RATIO * high or small < RADIUS_RATIO * large:
                            continue
                        quads += 1
                        if quads > MOST_QUADS:
                            return n_claims, n_pending, quads
                        for m in range(4):
                            four[m, 0], four[m, 1] = flat[members[m], 0], flat[members[m], 1]
                        kind, area = invariants(four, order, values)
                        if kind < 0 or area < SMALLEST_QUAD_PX2:
                            continue
                        row, column = int(values[0] * CELLS), int(values[1] * CELLS)
                        if not (0 <= row < CELLS and 0 <= column < CELLS):
                            continue
                        entries, numbers, starts, held = convex if kind == 0 else concave
                        cell = row * CELLS + column
                        for place in range(starts[cell], starts[cell + 1]):
                            entry = held[place]
                            robot = entries[entry, 0]
                            if (
                                abs(numbers[entry, 0] - values[0]) > TOLERANCE
                                or abs(numbers[entry, 1] - values[1]) > TOLERANCE
                            ):
                                continue
                            if claimed[robot] and high < MIRROR_RATIO * brightness[robot]:
                                continue
                            layout = layouts[robot]
                            for m in range(4):
                                spots4[m] = members[order[m]]
                                leds4[m] = entries[entry, 1 + m]
                            if not _plausible(layout, leds4, flat, spots4, focal, near, far, most_tilt):
                                continue
                            if not _homography4(layout, leds4, flat, spots4, h, left, right):
                                continue
                            labels[:] = -1
                            for m in range(4):
                                labels[leds4[m]] = spots4[m]
                            found = 4
                            for led in range(LEDS):
                                if labels[led] >= 0:
                                    continue
                                x, y = layout[led, 0], layout[led, 1]
                                w = h[2, 0] * x + h[2, 1] * y + 1.0
                                if w < 0.3:
                                    continue
                                px = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
                                py = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
                                best, best2 = -1, REACH_PX * REACH_PX
                                for m in range(counts[i]):
                                    near_spot = lists[i, m]
                                    away2 = (flat[near_spot, 0] - px) ** 2 + (flat[near_spot, 1] - py) ** 2
                                    if away2 < best2 and free[near_spot]:
                                        taken = False
                                        for other in range(LEDS):
                                            taken |= labels[other] == near_spot
                                        if not taken and (
                                            heights[near_spot] >= BRIGHTNESS_RATIO * high
                                            and low >= BRIGHTNESS_RATIO * heights[near_spot]
                                            and radii[near_spot] >= RADIUS_RATIO * large
                                            and small >= RADIUS_RATIO * radii[near_spot]
                                        ):
                                            best, best2 = near_spot, away2
                                if best >= 0:
                                    labels[led] = best
                                    found += 1
                            if found < fewest:
                                continue
                            count, cost, which = fit_labelled(
                                layout,
                                labels,
                                rays,
                                variances,
                                systematic2,
                                3,
                                points,
                                seen,
                                information,
                                rotations,
                                ts,
                                scratch_h,
                            )
                            if which >= 0 and count == LEDS and cost > CHI2[LEDS]:
                                # One of the six may be somebody else's light: leave out the worst.
                                worst, worst_led = 0.0, 0
                                for led in range(LEDS):
                                    off = _misfit(layout, led, rotations[which], ts[which], rays[labels[led]])
                                    if off > worst:
                                        worst, worst_led = off, led
                                trial[:] = labels
                                trial[worst_led] = -1
                                count, cost, which = fit_labelled(
                                    layout,
                                    trial,
                                    rays,
                                    variances,
                                    systematic2,
                                    3,
                                    points,
                                    seen,
                                    information,
                                    rotations,
                                    ts,
                                    scratch_h,
                                )
                                labels[:] = trial
                            if which < 0 or cost > CHI2[count]:
                                continue
                            depth_m = ts[which, 2]
                            if not 0.8 * near <= depth_m <= 1.25 * far:
                                continue
                            height = median_of(heights, labels)
                            if claimed[robot] and height < MIRROR_RATIO * brightness[robot]:
                                continue
                            # Residual norm, m, at the robot: far below the separation no other robot fits as well.
                            residual = math.sqrt(cost * systematic2) * depth_m
                            certain = count == LEDS and 3.0 * residual <= separations[robot] and not claimed[robot]
                            for led in range(LEDS):
                                if labels[led] >= 0:
                                    certain &= heights[labels[led]] < EVEN_HEIGHT * height
                            if certain:
                                if n_claims == claims.shape[0]:
                                    continue
                                out, out_values, slot = claims, claim_values, n_claims
                                out_rotations, out_ts = claim_rotations, claim_ts
                            else:
                                known = False
                                for other in range(n_pending):
                                    if pending_values[other, ROBOT] == robot:
                                        same = True
                                        for led in range(LEDS):
                                            same &= pending[other, led] == labels[led]
                                        known |= same
                                if known or n_pending == pending.shape[0]:
                                    continue
                                out, out_values, slot = pending, pending_values, n_pending
                                out_rotations, out_ts = pending_rotations, pending_ts
                            for led in range(LEDS):
                                out[slot, led] = labels[led]
                            out_values[slot, ROBOT] = robot
                            out_values[slot, SEEN] = count
                            out_values[slot, COST] = cost
                            out_values[slot, HEIGHT] = height
                            out_rotations[slot] = rotations[which]
                            out_ts[slot] = ts[which]
                            if certain:
                                n_claims += 1
                                claimed[robot] = True
                                brightness[robot] = height
                                missing -= 1
                                for led in range(LEDS):
                                    free[labels[led]] = False
                                break
                            n_pending += 1
        previous = depth
    return n_claims, n_pending, quads


@compiled
def refit_versions(layout, spots, rays, variances, systematic2, versions, costs, rotations_out, ts_out):
    """Fit a hypothesis anew with another systematic variance: as it is, and with each LED left out if it has six.

    Fills ``versions`` (7, 6) with the spots of each version, ``costs`` (7,) (NO_SOLUTION where there is no pose),
    ``rotations_out`` (7, 3, 3) and ``ts_out`` (7, 3); returns how many versions there are.
    """
    points, seen, information = np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 3))
    rotations, ts, h = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty((3, 3))
    complete = True
    for led in range(LEDS):
        complete &= spots[led] >= 0
    count = 1 + LEDS if complete else 1
    for version in range(count):
        versions[version] = spots
        if version > 0:
            versions[version, version - 1] = -1
        _, costs[version], which = fit_labelled(
            layout,
            versions[version],
            rays,
            variances,
            systematic2,
            5,
            points,
            seen,
            information,
            rotations,
            ts,
            h,
        )
        if which < 0:
            costs[version] = NO_SOLUTION
        else:
            rotations_out[version] = rotations[which]
            ts_out[version] = ts[which]
    return count
