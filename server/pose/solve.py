"""From labelled spots to a pose: both minima of the plane refined, the likelier chosen, both kept with their odds.

Rays are corrected for what shifts an LED's spot (`spot_shift`) at the pose they lead to, each minimum for itself.
Covariances are those of the spots carried through the refined pose; what the residuals say is missing in the spots'
own noise (calibration, LED positions) is estimated from them and added to every spot first.
"""

import math
from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.server.compiled import compiled
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import FX, FY, project_point
from asterism.server.pose.planar import (
    NO_SOLUTION,
    normal_equations,
    other_minimum,
    refine_pose,
    solve_both,
)
from asterism.server.pose.rotations import angle_between, product_into
from asterism.server.pose.spot_shift import correct_rays, refine_shifted, spot_shifts

ITERATIONS = 12
FEW = 3  # iterations, after which a second minimum that costs more than the first by HOPELESS is good enough
HOPELESS = 80.0  # squared sigmas: odds of e^40
ODD = 10.0  # how many times worse six LEDs fit than five before the sixth is left out
ODD_BEFORE, ODD_AREA_PX2 = 0.01, 30.0  # how often other light moves a spot, and over what area
CLEARLY_OFF = 3.0  # times the surprising cost: if five LEDs then fit without surprise, the sixth is left out as well
NO_SYSTEMATIC = 20.0  # odds, before a look at the residuals, that the spots' own noise is the whole story
LEAST_SYSTEMATIC_PX = 0.002  # and from where on, in doublings, it is not: calibration, LED positions
SYSTEMATIC_STEPS = 9
NEGLIGIBLE = 0.02  # of a spot's own variance
SLIGHT = 0.5  # up to here more variance of every spot makes the pose less sure, but hardly moves it
# Seen nearly in front, both minima may be one: poses no more apart than this. Where the tilt is then no better known
# than that, its sign is open, and the copy stays as the alternative that says so.
SAME_RAD = 0.002
SURE_TILT_RAD = 0.022
LEAST_SIGMA_PX = 0.001  # no centre is known better than this
# 99.9 % of chi squared for 2, 4 and 6 degrees of freedom: beyond it the spots' noise is not the whole story.
_SURPRISE = np.array([0.0, 0.0, 0.0, 0.0, 13.8, 18.5, 22.5])


@dataclass(frozen=True, slots=True, eq=False)
class Alternative:
    """The other pose that explains the spots, in the same frame, and how many times less likely it is."""

    position: Floats  # (3,) m
    orientation: Floats  # (4,) x y z w
    odds: float

    @property
    def pose(self) -> Pose:
        """The same as a transform."""
        return Pose(self.position, self.orientation)


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """A robot's pose in one frame.

    ``position`` and ``orientation`` are T_world_robot (T_camera_robot where the rig places no camera); ``covariance``
    (6, 6) in m and rad: x, y, z, rotation about x, y, z of the parent frame. ``leds`` (k,) are the LEDs it rests on,
    ``spots`` (k,) the rows of the frame's blobs they are, ``residuals_px`` (k, 2) observed minus predicted.
    ``smoothed_by`` names the filter (`smooth`) that changed pose and covariance; empty: they rest on this frame.
    ``extrapolated``: the rig corrects Z, but no surveyed pose was near: the correction is faded or cut off.
    """

    position: Floats  # (3,) m
    orientation: Floats  # (4,) x y z w
    covariance: Floats
    leds: tuple[int, ...]
    spots: tuple[int, ...]
    residuals_px: Floats
    rms_px: float
    alternative: Alternative | None
    smoothed_by: str = ""
    extrapolated: bool = False

    @property
    def pose(self) -> Pose:
        """The same as a transform."""
        return Pose(self.position, self.orientation)

    @property
    def state(self) -> str:
        """TRACKED or TILT_AMBIGUOUS."""
        return "TRACKED" if self.alternative is None else "TILT_AMBIGUOUS"


@dataclass(frozen=True, slots=True)
class Lost:
    """A robot that has no pose in this frame, and why. ``state`` is LOST or IDENTITY_AMBIGUOUS."""

    reason: str
    state: str = "LOST"


