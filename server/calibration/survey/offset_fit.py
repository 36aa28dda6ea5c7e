"""The shift of LEDs' light by angle and distance, as a Gaussian process, fitted to centres seen at surveyed poses.

The shift at the knots of the led.yaml, and what it changes by in a metre, are Gaussian with a covariance that falls
with the distance between angles (Matern 5/2) and is even in them: smooth as far as the centres say, up to as many turns
as a reflector cup makes. How far, how much, how the centres scatter beyond their noise, how far off the survey is and
what all LEDs of a sighting have in common beyond that are found together, by the likelihood of all centres (Rasmussen
and Williams, "Gaussian processes for machine learning", 2006, ch. 2 and 5). Everything is linear but for a trifle, so
that each likelihood costs the inverse of one 12 by 12 matrix a sighting and of one as large as the knots.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import MOST_DOUBTS, MOST_KNOTS, LedOffset, knot_weights
from asterism.server.calibration.survey.surveyed_fit import NUMBERS, Table, by_pose
from asterism.server.pose.fit import LEDS
from asterism.server.pose.spot_shift import AXIS, KNOTS, LIMIT, SHIFT

KNOT_DEG = 3.0
STEP_M = 1e-5
CONSTANT_M = 0.02  # one sigma of a shift that does not depend on the angle: as good as none
# Where the search begins, and how far from there it may be (one sigma of the logarithm).
LOOSE = 2.0
LEAST = 1e-7


class Spread(NamedTuple):
    """One sigma each: of the shift ``by_angle``, m, whose parts ``width`` rad apart hardly depend on one another; of
    what it changes by in a metre, ``by_distance``, m; of the centres beyond their noise, ``scatter`` px; of the survey,
    ``survey_m`` and ``survey_rad``; of a shift along the axis that a sighting's LEDs ``share``, m.
    """

    by_angle: float
    width: float
    by_distance: float
    scatter: float
    survey_m: float
    survey_rad: float
    share: float


START = Spread(5e-4, 0.25, 1e-4, 0.02, 3e-5, 3e-4, 2e-5)


class Linear(NamedTuple):
    """n sightings, linear about an offset: ``residuals`` (n, 12) px against the plain rig, derivatives by the values
    and their changes in a metre ``by_values`` (n, 12, 2 k), by the surveyed pose ``by_pose`` (n, 12, 6), by a common
    shift ``by_shift`` (n, 12), and the centres' ``noise`` (n, 12, 12) px^2.
    """

    residuals: Floats
    by_values: Floats
    by_pose: Floats
    by_shift: Floats
    noise: Floats

    def rows(self, rows: NDArray[np.bool_]) -> "Linear":
        """Some of the sightings."""
        return Linear(*(each[rows] for each in self))


class Found(NamedTuple):
    """Values and their changes in a metre (2 k,), and their covariance (2 k, 2 k), m."""

    values: Floats
    covariance: Floats


def knots_for(up_to: float) -> int:
    """How many values a shift up to that angle, rad, has."""
    return int(min(max(np.ceil(np.degrees(up_to) / KNOT_DEG) + 1, 4), MOST_KNOTS))


def linear_about(offset: LedOffset, table: Table, camera: Camera, axes: Floats) -> Linear:
    """The sightings of a ``table`` without any offset, linear about one; ``axes`` (n, 3) of the LEDs in the planes."""
    optics = table.optics.copy()
    optics[:, AXIS : AXIS + 3] = axes
    points = table.layouts @ np.swapaxes(table.rotations, 1, 2) + table.ts[:, None]
    away = np.linalg.norm(points, axis=2)
    facing = np.einsum("nli,nij,nj->nl", points, table.rotations, axes) / away
    angles = np.arcsin(np.sqrt(np.clip(1.0 - facing**2, 0.0, 1.0)))
    weights = knot_weights(angles, offset.up_to_rad, len(offset.values))  # (n, 6, k)
    weights = np.concatenate([weights, (away - offset.distance_m)[..., None] * weights], axis=2)
    values = np.concatenate([offset.values, offset.per_metre])
    # One value, an LED at a time being looked at: the shift that this LED has.
    optics[:, KNOTS], optics[:, LIMIT] = 1.0, 1.0
    predicted, ahead = np.empty((2, len(table), NUMBERS))
    for led in range(LEDS):
        pair = slice(2 * led, 2 * led + 2)
        for spots, step in ((predicted, 0.0), (ahead, STEP_M)):
            optics[:, SHIFT] = weights[:, led] @ values + step
            spots[:, pair] = table.spots(camera, table.layouts, optics, table.rotations, table.ts)[:, pair]
    by_shift = (ahead - predicted) / STEP_M
    by_values = by_shift[:, :, None] * np.repeat(weights, 2, axis=1)
    residuals = table.centres.reshape(len(table), NUMBERS) - predicted + by_values @ values
    jacobian = by_pose(table, camera, table.layouts, optics, table.rotations, table.ts)
    return Linear(residuals, by_values, jacobian, by_shift, table.noise)


def most_likely(linear: Linear, up_to: float, start: Spread = START) -> Spread:
    """The spread that makes the centres most likely."""

    def cost(logs: Floats) -> float:
        return -2.0 * _evidence(linear, up_to, Spread(*np.exp(logs).tolist())) + float(
            (((logs - np.log(START)) / LOOSE) ** 2).sum()
        )

    found = minimize(
        cost, np.log(start), method="Nelder-Mead",
        options={"xatol": 0.03, "fatol": 0.05, "maxfev": 900, "adaptive": True},
    )  # fmt: skip
    return Spread(*np.maximum(np.exp(found.x), LEAST).tolist())


def posterior(linear: Linear, up_to: float, spread: Spread) -> Found:
    """What the sightings say of the values."""
    prior = _prior(linear, up_to, spread)
    inverse, _ = _inverses(linear, spread)
    weighted = np.swapaxes(linear.by_values, 1, 2) @ inverse
    information = np.tensordot(weighted, linear.by_values, ([0, 2], [0, 1]))
    right = np.tensordot(weighted, linear.residuals, ([0, 2], [0, 1]))
    covariance = np.linalg.solve(np.eye(len(prior)) + prior @ information, prior)
    return Found(covariance @ right, 0.5 * (covariance + covariance.T))


def chi2_with(linear: Linear, values: Floats, spread: Spread) -> Floats:
    """Squared residuals (n,) of sightings with an offset of these values, in units of their covariance."""
    inverse, _ = _inverses(linear, spread)
    left = linear.residuals - linear.by_values @ values
    squared: Floats = np.einsum("ni,nij,nj->n", left, inverse, left)
    return squared


def doubts_of(found: Found, spread: Spread) -> Floats:
    """Functions (d, k) m that the shift may be wrong by: the sighting's own, and the largest of what its fit leaves."""
    knots = len(found.values) // 2
    sizes, functions = np.linalg.eigh(found.covariance[:knots, :knots])
    rows = np.argsort(-sizes)[: MOST_DOUBTS - 1]
    own = np.full((1, knots), spread.share)
    doubts: Floats = np.vstack([own, np.sqrt(np.maximum(sizes[rows], 0.0))[:, None] * functions[:, rows].T])
    return doubts


