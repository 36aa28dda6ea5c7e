"""Cold search: which spots are which robot's LEDs, without any idea where the robots are.

Every spot in turn, brightest first, is combined with three dimmer ones among its nearest; the quad table says which
robots and labels the four can be; the weak perspective of three of them says how far the invariants must have moved;
the exact homography of the four predicts the other two LEDs; a calibrated pose of the five or six decides. Six LEDs
that fit, of a robot that cannot be mistaken at that residual, are claimed at once; all else is a hypothesis that
`assign` judges together with its rivals.

First only spots that are much alike are combined, as the LEDs of one robot are; then, for robots still missing, spots
that are less alike, and more of them, as far as a number of quads that grows with the number of spots allows.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.identity.evidence import is_alone
from asterism.server.identity.neighbours import first_from, nearest_neighbours
from asterism.server.identity.plan import MOST_TILT, Plan
from asterism.server.identity.quads import look_up
from asterism.server.pose.fit import CHI2, LEDS, SYSTEMATIC_PX, fit_labelled, median_of, misfit
from asterism.server.segmentation.order import ascending

Ints = NDArray[np.int64]

# Passes: least ratio of heights and of radii, nearest neighbours that are combined.
ALIKE_HEIGHT, ALIKE_RADIUS, ALIKE_DEPTHS = 0.5, 0.75, (6, 10)
HEIGHT_RATIO, RADIUS_RATIO = 0.2, 0.4
DEPTHS = (8, 14, 24)
MOST_QUADS = 12  # for every spot, of less alike ones; beyond that only the nearer combinations were tried
REACH_PX = 3.0  # how far an LED may lie from where the homography of four puts it
FREE_QUADS = 5000  # however few spots there are
SPOT_ERROR_PX = 0.2  # what a spot may be off while its quad is looked up
MIRROR_RATIO = 0.6  # a second explanation of a robot is a mirror image if it is dimmer than this
EVEN_HEIGHT = 1.7  # of the median height of a robot's spots: a brighter one among them may be another's

MOST_CLAIMS, MOST_PENDING = 256, 1024

# Columns of a hypothesis beside its six spots (-1: not visible): robot, LEDs seen, cost in squared sigmas of
# SYSTEMATIC_PX, median height.
ROBOT, SEEN, COST, HEIGHT = range(4)

Found = tuple[int, Ints, Floats, Floats]  # robot, spots, rotation (3, 3) and translation (3,) of T_camera_plane


class Spots(NamedTuple):
    """What is searched. ``flat`` (n, 2) ideal px, y up; ``rays`` (n, 2) the same as x / z, y / z (y down);
    ``variances`` (n,) of the rays; ``heights`` (n,); ``radii`` (n,) px; ``free`` (n,): not yet a robot's.
    """

    flat: Floats
    rays: Floats
    variances: Floats
    heights: Floats
    radii: Floats
    free: Any


class Sought(NamedTuple):
    """Whom to look for. ``layouts`` (robots, 6, 3) m; ``separations`` (robots,) m, from any other robot and any other
    labelling; ``claimed`` (robots,) and ``brightness`` (robots,) of robots that are known already, for which only
    brighter rivals are of interest; the rest is the `QuadTable`'s.
    """

    layouts: Floats
    separations: Floats
    claimed: Any
    brightness: Floats
    entries: Any
    numbers: Floats
    starts: Any
    held: Any


class Limits(NamedTuple):
    """``focal`` px; ``near`` and ``far`` m; ``most_tilt``: the cosine of the largest tilt; ``reach``: how far LEDs of
    one robot are apart at most, px, and ``reach_in_radii``, in radii of their spots; ``fewest`` LEDs that make a
    hypothesis; ``alone``: four spots are to make one, all that they may be, but only where they stand apart from all
    like them.
    """

    focal: float
    near: float
    far: float
    most_tilt: float
    reach: float
    reach_in_radii: float
    fewest: int
    alone: bool


class Fits(NamedTuple):
    """Room for hypotheses: ``spots`` (m, 6), ``values`` (m, 4), ``rotations`` (m, 3, 3), ``ts`` (m, 3) of
    T_camera_plane; ``filled`` (1,) how many there are.
    """

    spots: Ints
    values: Floats
    rotations: Floats
    ts: Floats
    filled: Ints

    @staticmethod
    def room(most: int) -> "Fits":
        """Room for so many."""
        return Fits(
            np.empty((most, LEDS), np.int64),
            np.empty((most, 4)),
            np.empty((most, 3, 3)),
            np.empty((most, 3)),
            np.zeros(1, np.int64),
        )

    def held(self) -> "Fits":
        """Without the empty room."""
        n = int(self.filled[0])
        return Fits(self.spots[:n], self.values[:n], self.rotations[:n], self.ts[:n], self.filled)


class _Work(NamedTuple):
    """Scratch of one search."""

    four: Any  # (4, 2)
    order: Any  # (4,)
    values: Any  # (2,)
    matches: Any  # (64,): entries of the quad table
    members: Any  # (4,)
    spots4: Any  # (4,)
    leds4: Any  # (4,)
    labels: Any  # (6,)
    h: Any  # (3, 3)
    left: Any
    right: Any
    h2: Any
    points: Any  # (6, 3)
    seen: Any  # (6, 2)
    information: Any  # (6, 3)
    rotations: Any  # (2, 3, 3)
    ts: Any  # (2, 3)
    by_x: Any  # (n,)
    xs: Any  # (n,)


@compiled
def _work(flat):
    by_x = ascending(flat[:, 0])
    return _Work(
        np.empty((4, 2)), np.empty(4, np.int64), np.empty(2), np.empty(64, np.int64),
        np.empty(4, np.int64), np.empty(4, np.int64), np.empty(4, np.int64),
        np.empty(LEDS, np.int64),
        np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)),
        np.empty((LEDS, 3)), np.empty((LEDS, 2)), np.empty((LEDS, 3)), np.empty((2, 3, 3)), np.empty((2, 3)),
        by_x, flat[by_x, 0],
    )  # fmt: skip


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
def _complete(
    flat, free, heights, radii, layouts, entries, entry, spots4, leds4, by_x, xs, reach, h, left, right, labels
):
    """Take the four spots ``spots4`` for the LEDs of an entry of the quad table, and look for its other two within
    ``reach`` px of where the homography of the four puts them.

    Fills ``leds4`` (4,) and ``labels`` (6,; -1: no spot), and returns how many LEDs then have a spot (0: these four
    cannot be).
    """
    robot = entries[entry, 0]
    labels[:] = -1
    low, high, small, large = np.inf, 0.0, np.inf, 0.0
    for m in range(4):
        spot = spots4[m]
        leds4[m] = entries[entry, 1 + m]
        labels[leds4[m]] = spot
        low, high = min(low, heights[spot]), max(high, heights[spot])
        small, large = min(small, radii[spot]), max(large, radii[spot])
    if small < RADIUS_RATIO * large or not _homography4(layouts[robot], leds4, flat, spots4, h, left, right):
        return 0
    found = 4
    for led in range(LEDS):
        if labels[led] >= 0:
            continue
        x, y = layouts[robot, led, 0], layouts[robot, led, 1]
        w = h[2, 0] * x + h[2, 1] * y + 1.0
        if w < 0.3:
            continue
        px = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
        py = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
        best, best2 = -1, reach * reach
        place = first_from(xs, px - reach)
        while place < xs.shape[0] and xs[place] <= px + reach:
            spot = by_x[place]
            place += 1
            away2 = (flat[spot, 0] - px) ** 2 + (flat[spot, 1] - py) ** 2
            if not (away2 < best2 and free[spot]):
                continue
            taken = False
            for other in range(LEDS):
                taken |= labels[other] == spot
            if not taken and (
                heights[spot] >= HEIGHT_RATIO * high
                and low >= HEIGHT_RATIO * heights[spot]
                and radii[spot] >= RADIUS_RATIO * large
                and small >= RADIUS_RATIO * radii[spot]
            ):
                best, best2 = spot, away2
        if best >= 0:
            labels[led] = best
            found += 1
    return found


@compiled
def _fit(spots, layout, work, systematic2):
    """Pose of the spots in ``work.labels``; of six that do not fit the worst is given up.

    Returns how many LEDs it rests on, the cost, and which of ``work.rotations`` it is (negative: there is none).
    """
    labels = work.labels
    count, cost, which = fit_labelled(
        layout, labels, spots.rays, spots.variances, systematic2, 3,
        work.points, work.seen, work.information, work.rotations, work.ts, work.h2,
    )  # fmt: skip
    if which >= 0 and count == LEDS and cost > CHI2[LEDS]:
        # One of the six may be somebody else's light.
        worst, worst_led = 0.0, 0
        for led in range(LEDS):
            off = misfit(layout, led, work.rotations[which], work.ts[which], spots.rays[labels[led]])
            if off > worst:
                worst, worst_led = off, led
        labels[worst_led] = -1
        count, cost, which = fit_labelled(
            layout, labels, spots.rays, spots.variances, systematic2, 3,
            work.points, work.seen, work.information, work.rotations, work.ts, work.h2,
        )  # fmt: skip
    return count, cost, which


@compiled
def _keep(fits, labels, robot, count, cost, height, rotation, t):
    """Add a hypothesis, if it is new and there is room."""
    slot = fits.filled[0]
    for other in range(slot):
        if fits.values[other, ROBOT] == robot:
            same = True
            for led in range(LEDS):
                same &= fits.spots[other, led] == labels[led]
            if same:
                return False
    if slot == fits.spots.shape[0]:
        return False
    fits.spots[slot] = labels
    fits.values[slot, ROBOT], fits.values[slot, SEEN] = robot, count
    fits.values[slot, COST], fits.values[slot, HEIGHT] = cost, height
    fits.rotations[slot] = rotation
    fits.ts[slot] = t
    fits.filled[0] = slot + 1
    return True


@compiled
def _judge(robot, spots, sought, limits, claims, pending, work, systematic2):
    """Fit a robot to the spots ``work.labels`` and keep what fits; returns whether the robot was claimed."""
    heights, labels, layout = spots.heights, work.labels, sought.layouts[robot]
    count, cost, which = _fit(spots, layout, work, systematic2)
    if which < 0 or cost > CHI2[count]:
        return False
    depth_m = work.ts[which, 2]
    if not 0.8 * limits.near <= depth_m <= 1.25 * limits.far:
        return False
    height = median_of(heights, labels)
    if sought.claimed[robot] and height < MIRROR_RATIO * sought.brightness[robot]:
        return False
    # Residual norm, m, at the robot: far below the separation no other robot fits as well.
    residual = math.sqrt(cost * systematic2) * depth_m
    certain = count == LEDS and 3.0 * residual <= sought.separations[robot] and not sought.claimed[robot]
    for led in range(LEDS):
        if labels[led] >= 0:
            certain &= heights[labels[led]] < EVEN_HEIGHT * height
    if not certain:
        _keep(pending, labels, robot, count, cost, height, work.rotations[which], work.ts[which])
        return False
    if not _keep(claims, labels, robot, count, cost, height, work.rotations[which], work.ts[which]):
        return False
    sought.claimed[robot] = True
    sought.brightness[robot] = height
    for led in range(LEDS):
        spots.free[labels[led]] = False
    return True


@compiled
def _combine(
    spots, sought, limits, claims, pending, work, reaches, lists, counts, by_height, previous, depth, most, systematic2
):
    """Try every spot with three of its first ``depth`` neighbours, at least one beyond the first ``previous``.

    Stops after ``most`` quads; returns how many were tried.
    """
    flat, free, heights, radii = spots.flat, spots.free, spots.heights, spots.radii
    four, order, values, matches, members = work.four, work.order, work.values, work.matches, work.members
    spots4, leds4, labels, h, left, right = work.spots4, work.leds4, work.labels, work.h, work.left, work.right
    by_x, xs, layouts = work.by_x, work.xs, sought.layouts
    entries, numbers, starts, held = sought.entries, sought.numbers, sought.starts, sought.held
    focal, most_tilt = limits.focal, limits.most_tilt
    least_scale, most_scale = 0.8 * focal / limits.far, 1.25 * focal / limits.near
    slack_px, reach_others = SPOT_ERROR_PX, REACH_PX
    if limits.alone:
        slack_px, reach_others = 3.0 * SPOT_ERROR_PX, 0.0  # the other two are hidden
    quads = 0
    for i in by_height:
        size, reach = min(counts[i], depth), reaches[i]
        for a in range(size):
            j = lists[i, a]
            if not free[i]:
                break
            if not free[j]:
                continue
            for b in range(a + 1, size):
                k = lists[i, b]
                if not (free[i] and free[j]):
                    break
                if not free[k] or abs(flat[j, 0] - flat[k, 0]) > reach or abs(flat[j, 1] - flat[k, 1]) > reach:
                    continue
                for c in range(max(b + 1, previous), size):
                    l = lists[i, c]  # noqa: E741
                    if not free[l] or abs(flat[j, 0] - flat[l, 0]) > reach or abs(flat[j, 1] - flat[l, 1]) > reach:
                        continue
                    quads += 1
                    if quads > most:
                        return quads
                    found = look_up(
                        flat, i, j, k, l, numbers, starts, held, slack_px, least_scale, most_scale, most_tilt,
                        focal, four, order, values, matches,
                    )  # fmt: skip
                    if found == 0:
                        continue
                    members[0], members[1], members[2], members[3] = i, j, k, l
                    brightest = heights[i]  # the others rank after it
                    for m in range(4):
                        spots4[m] = members[order[m]]
                    claimed = False
                    for m in range(found):
                        robot = entries[matches[m], 0]
                        if claimed or (sought.claimed[robot] and brightest < MIRROR_RATIO * sought.brightness[robot]):
                            continue
                        seen = _complete(
                            flat, free, heights, radii, layouts, entries, matches[m], spots4, leds4,
                            by_x, xs, reach_others, h, left, right, labels,
                        )  # fmt: skip
                        if seen >= limits.fewest and (not limits.alone or is_alone(flat, free, heights, labels)):
                            claimed = _judge(robot, spots, sought, limits, claims, pending, work, systematic2)
                    if claimed and not (free[i] and free[j] and free[k]):
                        break
    return quads


@compiled
def search(spots, sought, limits, claims, pending):
    """Search the free spots for the robots.

    Arguments: `Spots`, `Sought`, `Limits` and twice `Fits`. Fills ``claims`` with robots found beyond doubt, whose
    spots are then no longer free, and ``pending`` with hypotheses. Returns the number of quads tried.
    """
    n = spots.flat.shape[0]
    by_height = ascending(-spots.heights)
    ranks = np.empty(n, np.int64)
    ranks[by_height] = np.arange(n)
    # An LED's spot tells how near it is, and so how far the others may be.
    reaches = np.minimum(limits.reach, limits.reach_in_radii * spots.radii)
    work = _work(spots.flat)
    systematic2 = (SYSTEMATIC_PX / limits.focal) ** 2
    lists, counts = np.empty((n, ALIKE_DEPTHS[-1]), np.int32), np.zeros(n, np.int32)
    nearest_neighbours(
        spots.flat, spots.free, ranks, spots.heights, spots.radii, ALIKE_HEIGHT, ALIKE_RADIUS, reaches,
        lists, counts,
    )  # fmt: skip
    quads, previous = 0, 0
    for depth in ALIKE_DEPTHS:
        quads += _combine(
            spots, sought, limits, claims, pending, work, reaches, lists, counts, by_height, previous, depth, n * n * n,
            systematic2,
        )  # fmt: skip
        previous = depth
    budget = quads + max(MOST_QUADS * n, FREE_QUADS)
    if sought.claimed.all():
        return quads  # rivals of robots that are found stand together, and were met already
    lists = np.empty((n, DEPTHS[-1]), np.int32)
    nearest_neighbours(
        spots.flat, spots.free, ranks, spots.heights, spots.radii, HEIGHT_RATIO, RADIUS_RATIO, reaches,
        lists, counts,
    )  # fmt: skip
    previous = 0
    for depth in DEPTHS:
        if quads < budget and not sought.claimed.all():
            quads += _combine(
                spots, sought, limits, claims, pending, work, reaches, lists, counts, by_height, previous, depth,
                budget - quads, systematic2,
            )  # fmt: skip
        previous = depth
    return quads


def searched(
    spots: Spots, plan: Plan, claimed: NDArray[np.bool_], brightness: Floats, fewest: int, alone: bool = False
) -> tuple[Fits, Fits]:
    """Claims and hypotheses of a search, cut to what there is."""
    quads = plan.quads
    sought = Sought(
        plan.layouts, plan.separations, claimed, brightness, quads.entries, quads.numbers, quads.starts, quads.held
    )
    limits = Limits(plan.focal, plan.near, plan.far, MOST_TILT, plan.reach_px, plan.reach_in_radii, fewest, alone)
    claims, pending = Fits.room(MOST_CLAIMS), Fits.room(MOST_PENDING)
    search(spots, sought, limits, claims, pending)
    return claims.held(), pending.held()
