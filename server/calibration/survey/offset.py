"""An LED's angular offset from robots seen at surveyed poses: refraction by theory, the rest fitted.

What theory leaves (reflections inside the LED, all of it where nothing is known of the cover) is a polynomial in sin^2
of the angle: smooth, even, the same all around the axis. Its degree is the least that predicts held-out poses as well
as the best does, within one standard error (Hastie, Tibshirani, Friedman, "The elements of statistical learning",
7.10), so that noise does not become function.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import MOST_TERMS, LedOffset
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.survey.surveyed import Pairs
from asterism.server.calibration.survey.surveyed_fit import (
    Model,
    SurveyedFit,
    Table,
    by_pose,
    chi2_of,
    errors_of,
    fit,
    table_of,
)
from asterism.server.pose.led_optics import dome_depth, window_depth
from asterism.server.pose.spot_shift import LIMIT, SHIFT

FEWEST_POSES = 12
BAND_DEG = 15.0
BANDS = 3  # that must be there: up to 45 degrees
FEWEST_IN_BAND = 3
MOST_FITTED = 5  # coefficients: up to sin^8
PRIOR_M = 0.02  # one sigma of a coefficient: as good as none
FOLDS = 5
STEP_M = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class OffsetCalibration:
    """The whole offset; ``theory`` and ``fitted`` are its two parts as coefficients, m; ``scores`` are squared sigmas
    a number of held-out poses for 0, 1, 2, ... fitted coefficients; ``constant_sigma`` m, of the constant part.

    ``angles`` (n,) rad, at which the robots were seen; ``before`` and ``after``: errors (n, 3) m and (n,) rad of
    poses, the latter held out, by the rig as it is and with the offset; ``fit`` tells which of the n were used.
    ``helps``: whether poses that it was not fitted to gain, so that it is worth having.
    """

    offset: LedOffset
    theory: Floats
    fitted: Floats
    scores: Floats
    constant_sigma: float
    angles: Floats
    before: tuple[Floats, Floats]
    after: tuple[Floats, Floats]
    fit: SurveyedFit
    helps: bool


def calibrate_offset(
    rig: Rig, pairs: Pairs, film: str, dome: tuple[float, ...] | None, window: tuple[float, ...] | None
) -> OffsetCalibration:
    """Fit the offset that all LEDs in ``pairs`` share; ``film`` is what sentences call them.

    Raises InputError where the angles that are needed were not seen.
    """
    plain = replace(rig, robots=tuple(replace(robot, led_offset=None) for robot in rig.robots))
    angles, largest = _angles(pairs, rig)
    check_angles(film, angles)
    table = table_of(pairs, plain)
    theory = _theory(largest, dome, window)
    full = fit(_model(plain, theory, largest), table, np.full(MOST_FITTED, PRIOR_M))
    folds = np.arange(len(table)) % FOLDS
    terms, scores = _terms(plain, table[full.used], folds[full.used], theory, largest, full.sigmas)
    model, priors = _model(plain, theory, largest), np.full(terms, PRIOR_M)
    final = fit(model, table[full.used], priors, full.sigmas) if terms else None
    fitted = np.zeros(0) if final is None else final.parameters
    offset = LedOffset(_sum(theory, fitted), largest)
    # Of the fullest fit: a smaller one knows its constant better only if its shape is the right one.
    sigma = math.sqrt(full.covariance[0, 0])
    before = errors_of(pairs, rig, solve_sightings(rig, [s for s, _ in pairs]))
    after = _held_out(plain, pairs, table, folds, theory, largest, terms, full)
    rms = [float(np.sqrt(np.nanmean(away[full.used] ** 2))) for away, _ in (before, after)]
    helps = rms[1] < rms[0] and _helps(rig, pairs, full, scores[1][terms])
    return OffsetCalibration(offset, theory, fitted, scores[0], sigma, angles, before, after, full, helps)


def _helps(rig: Rig, pairs: Pairs, full: SurveyedFit, held_out: Floats) -> bool:
    """Whether the squared residuals (n,) of poses that the offset was not fitted to are less than by the rig as it is,
    by more than one standard error.
    """
    table = table_of(pairs, rig)[full.used]
    here = table.layouts, table.optics, table.rotations, table.ts
    residuals = table.centres.reshape(len(table), -1) - table.spots(rig.camera, *here)
    gain = chi2_of(table, residuals, by_pose(table, rig.camera, *here), full.sigmas) - held_out
    return float(gain.sum()) > float(gain.std()) * math.sqrt(len(gain))


def check_angles(film: str, angles: Floats) -> None:
    """Raise InputError with the angles that are missing; ``angles`` (n,) rad between LED axis and line of sight."""
    degrees = np.degrees(angles)
    missing = []
    for band in range(BANDS):
        low, high = band * BAND_DEG, (band + 1) * BAND_DEG
        if ((degrees >= low) & (degrees < high)).sum() < FEWEST_IN_BAND:
            missing.append(f"{low:g} to {high:g}")
    if missing:
        raise InputError(
            f"{film}: the robots are seen at {degrees.min():.0f} to {degrees.max():.0f} degrees between LED axis and "
            f"line of sight; angles of {', '.join(missing)} degrees are missing, expected {FEWEST_IN_BAND} poses in "
            "each at least; tilt the robots"
        )


def with_offset(rig: Rig, offset: LedOffset) -> Rig:
    """The rig with the offset in all its LEDs."""
    return replace(rig, robots=tuple(replace(robot, led_offset=offset) for robot in rig.robots))


def _angles(pairs: Pairs, rig: Rig) -> tuple[Floats, float]:
    """Angles (n,) rad between LED axis and line of sight at the robots' middles, and the largest at any LED; by where
    robots were located, since of a survey single poses may be wrong.
    """
    middles, largest = [], 0.0
    for sighting, _ in pairs:
        robot = rig.robot(sighting.robot)
        points = sighting.pose.map(np.vstack([robot.leds.mean(axis=0), robot.leds]))
        facing = -(points @ (sighting.pose.rotation @ robot.axis)) / np.linalg.norm(points, axis=1)
        angles = np.arccos(np.clip(facing, 0.0, 1.0))
        middles.append(angles[0])
        largest = max(largest, float(angles.max()))
    return np.array(middles), largest


def _theory(largest: float, dome: tuple[float, ...] | None, window: tuple[float, ...] | None) -> Floats:
    """Coefficients of the refraction's axial shift up to the largest angle: least squares on a fine table."""
    if dome is None and window is None:
        return np.zeros(0)
    # Chebyshev's places, so that the error is small everywhere.
    sin2 = 0.5 * math.sin(largest) ** 2 * (1.0 - np.cos(np.pi * (np.arange(200) + 0.5) / 200))
    alpha = np.arcsin(np.sqrt(sin2))
    if dome is not None:
        index, radius, below = dome
        depth = dome_depth(index, radius, below, alpha)
    else:
        index, below = window or ()
        depth = window_depth(index, below, alpha)
    fitted = np.polynomial.Polynomial.fit(sin2, -depth, MOST_TERMS - 1).convert()
    return np.asarray(fitted.coef, np.float64)