@compiled
def _gather(
    layout, spots, rays, ray_covariances, shifts, extra, focal, points, seen, applied, information, centre
):  # fmt: skip
    """Points centred on their mean, rays without their shift and information of the visible LEDs; returns their count.

    ``shifts`` (6, 2) by LED; ``applied`` are those of the visible ones.
    """
    count = 0
    centre[:] = 0.0
    floor = (LEAST_SIGMA_PX / focal) ** 2
    for led in range(LEDS):
        spot = spots[led]
        if spot < 0:
            continue
        points[count] = layout[led]
        centre += layout[led]
        for axis in range(2):
            applied[count, axis] = shifts[led, axis]
            seen[count, axis] = rays[spot, axis] - shifts[led, axis]
        xx, xy = ray_covariances[spot, 0] + floor + extra, ray_covariances[spot, 1]
        yy = ray_covariances[spot, 2] + floor + extra
        det = xx * yy - xy * xy
        information[count, 0], information[count, 1], information[count, 2] = yy / det, -xy / det, xx / det
        count += 1
    centre /= count
    for k in range(count):
        points[k] -= centre
    return count


@compiled
def _systematic(rotation, t, points, seen, information, focal):
    """What residuals say of a variance, ray units, that every spot has beyond its own, and for the pose itself.

    Returns the variance's posterior mean, and the pose's cost: minus twice the logarithm of how likely the residuals
    are with every such variance there may be, chi squared where the spots' own noise explains them. Of two poses
    neither of which fits on that noise, the better is hardly more likely than the other, however much chi squared
    tells them apart.

    Before, it is none with odds NO_SYSTEMATIC to 1, else anything from LEAST_SYSTEMATIC_PX on, evenly by its logarithm.
    The likelihood is that of residuals with 2 n - 6 degrees of freedom. A mean, since with so few of them the most
    likely value is often far too small, and errors weighted by it far too large.
    """
    n = points.shape[0]
    # Squared residuals over all variances, and the product of the determinants over those of the spots' own noise.
    squares, growth = np.zeros(SYSTEMATIC_STEPS + 1), np.ones(SYSTEMATIC_STEPS + 1)
    variances = np.zeros(SYSTEMATIC_STEPS + 1)
    variances[1] = (LEAST_SYSTEMATIC_PX / focal) ** 2
    for k in range(2, SYSTEMATIC_STEPS + 1):
        variances[k] = 4.0 * variances[k - 1]
    for i in range(n):
        x, y, z = t[0], t[1], t[2]
        for j in range(3):
            x += rotation[0, j] * points[i, j]
            y += rotation[1, j] * points[i, j]
            z += rotation[2, j] * points[i, j]
        e, f = seen[i, 0] - x / z, seen[i, 1] - y / z
        per_det = information[i, 0] * information[i, 2] - information[i, 1] ** 2
        own_xx, xy, own_yy = information[i, 2] / per_det, -information[i, 1] / per_det, information[i, 0] / per_det
        for k in range(SYSTEMATIC_STEPS + 1):
            xx, yy = own_xx + variances[k], own_yy + variances[k]
            det = xx * yy - xy * xy
            squares[k] += (yy * e * e - 2.0 * xy * e * f + xx * f * f) / det
            growth[k] *= det * per_det
    logs = -0.5 * (squares + (2 * n - 6) / (2.0 * n) * np.log(growth))
    logs[0] += math.log(NO_SYSTEMATIC * SYSTEMATIC_STEPS)
    prior = (NO_SYSTEMATIC + 1.0) * SYSTEMATIC_STEPS
    most = logs[0]
    for k in range(1, SYSTEMATIC_STEPS + 1):
        most = max(most, logs[k])
    weight = mean = 0.0
    for k in range(SYSTEMATIC_STEPS + 1):
        likely = math.exp(logs[k] - most)
        weight += likely
        mean += likely * variances[k]
    return mean / weight, -2.0 * (most + math.log(weight / prior))


@compiled
def _largest(table, column):
    """The largest number of a column of a table (n, m) of numbers that are not negative."""
    largest = 0.0
    for k in range(table.shape[0]):
        largest = max(largest, table[k, column])
    return largest


