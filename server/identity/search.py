"""Cold search: which spots are which robot's LEDs, without any idea where the robots are.

Every spot in turn, brightest first, is combined with three dimmer ones among its nearest; the quad table says which
robots and labels the four may be; the perspective in which a plate would show them so predicts the other two LEDs; a
calibrated pose of the five or six decides. Six LEDs that fit, of a robot that cannot be mistaken at that residual, are
claimed at once; all else is a hypothesis that `assign` judges together with its rivals. All of it happens on the
sphere of directions, and in planes that touch it: the same anywhere in the image of any lens.

First only spots that are much alike are combined, as the LEDs of one robot are; then, for robots still missing, spots
that are less alike, and more of them, as far as a number of quads that grows with the number of spots allows.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.identity.complete import HEIGHT_RATIO, RADIUS_RATIO, Four, complete, room_for_four
from asterism.server.identity.evidence import is_alone
from asterism.server.identity.hypotheses import Fits, keep
from asterism.server.identity.neighbours import (
    Directions,
    Neighbours,
    Spots,
    apart2,
    directions_of,
    nearest_neighbours,
)
from asterism.server.identity.perspective import View
from asterism.server.identity.plan import MOST_TILT, NEARER, WIDEST, Plan
from asterism.server.identity.quads import LookedUp, QuadTable, look_up, room_to_look_up
from asterism.server.pose.fit import CHI2, LEDS, SYSTEMATIC_PX, FitRoom, fit_labelled, fit_room, median_of, misfit
from asterism.server.pose.sphere import distance, project, touch
from asterism.server.segmentation.order import ascending

# Passes: least ratio of heights and of radii, nearest neighbours that are combined.
ALIKE, ALIKE_DEPTHS = (0.5, 0.75), (6, 10)
DEPTHS = (8, 14, 24)
REACH_MARGIN = 1.8  # how far from a spot its robot's others may be, over what those of found robots say of LEDs' sizes
MOST_QUADS = 12  # for every spot, of less alike ones; beyond that only the nearer combinations were tried
REACH_PX = 3.0  # how far an LED may lie from where four others put it
FREE_QUADS = 5000  # however few spots there are
# For a second opinion (`loose`, `explain`) so many for all robots that are sought together: of a catalogue hundreds
# that are not there are looked for.
SECOND_QUADS = 20 * FREE_QUADS
ANY = 2**31
SPOT_ERROR_PX = 0.2  # what a spot may be off while its quad is looked up, one sigma
LEAST_NEARNESS, MOST_NEARNESS = 0.6, 1.6  # 1 / depth of a quad over 1 / far and 1 / near
SMALLEST_QUAD_PX2 = 30.0  # twice the area: smaller ones say nothing
MIRROR_RATIO = 0.6  # a second explanation of a robot is a mirror image if it is dimmer than this
EVEN_HEIGHT = 1.7  # of the median height of a robot's spots: a brighter one among them may be another's

# Times a residual that the separation from all else must be at least. What the rig has wrong may be as large as the
# residual shows: of two robots that six spots may be, one with the residual r, the other with R, the first is (R / r)^6
# times as likely where nothing is known of how far off either is. A thousand, and the separation is r + R at most.
FAR_BELOW, FARTHER_BELOW = 3.0, 4.2

MOST_CLAIMS, MOST_PENDING = 256, 1024


class Sought(NamedTuple):
    """Whom to look for. ``layouts`` (robots, 6, 3) m; ``separations`` (robots,) m, from any other robot and any other
    labelling; ``claimed`` (robots,) and ``brightness`` (robots,) of robots that are known already, for which only
    brighter rivals are of interest; ``quads``, the robots' table.
    """

    layouts: Floats
    separations: Floats
    claimed: Any
    brightness: Floats
    quads: QuadTable


class Limits(NamedTuple):
    """``focal`` px; ``near`` and ``far`` m; ``most_tilt``: the cosine of the largest tilt; ``reach``: the chord by
    which the directions of one robot's LEDs are apart at most; ``extent`` of the largest constellation, m; ``fewest``
    LEDs that make a hypothesis; ``alone``: four spots are to make one, all that they may be, but only where they stand
    apart from all like them; ``tolerance``, px: what lens and LED positions may be off, one sigma; ``unlike``: quads of
    less alike spots that are tried at most.
    """

    focal: float
    near: float
    far: float
    most_tilt: float
    reach: float
    extent: float
    fewest: int
    alone: bool
    tolerance: float
    unlike: int


class Results(NamedTuple):
    """Robots found beyond doubt, ``claims``, and hypotheses, ``pending``."""

    claims: Fits
    pending: Fits


class _Pass(NamedTuple):
    """A pass over the spots in the order ``by_height`` (n,): each with three of its first ``sizes`` (n,) neighbours, at
    least one beyond the first ``previous`` (n,), which were tried; it ends after ``most`` quads.
    """

    by_height: Any
    near: Neighbours
    previous: Any
    sizes: Any
    most: int


class _Work(NamedTuple):
    """The ``directions`` of the spots and scratch of one search; ``local`` (k, 2): a spot's neighbours in the plane
    that touches the sphere there.
    """

    directions: Directions
    looked_up: LookedUp
    four: Four
    local: Any
    fit: FitRoom


@compiled
def _fit(spots, layout, labels, room, systematic2):
    """Pose of the spots ``labels`` (6,); of six that do not fit the worst is given up.

    Returns how many LEDs it rests on, the cost, and which of the ``room``'s poses it is (negative: there is none).
    """
    count, cost, which = fit_labelled(layout, labels, spots.rays, spots.variances, systematic2, 3, room)
    if which >= 0 and count == LEDS and cost > CHI2[LEDS]:
        # One of the six may be somebody else's light.
        worst, worst_led = 0.0, 0
        for led in range(LEDS):
            off = misfit(layout, led, room.rotations[which], room.ts[which], spots.rays[labels[led]])
            if off > worst:
                worst, worst_led = off, led
        labels[worst_led] = -1
        count, cost, which = fit_labelled(layout, labels, spots.rays, spots.variances, systematic2, 3, room)
    return count, cost, which


@compiled
def _judge(robot, spots, sought, limits, results, work):
    """Fit a robot to the four spots' labels and keep what fits; returns whether the robot was claimed."""
    heights, labels, layout = spots.heights, work.four.labels, sought.layouts[robot]
    systematic2 = (limits.tolerance / limits.focal) ** 2
    count, cost, which = _fit(spots, layout, labels, work.fit, systematic2)
    if which < 0 or cost > CHI2[count] or count < min(limits.fewest, LEDS):
        return False
    rotation, t = work.fit.rotations[which], work.fit.ts[which]
    # Far off the axis a robot far away is at a small depth: it counts as what is nearer to the range.
    away_m = distance(t)
    if not (0.8 * limits.near <= away_m and t[2] <= 1.25 * limits.far):
        return False
    height = median_of(heights, labels)
    if sought.claimed[robot] and height < MIRROR_RATIO * sought.brightness[robot]:
        return False
    # Residual norm, m, at the robot: far below the separation no other robot fits as well.
    residual = math.sqrt(cost * systematic2) * away_m
    apart = FAR_BELOW if limits.tolerance <= SYSTEMATIC_PX else FARTHER_BELOW
    certain = count == LEDS and apart * residual <= sought.separations[robot] and not sought.claimed[robot]
    for led in range(LEDS):
        if labels[led] >= 0:
            certain &= heights[labels[led]] < EVEN_HEIGHT * height
    if not certain:
        keep(results.pending, labels, robot, count, cost, height, rotation, t)
        return False
    if not keep(results.claims, labels, robot, count, cost, height, rotation, t):
        return False
    sought.claimed[robot] = True
    sought.brightness[robot] = height
    for led in range(LEDS):
        spots.free[labels[led]] = False
    return True