def _sum(theory: Floats, fitted: Floats) -> Floats:
    total = np.zeros(max(len(theory), len(fitted), 1))
    total[: len(theory)] += theory
    total[: len(fitted)] += fitted
    return total


def _model(rig: Rig, theory: Floats, largest: float) -> Model:
    """Spots for fitted coefficients (p,) on top of the theory's."""
    axes = np.array([robot.T_robot_plane.rotation.T @ robot.axis for robot in rig.robots])

    def model(parameters: Floats, table: Table) -> tuple[Floats, Floats, Floats]:
        optics = table.optics.copy()
        optics[:, 1:4] = axes[table.robots]
        optics[:, LIMIT] = math.sin(largest) ** 2
        total = _sum(theory, parameters)
        optics[:, SHIFT : SHIFT + len(total)] = total
        rest = table.layouts, optics, table.rotations, table.ts
        predicted = table.spots(rig.camera, *rest)
        derivatives = np.empty((len(table), predicted.shape[1], len(parameters)))
        for k in range(len(parameters)):
            more = optics.copy()
            more[:, SHIFT + k] += STEP_M
            derivatives[:, :, k] = (
                table.spots(rig.camera, table.layouts, more, table.rotations, table.ts) - predicted
            ) / STEP_M
        return predicted, derivatives, by_pose(table, rig.camera, *rest)

    return model


def _terms(
    rig: Rig, table: Table, folds: NDArray[np.int64], theory: Floats, largest: float, sigmas: Floats
) -> tuple[int, tuple[Floats, Floats]]:
    """How many coefficients to fit, and of 0, 1, 2, ... the scores and every held-out pose's squared residuals
    (MOST_FITTED + 1, n).
    """
    model = _model(rig, theory, largest)
    squared = np.zeros((MOST_FITTED + 1, len(table)))
    for terms in range(MOST_FITTED + 1):
        for fold in range(FOLDS):
            out = folds == fold
            parameters = fit(model, table[~out], np.full(terms, PRIOR_M), sigmas).parameters if terms else np.zeros(0)
            predicted, _, jacobian = model(parameters, table[out])
            residuals = table[out].centres.reshape(len(predicted), -1) - predicted
            squared[terms, out] = chi2_of(table[out], residuals, jacobian, sigmas)
    totals = squared.sum(axis=1)
    best = int(np.argmin(totals))
    for terms in range(best + 1):
        worse = squared[terms] - squared[best]
        if worse.sum() <= worse.std() * math.sqrt(len(worse)):
            best = terms
            break
    return best, (totals / (2.0 * table.seen.sum()), squared)


def _held_out(
    rig: Rig, pairs: Pairs, table: Table, folds: NDArray[np.int64], theory: Floats, largest: float, terms: int,
    full: SurveyedFit,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Errors of every pose with the offset fitted to the others."""
    away, turned = np.full((len(pairs), 3), np.nan), np.full(len(pairs), np.nan)
    model = _model(rig, theory, largest)
    for fold in range(FOLDS):
        out = folds == fold
        fitted = np.zeros(0)
        if terms:
            fitted = fit(model, table[~out & full.used], np.full(terms, PRIOR_M), full.sigmas).parameters
        tried = with_offset(rig, LedOffset(_sum(theory, fitted), largest))
        rows = np.flatnonzero(out)
        here = [pairs[k] for k in rows]
        away[rows], turned[rows] = errors_of(here, rig, solve_sightings(tried, [s for s, _ in here]))
    return away, turned