@compiled
def _odd_led(layout, spots, rays, ray_covariances, shifts, start_rotation, start_t, focal):
    """The LED of six whose spot is not where the other five say, or -1: other light may have moved it.

    The start is changed to the pose refined on all six, where they agree. ``shifts`` (6, 2) are those at the start.
    Of six spots that are all a little off, some five always fit better than all; so one is odd only if that is likelier
    than that all are off.
    """
    points, seen, information = np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 3))
    applied = np.empty((LEDS, 2))
    centre, rotation, t = np.empty(3), np.empty((3, 3)), np.empty(3)
    trial = np.empty(LEDS, np.int64)
    both, both_t, both_costs = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty(2)
    best_led, best_cost, whole_cost = -1, NO_SOLUTION, NO_SOLUTION
    best_unlikely = whole_unlikely = NO_SOLUTION
    for without in range(-1, LEDS):
        trial[:] = spots
        if without >= 0:
            trial[without] = -1
        count = _gather(
            layout, trial, rays, ray_covariances, shifts, 0.0, focal, points, seen, applied, information, centre
        )  # fmt: skip
        if without < 0 and count < LEDS:
            return -1
        rotation[:, :] = start_rotation
        for i in range(3):
            t[i] = start_t[i]
            for j in range(3):
                t[i] += start_rotation[i, j] * centre[j]
        cost = refine_pose(rotation, t, points[:count], seen[:count], information[:count], 5)
        if without < 0:
            if cost <= _SURPRISE[LEDS]:
                start_rotation[:, :] = rotation
                for i in range(3):
                    start_t[i] = t[i]
                    for j in range(3):
                        start_t[i] -= rotation[i, j] * centre[j]
                return -1
            whole_cost = cost
        # The start may be the wrong tilt, which the odd spot made the better one.
        solve_both(points[:count], seen[:count], information[:count], ITERATIONS, True, both, both_t, both_costs)
        for which in range(2):
            if both_costs[which] < cost:
                cost = both_costs[which]
                rotation[:, :] = both[which]
                t[:] = both_t[which]
        _, unlikely = _systematic(rotation, t, points[:count], seen[:count], information[:count], focal)
        if without < 0:
            whole_cost, whole_unlikely = cost, unlikely
        elif cost < best_cost:
            best_led, best_cost, best_unlikely = without, cost, unlikely
    # Compared per degree of freedom: six LEDs leave six, five leave four.
    much_worse = ODD * best_cost / 4.0 < whole_cost / 6.0
    only_one_off = best_cost <= _SURPRISE[LEDS - 1] and whole_cost > CLEARLY_OFF * _SURPRISE[LEDS]
    odd = ray_covariances[spots[best_led]]
    area = 2.0 * math.pi * math.sqrt(max(odd[0] * odd[2] - odd[1] * odd[1], 0.0)) * focal * focal
    best_unlikely -= 2.0 * math.log(ODD_BEFORE * max(area, LEAST_SIGMA_PX**2) / ODD_AREA_PX2)
    likelier = best_unlikely < whole_unlikely
    return best_led if likelier and (much_worse or only_one_off) else -1


@compiled
def _other(both, both_t, known, points, seen, applied, information, optics, focal, cost):
    """Fill the pose's other minimum (both (2, 3, 3), both_t (2, 3)) from the ``known`` one of that cost; its own cost.

    ``seen`` and ``applied`` as in `correct_rays`; they become the other's.
    """
    rotation, t = both[1 - known], both_t[1 - known]
    if not other_minimum(both[known], both_t[known], points, seen, rotation, t) or t[2] <= 0.0:
        return NO_SOLUTION
    correct_rays(rotation, t, points, optics, seen, applied)
    found = refine_pose(rotation, t, points, seen, information, FEW)
    if found < cost + HOPELESS:
        found = refine_shifted(rotation, t, points, seen, applied, information, optics, focal, ITERATIONS)
    return found