@compiled
def _view(limits):
    """How `look_up` may see a robot within the `Limits`, with some room."""
    slack_px, focal = 3.0 * SPOT_ERROR_PX if limits.alone else SPOT_ERROR_PX, limits.focal
    slack_px += max(limits.tolerance - SYSTEMATIC_PX, 0.0)
    least, most = LEAST_NEARNESS / limits.far, MOST_NEARNESS / limits.near
    return View(least, most, 0.8 * limits.most_tilt, slack_px / focal, SMALLEST_QUAD_PX2 / focal**2)


@compiled
def _try(members, spots, sought, limits, results, work, found):
    """Judge the ``found`` robots and labels that `look_up` names for four spots (4,); whether a robot was claimed."""
    four, looked_up, entries = work.four, work.looked_up, sought.quads.entries
    brightest = spots.heights[members[0]]  # the others rank after it
    # Alone, the other two are hidden.
    reach_px = 0.0 if limits.alone else REACH_PX + 3.0 * max(limits.tolerance - SYSTEMATIC_PX, 0.0)
    reach = reach_px / limits.focal
    for m in range(4):
        four.spots[m] = members[looked_up.order[m]]
    for m in range(found):
        entry = entries[looked_up.matches[m]]
        robot = entry[0]
        if sought.claimed[robot] and brightest < MIRROR_RATIO * sought.brightness[robot]:
            continue
        seen = complete(spots, work.directions, sought.layouts[robot], entry[1:], looked_up.hs[m], four, reach)
        if (
            seen >= limits.fewest
            and (not limits.alone or is_alone(spots.flat, spots.free, spots.heights, four.labels))
            and _judge(robot, spots, sought, limits, results, work)
        ):
            return True
    return False