def _prior(linear: Linear, up_to: float, spread: Spread) -> Floats:
    knots = linear.by_values.shape[2] // 2
    angles = np.linspace(0.0, up_to, knots)
    apart = [np.sqrt(5.0) * np.abs(angles[:, None] + sign * angles) / spread.width for sign in (-1.0, 1.0)]
    even = sum((1.0 + r + r**2 / 3.0) * np.exp(-r) for r in apart)
    prior = np.zeros((2 * knots, 2 * knots))
    prior[:knots, :knots] = CONSTANT_M**2 + spread.by_angle**2 * even
    # A change with the distance that is the same at all angles is the likeliest one.
    prior[knots:, knots:] = spread.by_distance**2 * (1.0 + even)
    return prior


def _inverses(linear: Linear, spread: Spread) -> tuple[Floats, Floats]:
    """Inverses (n, 12, 12) and determinants' logarithms (n,) of all that is not the offset."""
    survey = np.repeat([spread.survey_m**2, spread.survey_rad**2], 3)
    covariances = (
        linear.noise
        + spread.scatter**2 * np.eye(NUMBERS)
        + (linear.by_pose * survey) @ np.swapaxes(linear.by_pose, 1, 2)
        + spread.share**2 * linear.by_shift[:, :, None] * linear.by_shift[:, None, :]
    )
    return np.linalg.inv(covariances), np.linalg.slogdet(covariances)[1]


def _evidence(linear: Linear, up_to: float, spread: Spread) -> float:
    """Logarithm of how likely all centres are, but for a constant."""
    prior = _prior(linear, up_to, spread)
    inverse, determinants = _inverses(linear, spread)
    weighted = np.swapaxes(linear.by_values, 1, 2) @ inverse
    information = np.tensordot(weighted, linear.by_values, ([0, 2], [0, 1]))
    right = np.tensordot(weighted, linear.residuals, ([0, 2], [0, 1]))
    squared = float(np.einsum("ni,nij,nj->", linear.residuals, inverse, linear.residuals))
    wider = np.eye(len(prior)) + prior @ information
    squared -= float(right @ np.linalg.solve(wider, prior @ right))
    return -0.5 * (squared + float(determinants.sum()) + float(np.linalg.slogdet(wider)[1]))