@compiled
def solve_robots(
    layouts, assignment, rays, ray_covariances, centres, start_rotations, start_ts, lens, optics,
    rotations, ts, costs, covariances, residuals,
):  # fmt: skip
    """Solve every matched robot.

    ``layouts`` (m, 6, 3) m; ``assignment`` (m, 6) spots or -1, changed where one of six spots turns out to be
    odd; ``rays`` (n, 2), ``ray_covariances`` (n, 3) and ``centres`` (n, 2) px of the spots; ``start_rotations``
    (m, 3, 3) and ``start_ts`` (m, 3) from the matching; ``lens`` as in `lens`,
    ``optics`` (m, OPTICS) as in `spot_shift`.

    Fills, for both minima of every robot, ``rotations`` (m, 2, 3, 3) and ``ts`` (m, 2, 3) = T_camera_plane,
    ``costs`` (m, 2) (as `_systematic`; NO_SOLUTION where there is none or it faces away), ``covariances``
    (m, 2, 6, 6) of the plane's origin (m) and rotation about the camera's axes (rad), ``residuals`` (m, 2, 6, 2) px.
    """
    points, information, shifts = np.empty((LEDS, 3)), np.empty((LEDS, 3)), np.empty((LEDS, 2))
    own = np.empty((LEDS, 3))  # information of the spots' own noise
    # Either minimum has its own shifts.
    seen, applied = np.empty((2, LEDS, 2)), np.empty((2, LEDS, 2))
    centre, arm, a, b = np.empty(3), np.empty(3), np.empty((6, 6)), np.empty(6)
    start, start_t = np.empty((3, 3)), np.empty(3)
    kept, kept_t = np.empty((3, 3)), np.empty(3)
    focal = math.sqrt(lens[FX] * lens[FY])
    for robot in range(layouts.shape[0]):
        layout, spots, glass = layouts[robot], assignment[robot], optics[robot]
        both, both_t, both_costs = rotations[robot], ts[robot], costs[robot]
        both_costs[:] = NO_SOLUTION
        extra, is_slight = 0.0, False
        start[:, :] = start_rotations[robot]
        start_t[:] = start_ts[robot]
        spot_shifts(start, start_t, layout, glass, shifts)
        without = _odd_led(layout, spots, rays, ray_covariances, shifts, start, start_t, focal)
        if without >= 0:
            spots[without] = -1
        for attempt in range(2):
            count = _gather(
                layout, spots, rays, ray_covariances, shifts, extra, focal,
                points, seen[0], applied[0], information, centre,
            )  # fmt: skip
            seen[1, :, :] = seen[0]
            applied[1, :, :] = applied[0]
            p, w = points[:count], information[:count]
            s0, s1, d0, d1 = seen[0, :count], seen[1, :count], applied[0, :count], applied[1, :count]
            if attempt == 0:
                both[0] = start
                for i in range(3):
                    both_t[0, i] = start_t[i]
                    for j in range(3):
                        both_t[0, i] += start[i, j] * centre[j]
                both_costs[0] = refine_shifted(both[0], both_t[0], p, s0, d0, w, glass, focal, ITERATIONS)
                both_costs[1] = _other(both, both_t, 0, p, s1, d1, w, glass, focal, both_costs[0])
                if both_costs[1] < both_costs[0]:
                    # The start was the worse one's, perhaps too far from it to arrive: from the better it is near.
                    kept[:, :], kept_t[:] = both[0], both_t[0]
                    kept_cost = both_costs[0]
                    both_costs[0] = _other(both, both_t, 1, p, s0, d0, w, glass, focal, both_costs[1])
                    if both_costs[0] > kept_cost:
                        both[0], both_t[0] = kept, kept_t
                        both_costs[0] = kept_cost
                        correct_rays(both[0], both_t[0], p, glass, s0, d0)
            else:
                for which in range(2):
                    if both_costs[which] < NO_SOLUTION and not is_slight:
                        both_costs[which] = refine_shifted(
                            both[which], both_t[which], p, seen[which, :count], applied[which, :count], w, glass,
                            focal, ITERATIONS,
                        )  # fmt: skip
            better = 0 if both_costs[0] <= both_costs[1] else 1
            if attempt == 1 or both_costs[better] >= NO_SOLUTION:
                break
            # Residuals beyond the spots' noise: whatever causes them counts as noise of every spot.
            own[:count] = w
            extra, _ = _systematic(both[better], both_t[better], p, seen[better, :count], w, focal)
            share = extra * (_largest(w, 0) + _largest(w, 2))
            if share < NEGLIGIBLE:
                break
            is_slight = share < SLIGHT
        for which in range(2):
            rotation, t = both[which], both_t[which]
            towards = 0.0
            for i in range(3):
                towards += rotation[i, 2] * t[i]
            if both_costs[which] >= NO_SOLUTION or towards >= 0.0:
                both_costs[which] = NO_SOLUTION
                continue
            _, both_costs[which] = _systematic(rotation, t, p, seen[which, :count], own[:count], focal)
            normal_equations(rotation, t, p, seen[which, :count], w, a, b)
            _invert(a, covariances[robot, which])
            # From the visible LEDs' mean back to the plane's origin: t -= R centre, with the rotation's share.
            for i in range(3):
                arm[i] = 0.0
                for j in range(3):
                    arm[i] -= rotation[i, j] * centre[j]
                t[i] += arm[i]
            move_origin(covariances[robot, which], arm)
            spot_shifts(rotation, t, layout, glass, shifts)
            for led in range(LEDS):
                residuals[robot, which, led, :] = 0.0
                if spots[led] >= 0:
                    x, y, z = t[0], t[1], t[2]
                    for j in range(3):
                        x += rotation[0, j] * layout[led, j]
                        y += rotation[1, j] * layout[led, j]
                        z += rotation[2, j] * layout[led, j]
                    px, py = project_point(lens, x + shifts[led, 0] * z, y + shifts[led, 1] * z, z)
                    residuals[robot, which, led, 0] = centres[spots[led], 0] - px
                    residuals[robot, which, led, 1] = centres[spots[led], 1] - py
        if (
            both_costs[0] < NO_SOLUTION
            and both_costs[1] < NO_SOLUTION
            and angle_between(both[0], both[1]) < SAME_RAD
            and _tilt_variance(both[better], covariances[robot, better]) < SURE_TILT_RAD**2
        ):
            both_costs[1 - better] = NO_SOLUTION