@compiled
def _are_apart(local, a, b, reach):
    """Whether two neighbours of a spot are too far apart for one robot."""
    return abs(local[a, 0] - local[b, 0]) > reach or abs(local[a, 1] - local[b, 1]) > reach


@compiled
def _fill_wanted(brightest, sought, wanted):
    """Set ``wanted`` (robots,) for the robots that spots no brighter than that may be; whether there are any."""
    some = False
    for robot in range(wanted.shape[0]):
        wanted[robot] = not sought.claimed[robot] or brightest >= MIRROR_RATIO * sought.brightness[robot]
        some |= wanted[robot]
    return some


@compiled
def _lay_out(i, near, size, work):
    """Fill ``local`` with the first ``size`` neighbours of spot ``i``."""
    units, frame = work.directions.units, work.four.frame
    touch(units[i], frame)
    for a in range(size):
        work.local[a, 0], work.local[a, 1] = project(frame, units[near.lists[i, a]])


@compiled
def _combine(spots, sought, limits, pass_, results, work):
    """Try every spot with three of its neighbours, as the `_Pass` says; returns how many quads were tried."""
    free, lists, four, local, reach = spots.free, pass_.near.lists, work.looked_up.four, work.local, limits.reach
    view, members, wanted = _view(limits), np.empty(4, np.int64), np.empty(sought.claimed.shape[0], np.bool_)
    four[0, 0] = four[0, 1] = 0.0
    quads = 0
    for i in pass_.by_height:
        size, previous = pass_.sizes[i], pass_.previous[i]
        if not free[i] or size <= previous or not _fill_wanted(spots.heights[i], sought, wanted):
            continue
        _lay_out(i, pass_.near, size, work)
        for a in range(size):
            j = lists[i, a]
            if not free[i]:
                break
            if not free[j]:
                continue
            four[1, 0], four[1, 1] = local[a, 0], local[a, 1]
            for b in range(a + 1, size):
                k = lists[i, b]
                if not (free[i] and free[j]):
                    break
                if not free[k] or _are_apart(local, a, b, reach):
                    continue
                four[2, 0], four[2, 1] = local[b, 0], local[b, 1]
                for c in range(max(b + 1, previous), size):
                    l = lists[i, c]  # noqa: E741
                    if not free[l] or _are_apart(local, a, c, reach) or _are_apart(local, b, c, reach):
                        continue
                    quads += 1
                    if quads > pass_.most:
                        return quads
                    four[3, 0], four[3, 1] = local[c, 0], local[c, 1]
                    found = look_up(work.looked_up, sought.quads, view, wanted)
                    if found == 0:
                        continue
                    members[0], members[1], members[2], members[3] = i, j, k, l
                    claimed = _try(members, spots, sought, limits, results, work, found)
                    if claimed and not (free[i] and free[j] and free[k]):
                        break
    return quads


