"""How much likelier spots are as the LEDs of a robot than as chance: the score of a hypothesis."""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.fit import LEDS, fit_labelled, fit_room, median_of
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.sphere import distance

HIDDEN = math.log(10.0)  # what a hidden LED costs: one in ten is
# LEDs of one robot: one sigma of the logarithm; range of chance spots.
HEIGHT_SPREAD, LIKE_HEIGHTS = 0.3, 2.5 / 0.4
RADIUS_SPREAD, LIKE_RADII = 0.2, 4.0
LEAST_LIKE, MOST_LIKE = 0.4, 2.5  # times a robot's median height: the chance spots among which it stands
APART = 1.25  # times how far spots are from their middle: nobody like them is nearer
AROUND = 0.75  # of a constellation's extent: how far from its middle spots are around it


@compiled
def _alike(values, spots, spread, by_chance):
    """Evidence, in nats, that the ``values`` (n,) of a robot's ``spots`` (6,) are those of equal LEDs (log-normal), not
    spread evenly over the ratio ``by_chance``.
    """
    middle = median_of(values, spots)
    most = math.log(math.log(by_chance) / (spread * math.sqrt(2.0 * math.pi)))
    total, count = 0.0, 0
    for led in range(LEDS):
        if spots[led] >= 0:
            off = math.log(values[spots[led]] / middle) / spread
            # One odd LED may cost its robot only so much.
            total += max(most - 0.5 * off * off, -3.0)
            count += 1
    # One of them sets the level and says nothing.
    return total * (1.0 - 1.0 / count)


@compiled
def score(chi2, variances_px2, heights, radii_px, spots, around, area_px2, robots):
    """Logarithm of the odds that a fit is no chance, in nats.

    The robot's visible ``spots`` (6,; -1: hidden), with their ``variances_px2``, ``heights`` and ``radii_px`` (n,), fit
    with ``chi2``; ``around`` spots of like brightness lie in ``area_px2``; ``robots`` are still sought. Three spots are
    spent on the pose; every further one lands within its variance of its place by chance with probability 2 pi sigma^2
    times the density of spots. LEDs of one robot are alike, chance spots are not. The number of ways to try (robots,
    labels, triples of spots) counts against it.
    """
    seen = 0
    spread = 0.0
    for led in range(LEDS):
        if spots[led] >= 0:
            seen += 1
            spread += math.log(2.0 * math.pi * variances_px2[spots[led]])
    around = max(around, seen)
    gain = -spread / seen - math.log(around / area_px2)
    triples = around * (around - 1) * (around - 2) / 6.0
    tries = max(robots, 1) * 120.0 * triples
    alike = _alike(heights, spots, HEIGHT_SPREAD, LIKE_HEIGHTS) + _alike(radii_px, spots, RADIUS_SPREAD, LIKE_RADII)
    return (seen - 3) * gain - 0.5 * chi2 - (LEDS - seen) * HIDDEN - math.log(tries) + alike


@compiled
def surroundings(flat, heights, free, spots, height, extent_px):
    """How many free spots of like brightness lie around a robot's, and in what area, px^2.

    ``spots`` (6,) are the robot's, ``height`` their median, ``extent_px`` the constellation's in the image.
    """
    x = y = 0.0
    count = 0
    for led in range(LEDS):
        if spots[led] >= 0:
            x += flat[spots[led], 0]
            y += flat[spots[led], 1]
            count += 1
    x, y, radius = x / count, y / count, AROUND * extent_px
    like = 0
    for spot in range(flat.shape[0]):
        if (
            free[spot]
            and LEAST_LIKE * height < heights[spot] < MOST_LIKE * height
            and (flat[spot, 0] - x) ** 2 + (flat[spot, 1] - y) ** 2 < radius * radius
        ):
            like += 1
    return like, math.pi * radius * radius


@compiled
def is_alone(flat, free, heights, spots):
    """Whether no other free spot of like brightness lies among ``spots`` (6,; -1: hidden) or close to them."""
    x = y = height = reach2 = 0.0
    count = 0
    for led in range(LEDS):
        if spots[led] >= 0:
            x += flat[spots[led], 0]
            y += flat[spots[led], 1]
            height += heights[spots[led]]
            count += 1
    x, y, height = x / count, y / count, height / count
    for led in range(LEDS):
        if spots[led] >= 0:
            reach2 = max(reach2, (flat[spots[led], 0] - x) ** 2 + (flat[spots[led], 1] - y) ** 2)
    like = 0
    for spot in range(flat.shape[0]):
        if (
            free[spot]
            and (flat[spot, 0] - x) ** 2 + (flat[spot, 1] - y) ** 2 <= APART**2 * reach2
            and LEAST_LIKE * height < heights[spot] < MOST_LIKE * height
        ):
            like += 1
    return like <= count


class Version(NamedTuple):
    """Room for a version of a fit: its spots ``labels`` (6,), ``rotation`` (3, 3) and ``t`` (3,) of T_camera_plane."""

    labels: Any
    rotation: Any
    t: Any


@compiled
def version_of(layout, extent, labels, spots, focal, sigma_px, robots, version):
    """Score a fit as it is, with all the spots that it has: as `best_version`, which see."""
    room = fit_room()
    _, chi2, which = fit_labelled(layout, labels, spots.rays, spots.variances, (sigma_px / focal) ** 2, 5, room)
    if which < 0 or chi2 >= NO_SOLUTION:
        return -np.inf, 0.0
    variances_px2 = sigma_px**2 + spots.variances * focal**2
    height, extent_px = median_of(spots.heights, labels), extent * focal / distance(room.ts[which])
    around, area = surroundings(spots.flat, spots.heights, spots.free, labels, height, extent_px)
    version.labels[:] = labels
    version.rotation[:, :] = room.rotations[which]
    version.t[:] = room.ts[which]
    return score(chi2, variances_px2, spots.heights, spots.radii, labels, around, area, robots), height


@compiled
def best_version(layout, extent, labels, spots, focal, sigma_px, robots, version):
    """Score a fit, and what it is without each of its LEDs if it has six: one may be somebody else's light.

    ``layout`` (6, 3) m and its ``extent``, m; ``labels`` (6,) are its spots among ``spots`` (`neighbours.Spots`);
    ``sigma_px`` is what calibration and LED positions are off; ``robots`` are still sought. Fills the best `Version`
    and returns its score and median height; a score of -inf if there is no pose.
    """
    room, trial = fit_room(), np.empty(LEDS, np.int64)
    variances_px2 = sigma_px**2 + spots.variances * focal**2
    best, best_height = -np.inf, 0.0
    complete = True
    for led in range(LEDS):
        complete &= labels[led] >= 0
    for without in range(1 + LEDS if complete else 1):
        trial[:] = labels
        if without > 0:
            trial[without - 1] = -1
        _, chi2, which = fit_labelled(layout, trial, spots.rays, spots.variances, (sigma_px / focal) ** 2, 5, room)
        if which < 0 or chi2 >= NO_SOLUTION:
            continue
        height, extent_px = median_of(spots.heights, trial), extent * focal / distance(room.ts[which])
        around, area = surroundings(spots.flat, spots.heights, spots.free, trial, height, extent_px)
        value = score(chi2, variances_px2, spots.heights, spots.radii, trial, around, area, robots)
        if value > best:
            best, best_height = value, height
            version.labels[:] = trial
            version.rotation[:, :] = room.rotations[which]
            version.t[:] = room.ts[which]
    return best, best_height