@compiled
def _tilt_variance(rotation, covariance):
    """Variance of the plane's normal, rad^2, both directions together, from the pose's covariance (6, 6)."""
    total = 0.0
    for i in range(3):
        total += covariance[3 + i, 3 + i]
        for j in range(3):
            total -= rotation[i, 2] * covariance[3 + i, 3 + j] * rotation[j, 2]
    return total


@compiled
def _invert(a, out):
    """Inverse (6, 6) of the symmetric matrix whose lower triangle ``a`` holds, destroyed; huge where it is singular.

    Source: Cholesky, a = L L', then the inverse of L, column by column.
    """
    for j in range(6):
        for k in range(j + 1):
            total = a[j, k]
            for i in range(k):
                total -= a[j, i] * a[k, i]
            if k < j:
                a[j, k] = total / a[k, k]
            elif total > 0.0:
                a[j, j] = math.sqrt(total)
            else:
                out[:, :] = 0.0
                for i in range(6):
                    out[i, i] = 1e6
                return
    for j in range(6):
        a[j, j] = 1.0 / a[j, j]
        for i in range(j + 1, 6):
            total = 0.0
            for k in range(j, i):
                total -= a[i, k] * a[k, j]
            a[i, j] = total / a[i, i]
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, 6):
                total += a[k, i] * a[k, j]
            out[i, j] = out[j, i] = total


@compiled
def move_origin(covariance, arm):
    """Covariance (6, 6) of pose, translation first, when its origin moves by ``arm`` (3,), in the parent's axes."""
    # dt' = dt + w x arm: rows of translation gain K times rows of rotation, then the columns likewise.
    a, b, c = arm[0], arm[1], arm[2]
    for j in range(6):
        p, q, r = covariance[3, j], covariance[4, j], covariance[5, j]
        covariance[0, j] += q * c - r * b
        covariance[1, j] += r * a - p * c
        covariance[2, j] += p * b - q * a
    for i in range(6):
        p, q, r = covariance[i, 3], covariance[i, 4], covariance[i, 5]
        covariance[i, 0] += q * c - r * b
        covariance[i, 1] += r * a - p * c
        covariance[i, 2] += p * b - q * a


@compiled
def turn_axes(turn, covariance):
    """The same covariance (6, 6) about axes turned by ``turn`` (3, 3), in place."""
    block, half = np.empty((3, 3)), np.empty((3, 3))
    for row in range(0, 6, 3):
        for column in range(0, 6, 3):
            block[:, :] = covariance[row : row + 3, column : column + 3]
            product_into(turn, block, half)
            for i in range(3):
                for j in range(3):
                    total = 0.0
                    for k in range(3):
                        total += half[i, k] * turn[j, k]
                    covariance[row + i, column + j] = total
