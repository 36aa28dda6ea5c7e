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
from numpy.typing import NDArray
from scipy.special import chndtr

from asterism.protocol.geometry import Floats
from asterism.server.doctor.cuts import Cut

SHARP_PX = 0.75  # sigma of the blur, pixels included, of a focused lens on a pixel matched to it
STEPS, HALVINGS, STEP, SHORT = 10, 6, 1e-3, 2e-3  # of the logarithms
NODES = 224  # distances at which profiles are computed
START_BLURS = (0.6, 0.9, 2.5)  # px; the middle one with the radius that is expected, the others with what is seen
BOUNDS = (0.3, 12.0)  # px, of the blur
LEAST_PIXELS = 20  # of a spot
CEILING = 250.0  # grey levels: from there on a pixel tells no more
RADIUS_SIGMA = 0.4  # of the logarithm of the radius that is expected, one sigma
GAIN = 0.035  # variance a grey level of light, see centres.centre


class Blur(NamedTuple):
    """``blur_px`` sigma, pixels included; ``radius_m`` of the LEDs' light, ``radius_px`` as it is seen in the mean."""

    blur_px: float
    radius_m: float
    radius_px: float


class _Pixels(NamedTuple):
    """All pixels of k cuts, cut after cut: ``values``, square roots of their ``weights`` and which cut they are ``of``
    (n,), between which two of the ``nodes`` (NODES,) px they lie, ``lower`` (n,), and how far on, ``part`` (n,); the
    ``scale`` px per m of the cuts and where they ``begin`` (k,).
    """

    values: Floats
    weights: Floats
    of: NDArray[np.int64]
    nodes: Floats
    lower: NDArray[np.int64]
    part: Floats
    scale: Floats
    begin: NDArray[np.int64]


def fit_blur(cuts: Sequence[Cut], radius_m: float | None) -> Blur | None:
    """Blur and radius common to the cuts; ``radius_m`` is what is expected. None where no pixel tells."""
    usable = [cut for cut in cuts if np.count_nonzero(cut.values < CEILING) > LEAST_PIXELS]
    if not usable:
        return None
    seen = float(np.median([_half_height_px(cut) / cut.px_per_m for cut in usable]))
    pixels, expected = _laid_out(usable), math.log(radius_m or seen)
    starts = np.log(np.column_stack([[seen, math.exp(expected), seen], START_BLURS]))
    # Saturated spots have more than one minimum.
    _, p = min((_descend(pixels, start, expected) for start in starts), key=lambda end: end[0])
    radius, blur = np.exp(p)
    scale = float(np.mean([cut.px_per_m for cut in usable]))
    return Blur(float(blur), float(radius), float(radius * scale))


def _laid_out(cuts: Sequence[Cut]) -> _Pixels:
    lengths = np.array([len(cut.values) for cut in cuts])
    values = np.concatenate([cut.values for cut in cuts])
    light = np.concatenate([cut.values - cut.values.min() for cut in cuts])
    noise = np.repeat([cut.noise**2 + 0.1 for cut in cuts], lengths)
    weights = np.where(values < CEILING, 1.0 / np.sqrt(noise + GAIN * light), 0.0)
    distances = np.concatenate([cut.distances for cut in cuts])
    nodes = np.linspace(0.0, float(distances.max()) + 1e-6, NODES)
    place = distances / nodes[1]
    lower = np.minimum(place.astype(np.int64), NODES - 2)
    begin = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    of, scale = np.repeat(np.arange(len(cuts)), lengths), np.array([cut.px_per_m for cut in cuts])
    return _Pixels(values, weights, of, nodes, lower, place - lower, scale, begin)


def _half_height_px(cut: Cut) -> float:
    """Radius of the circle as large as the spot's part above half its height; pixels have an area of 1."""
    low, high = np.quantile(cut.values, 0.2), cut.values.max()
    return max(math.sqrt(np.count_nonzero(cut.values > 0.5 * (low + high)) / math.pi), 0.4)


def _descend(pixels: _Pixels, p: Floats, expected: float) -> tuple[float, Floats]:
    """Gauss-Newton on the logarithms of radius and blur."""
    rest = _residuals(pixels, p, expected)
    for _ in range(STEPS):
        by = np.column_stack([(_residuals(pixels, p + STEP * axis, expected) - rest) / STEP for axis in np.eye(2)])
        move = np.clip(np.linalg.solve(by.T @ by + 1e-9 * np.eye(2), -by.T @ rest), -0.7, 0.7)
        for _ in range(HALVINGS):
            trial = np.array([p[0] + move[0], np.clip(p[1] + move[1], *np.log(BOUNDS))])
            after = _residuals(pixels, trial, expected)
            if after @ after <= rest @ rest:
                break
            move = 0.4 * move
        else:
            break
        done = np.abs(trial - p).max() < SHORT
        p, rest = trial, after
        if done:
            break
    return float(rest @ rest), p


def _residuals(pixels: _Pixels, p: Floats, expected: float) -> Floats:
    """Over their sigmas, of all pixels with every cut's own background and height, and of the expected radius."""
    radius_m, blur = np.exp(p)
    w, told = pixels.weights, pixels.weights * pixels.values
    # At so few distances that it costs little; between them it is straight enough.
    profiles = profile_at(pixels.nodes, radius_m * pixels.scale[:, None], blur)
    below, above = (profiles[pixels.of, pixels.lower + k] for k in (0, 1))
    lit = w * (below + pixels.part * (above - below))
    ww, wl, ll, wt, lt = (
        np.add.reduceat(part, pixels.begin) for part in (w * w, w * lit, lit * lit, w * told, lit * told)
    )
    det = np.maximum(ww * ll - wl * wl, 1e-12)
    base, rise = (ll * wt - wl * lt) / det, (ww * lt - wl * wt) / det
    rest = told - base[pixels.of] * w - rise[pixels.of] * lit
    return np.append(rest, (p[0] - expected) / RADIUS_SIGMA)


def profile_at(distances: Floats, radius_px: float | Floats, blur_px: float) -> Floats:
    """Share of a disc's brightness at distances (n,) px from its centre; a row for each of many radii (k, 1)."""
    return np.asarray(chndtr((radius_px / blur_px) ** 2, 2.0, (distances / blur_px) ** 2), np.float64)


def centre_cost(radius_px: float, blur_px: float) -> float:
    """How many times less sure a centre is than under a sharp lens, by the Cramér-Rao bound of an even noise."""
    return math.sqrt(_information(radius_px, SHARP_PX) / max(_information(radius_px, blur_px), 1e-12))


def _information(radius_px: float, blur_px: float) -> float:
    r = np.linspace(1e-3, radius_px + 6.0 * blur_px, 1500)
    slope = np.gradient(profile_at(r, radius_px, blur_px), r)
    return float(np.trapezoid(slope * slope * r, r))
