"""What residuals say beyond the spots' own noise: that all spots are a little off, or that one LED's spot is odd."""

import math

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.pose.fit import LEDS
from asterism.server.pose.matched import LEAST_SIGMA_PX, first, gather, lit_room
from asterism.server.pose.planar import NO_SOLUTION, refine_pose, solve_both
from asterism.server.pose.rotations import mapped

ITERATIONS = 12
ODD = 10.0  # how many times worse six LEDs fit than five before the sixth is left out
ODD_BEFORE, ODD_AREA_PX2 = 0.01, 30.0  # how often other light moves a spot, and over what area
CLEARLY_OFF = 3.0  # times the surprising cost: if five LEDs then fit without surprise, the sixth is left out as well
NO_SYSTEMATIC, PLATE, ANYTHING = 20.0, 2.0, 0.05  # odds, before a look at the residuals, of what spots are off by
PLATE_SHARE = 1.2e-3  # what LEDs of a plate made with care are off by, of their distance from its middle: 0.05 in 40 mm
PLATE_SPREAD = 0.8  # one sigma of the logarithm of that variance
SYSTEMATIC_STEPS = 11  # doublings, from a thirty-second of that to thirty-two times: a ruler's errors, seen near by
LEAST_KNOWN_PX = 0.01  # what was learned and is less says no more than that the rig is good
GOOD = 0.1  # times as likely is it then that its LEDs are off
UNLIKE_KNOWN = 20.0  # odds of the variance that was learned against every other
# 99.9 % of chi squared for 2, 4 and 6 degrees of freedom: beyond it the spots' noise is not the whole story.
_SURPRISE = np.array([0.0, 0.0, 0.0, 0.0, 13.8, 18.5, 22.5])


_STEPS = np.arange(SYSTEMATIC_STEPS) - SYSTEMATIC_STEPS // 2
_BELL = np.exp(-0.5 * (2.0 * np.log(2.0) / PLATE_SPREAD * _STEPS) ** 2)


def _log_priors() -> Floats:
    """Logarithms (3, SYSTEMATIC_STEPS + 1) of how likely variances are beforehand, none first, and where nothing is
    known of a robot's LEDs, where they are known to be good, and about a variance that is known.
    """
    weights = np.empty((3, SYSTEMATIC_STEPS + 1))
    for row, factor in enumerate((1.0, GOOD)):
        weights[row, 0] = NO_SYSTEMATIC
        weights[row, 1:] = factor * PLATE * _BELL / _BELL.sum() + ANYTHING / SYSTEMATIC_STEPS
    weights[2, 0] = 1.0 / (SYSTEMATIC_STEPS + 1)
    weights[2, 1:] = weights[2, 0] + UNLIKE_KNOWN * _BELL
    logs: Floats = np.log(weights / weights.sum(axis=1)[:, None])
    return logs


_LOG_PRIORS = _log_priors()