@compiled
def _within_reach(spots, work, near, claims, extent):
    """How many of its neighbours may be of a spot's robot (n,), if LEDs are as large as those of the robots found.

    A spot tells by its size how far away its robot is, and so how far the others may be.
    """
    units, radii, sizes = work.directions.units, spots.radii, near.counts.copy()
    smallest = np.inf  # an LED's radius, m, times the focal length
    for k in range(claims.filled[0]):
        smallest = min(smallest, median_of(radii, claims.spots[k]) * distance(claims.ts[k]))
    for i in range(sizes.shape[0]):
        reach = REACH_MARGIN * extent * radii[i] / smallest if smallest < np.inf else np.inf
        while sizes[i] > 0 and apart2(units, i, near.lists[i, sizes[i] - 1]) > reach * reach:
            sizes[i] -= 1
    return sizes


@compiled
def search(spots, sought, limits, results):
    """Search the free spots for the robots.

    Arguments: `Spots`, `Sought`, `Limits` and `Results`, which are filled; the spots of claims are then no longer free.
    Returns the number of quads tried.
    """
    n = spots.flat.shape[0]
    by_height = ascending(-spots.heights)
    ranks = np.empty(n, np.int64)
    ranks[by_height] = np.arange(n)
    directions = directions_of(spots.rays)
    work = _Work(directions, room_to_look_up(), room_for_four(), np.empty((DEPTHS[-1], 2)), fit_room())
    near = nearest_neighbours(spots, directions, ranks, limits.reach, ALIKE, ALIKE_DEPTHS[-1])
    first = np.minimum(near.counts, ALIKE_DEPTHS[0])
    quads = _combine(spots, sought, limits, _Pass(by_height, near, np.zeros_like(first), first, n**3), results, work)
    more = _within_reach(spots, work, near, results.claims, limits.extent)
    quads += _combine(spots, sought, limits, _Pass(by_height, near, first, more, n**3), results, work)
    if sought.claimed.all():
        return quads  # rivals of robots that are found stand together, and were met already
    budget = quads + min(max(MOST_QUADS * n, FREE_QUADS), limits.unlike)
    near = nearest_neighbours(spots, directions, ranks, limits.reach, (HEIGHT_RATIO, RADIUS_RATIO), DEPTHS[-1])
    likely = _within_reach(spots, work, near, results.claims, limits.extent)
    tried = np.zeros_like(near.counts)
    for sizes in (likely, near.counts):
        for depth in DEPTHS:
            if quads < budget and not sought.claimed.all():
                now = np.minimum(sizes, depth)
                quads += _combine(
                    spots, sought, limits, _Pass(by_height, near, tried, now, budget - quads), results, work
                )
                tried = np.maximum(tried, now)
    return quads


def searched(
    spots: Spots, plan: Plan, claimed: NDArray[np.bool_], brightness: Floats, fewest: int, alone: bool = False,
    tolerance: float = SYSTEMATIC_PX, unlike: int = ANY,
) -> tuple[Fits, Fits]:  # fmt: skip
    """Claims and hypotheses of a search, cut to what there is."""
    sought = Sought(plan.layouts, plan.separations, claimed, brightness, plan.quads)
    near = max(plan.near, plan.smallest / (WIDEST * NEARER))
    limits = Limits(plan.focal, near, plan.far, MOST_TILT, plan.reach, plan.largest, fewest, alone, tolerance, unlike)
    results = Results(Fits.room(MOST_CLAIMS), Fits.room(MOST_PENDING))
    search(spots, sought, limits, results)
    return results.claims.held(), results.pending.held()
