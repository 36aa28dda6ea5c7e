"""The lens's blur and the LEDs' size, from the pixels of many spots together.

A disc of radius a under a Gaussian blur of sigma s has at distance r from its middle the share of its light that a
Gaussian about that point has within the disc: the non-central chi squared distribution of two degrees of freedom,
P(a^2 / s^2; r^2 / s^2) (the complement of Marcum's Q). Each spot has its own background and height, which are linear;
the blur, pixels included, and the radius are common to the spots of a robot: two numbers, found by Gauss-Newton.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chndtr

from asterism.protocol.geometry import Floats
from asterism.server.doctor.cuts import Cut

SHARP_PX = 0.75  # sigma of the blur, pixels included, of a focused lens on a pixel matched to it
STEPS = 10
START_BLURS = (0.8, 1.6, 3.2)  # px
BOUNDS = (0.3, 12.0)  # px, of the blur
CEILING = 250.0  # grey levels: from there on a pixel tells no more
RADIUS_SIGMA = 0.4  # of the logarithm of the radius that is expected, one sigma
GAIN = 0.035  # variance a grey level of light, see centres.centre


class Blur(NamedTuple):
    """``blur_px`` sigma, pixels included; ``radius_m`` of the LEDs' light, ``radius_px`` as it is seen in the mean;
    ``chi2`` per pixel.
    """

    blur_px: float
    radius_m: float
    radius_px: float
    chi2: float


def fit_blur(cuts: Sequence[Cut], radius_m: float | None) -> Blur | None:
    """Blur and radius common to the cuts; ``radius_m`` is what is expected. None where no pixel tells."""
    expected = radius_m or float(np.median([_half_height_px(cut) / cut.px_per_m for cut in cuts] or [0.0]))
    usable = [cut for cut in cuts if np.count_nonzero(cut.values < CEILING) > 20]
    if not usable or not expected > 0.0:
        return None
    best: tuple[float, Floats] | None = None
    for start in START_BLURS:
        cost, p = _descend(usable, np.log([expected, start]), math.log(expected))
        if best is None or cost < best[0]:
            best = cost, p
    assert best is not None
    radius, blur = np.exp(best[1])
    scale = float(np.mean([cut.px_per_m for cut in usable]))
    return Blur(float(blur), float(radius), float(radius * scale), best[0] / sum(len(cut.values) for cut in usable))


def _half_height_px(cut: Cut) -> float:
    """Radius of the circle as large as the spot's part above half its height."""
    low, high = np.quantile(cut.values, 0.2), cut.values.max()
    reach = math.pi * float(cut.distances.max()) ** 2 / 2.0
    share = float(np.mean(cut.values > 0.5 * (low + high)))
    return max(math.sqrt(share * reach / math.pi), 0.3)


def _descend(cuts: Sequence[Cut], p: Floats, expected: float) -> tuple[float, Floats]:
    """Gauss-Newton on the logarithms of radius and blur."""
    cost, rest = _residuals(cuts, p, expected)
    for _ in range(STEPS):
        step = 1e-3
        by = np.column_stack([(_residuals(cuts, p + step * np.eye(2)[k], expected)[1] - rest) / step for k in (0, 1)])
        move = np.clip(np.linalg.lstsq(by, -rest, rcond=None)[0], -0.7, 0.7)
        while True:
            trial = p + move
            trial[1] = np.clip(trial[1], *np.log(BOUNDS))
            trial_cost, trial_rest = _residuals(cuts, trial, expected)
            if trial_cost <= cost or np.abs(move).max() < 1e-3:
                break
            move = 0.4 * move
        if trial_cost > cost:
            break
        done = np.abs(trial - p).max() < 2e-3
        p, cost, rest = trial, trial_cost, trial_rest
        if done:
            break
    return cost, p


def _residuals(cuts: Sequence[Cut], p: Floats, expected: float) -> tuple[float, Floats]:
    """Squared residuals and the residuals, over their sigmas, of all pixels and of what is expected of the radius."""
    radius_m, blur = np.exp(p)
    rest = []
    for cut in cuts:
        a = radius_m * cut.px_per_m
        profile = profile_at(cut.distances, a, blur)
        known = cut.values < CEILING
        weights = known / np.sqrt(cut.noise**2 + 0.1 + GAIN * np.maximum(cut.values - cut.values.min(), 0.0))
        columns = np.column_stack([np.ones_like(profile), profile]) * weights[:, None]
        told = weights * cut.values
        rest.append(told - columns @ np.linalg.lstsq(columns, told, rcond=None)[0])
    rest.append(np.array([(p[0] - expected) / RADIUS_SIGMA]))
    whole = np.concatenate(rest)
    return float(whole @ whole), whole


def profile_at(distances: Floats, radius_px: float, blur_px: float) -> Floats:
    """Share (n,) of a disc's brightness at distances (n,) px from its centre."""
    profile: Floats = chndtr((radius_px / blur_px) ** 2, 2.0, (distances / blur_px) ** 2)
    return profile


def centre_cost(radius_px: float, blur_px: float) -> float:
    """How many times less sure a centre is than under a sharp lens, by the Cramér-Rao bound of an even noise."""
    return math.sqrt(_information(radius_px, SHARP_PX) / max(_information(radius_px, blur_px), 1e-12))


def _information(radius_px: float, blur_px: float) -> float:
    r = np.linspace(1e-3, radius_px + 6.0 * blur_px, 1500)
    slope = np.gradient(profile_at(r, radius_px, blur_px), r)
    return float(np.trapezoid(slope * slope * r, r))