@compiled
def systematic(rotation, t, lit, focal, known2):
    """What residuals say of a variance, ray units, that every spot has beyond its own, and for the pose itself.

    Returns the variance's posterior mean, and the pose's cost: minus twice the logarithm of how likely the residuals
    are with every such variance there may be, chi squared where the spots' own noise explains them. Of two poses
    neither of which fits on that noise, the better is hardly more likely than the other, however much chi squared
    tells them apart.

    Before, it is none with odds NO_SYSTEMATIC, with odds PLATE that of LEDs which are off by what a plate made with
    care has, log-normal about PLATE_SHARE of its size as it is seen, and with odds ANYTHING any within
    SYSTEMATIC_STEPS doublings about it. So a far robot's dim spots, whose noise exceeds that of its plate, are taken as
    they are told, and a near robot's bright ones are not. Where earlier frames have told, it is about that variance,
    ``known2`` (0 where they have not): log-normal, and with odds UNLIKE_KNOWN to 1 against it any other, or none.
    The likelihood is that of residuals with 2 n - 6 degrees of freedom. A mean, since with so few of them the most
    likely value is often far too small, and errors weighted by it far too large; of more than four LEDs it is weighted
    by the size as well: squared errors follow Fisher's distribution, of which the plain mean leaves too many far out.
    """
    points, seen, information = lit.points, lit.seen, lit.information
    n = points.shape[0]
    is_known = known2 > (LEAST_KNOWN_PX / focal) ** 2
    middle = known2
    if not is_known:
        size2 = 0.0
        for i in range(n):
            size2 += points[i, 0] ** 2 + points[i, 1] ** 2
        middle = PLATE_SHARE * PLATE_SHARE * size2 / (n * t[2] * t[2])
    before = _LOG_PRIORS[2 if is_known else (1 if known2 > 0.0 else 0)]
    # Squared residuals over all variances, and the product of the determinants over those of the spots' own noise.
    room = np.zeros((3, SYSTEMATIC_STEPS + 1))
    squares, growth, variances = room[0], room[1], room[2]
    growth[:] = 1.0
    variances[1] = middle * 4.0 ** (1 - (SYSTEMATIC_STEPS + 1) // 2)
    for k in range(2, SYSTEMATIC_STEPS + 1):
        variances[k] = 4.0 * variances[k - 1]
    for i in range(n):
        x, y, z = mapped(rotation, t, points[i])
        e, f = seen[i, 0] - x / z, seen[i, 1] - y / z
        per_det = information[i, 0] * information[i, 2] - information[i, 1] ** 2
        own_xx, xy, own_yy = information[i, 2] / per_det, -information[i, 1] / per_det, information[i, 0] / per_det
        for k in range(SYSTEMATIC_STEPS + 1):
            xx, yy = own_xx + variances[k], own_yy + variances[k]
            det = xx * yy - xy * xy
            squares[k] += (yy * e * e - 2.0 * xy * e * f + xx * f * f) / det
            growth[k] *= det * per_det
    most = -NO_SOLUTION
    for k in range(SYSTEMATIC_STEPS + 1):
        squares[k] = before[k] - 0.5 * (squares[k] + (n - 3.0) / n * math.log(growth[k]))
        most = max(most, squares[k])
    none = math.exp(squares[0] - most)
    some = sizes = mean = 0.0
    for k in range(1, SYSTEMATIC_STEPS + 1):
        likely = math.exp(squares[k] - most)
        # Of six LEDs that power is a root, and found faster as one.
        size = math.sqrt(variances[k]) if n == LEDS else variances[k] ** (0.25 * (n - 4))
        some += likely
        sizes += likely * size
        mean += likely * size * variances[k]
    mean *= some / max(sizes, 1e-300)
    return mean / (none + some), -2.0 * (most + math.log(none + some))


@compiled
def odd_led(layout, labels, measured, shifts, start, start_t, focal, known2):
    """The LED of six whose spot is not where the other five say, or -1: other light may have moved it.

    The start (3, 3), (3,) is changed to the pose refined on all six, where they agree. ``shifts`` (6, 2) are those at
    the start; ``known2`` as in `systematic`. Of six spots that are all a little off, some five always fit better than
    all; so one is odd only if that is likelier than that all are off.
    """
    room, centre, trial = lit_room(), np.empty(3), np.empty(LEDS, np.int64)
    rotation, t = np.empty((3, 3)), np.empty(3)
    both, both_t, both_costs = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty(2)
    best_led, best_cost, whole_cost = -1, NO_SOLUTION, NO_SOLUTION
    best_unlikely = whole_unlikely = NO_SOLUTION
    if known2 > (LEAST_KNOWN_PX / focal) ** 2:
        # Six that fit as well as they did before are no surprise.
        count = gather(layout, labels, measured, shifts, known2, focal, room, centre)
        lit = first(room, count)
        rotation[:, :] = start
        for i in range(3):
            t[i] = start_t[i]
            for j in range(3):
                t[i] += start[i, j] * centre[j]
        if refine_pose(rotation, t, lit.points, lit.seen, lit.information, 5) <= _SURPRISE[min(count, LEDS)]:
            return -1
    for without in range(-1, LEDS):
        trial[:] = labels
        if without >= 0:
            trial[without] = -1
        count = gather(layout, trial, measured, shifts, 0.0, focal, room, centre)
        if without < 0 and count < LEDS:
            return -1
        lit = first(room, count)
        rotation[:, :] = start
        for i in range(3):
            t[i] = start_t[i]
            for j in range(3):
                t[i] += start[i, j] * centre[j]
        cost = refine_pose(rotation, t, lit.points, lit.seen, lit.information, 5)
        if without < 0:
            if cost <= _SURPRISE[LEDS]:
                start[:, :] = rotation
                for i in range(3):
                    start_t[i] = t[i]
                    for j in range(3):
                        start_t[i] -= rotation[i, j] * centre[j]
                return -1
            whole_cost = cost
        # The start may be the wrong tilt, which the odd spot made the better one.
        solve_both(lit.points, lit.seen, lit.information, ITERATIONS, both, both_t, both_costs)
        for which in range(2):
            if both_costs[which] < cost:
                cost = both_costs[which]
                rotation[:, :] = both[which]
                t[:] = both_t[which]
        _, unlikely = systematic(rotation, t, lit, focal, known2)
        if without < 0:
            whole_cost, whole_unlikely = cost, unlikely
        elif cost < best_cost:
            best_led, best_cost, best_unlikely = without, cost, unlikely
    # Compared per degree of freedom: six LEDs leave six, five leave four.
    much_worse = ODD * best_cost / 4.0 < whole_cost / 6.0
    only_one_off = best_cost <= _SURPRISE[LEDS - 1] and whole_cost > CLEARLY_OFF * _SURPRISE[LEDS]
    odd = measured.covariances[labels[best_led]]
    area = 2.0 * math.pi * math.sqrt(max(odd[0] * odd[2] - odd[1] * odd[1], 0.0)) * focal * focal
    best_unlikely -= 2.0 * math.log(ODD_BEFORE * max(area, LEAST_SIGMA_PX**2) / ODD_AREA_PX2)
    likelier = best_unlikely < whole_unlikely
    return best_led if likelier and (much_worse or only_one_off) else -1
