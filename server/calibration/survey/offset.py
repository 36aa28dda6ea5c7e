"""An LED's offset from robots seen at surveyed poses: by the angle, and by the distance where poses gain by it.

What an estimator of centres makes of an LED with chip and cup follows no formula: its parts come into view and go one
after the other. So the offset is as smooth a function as the centres allow (`offset_fit`), with what they leave open.
Refraction by theory (Snell's law for a dome or a window) is not asked for: docs/calibration.md says why.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import LARGEST_SCATTER_PX, LedOffset
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.survey.offset_fit import (
    START,
    Found,
    Linear,
    Spread,
    chi2_with,
    doubts_of,
    knots_for,
    linear_about,
    most_likely,
    posterior,
)
from asterism.server.calibration.survey.surveyed import Pairs
from asterism.server.calibration.survey.surveyed_fit import Table, errors_of, table_of, weighted_errors
from asterism.server.pose.fit import LEDS

FEWEST_POSES = 12
BAND_DEG = 15.0
BANDS = 3  # that must be there: up to 45 degrees
FEWEST_IN_BAND = 3
FOLDS = 5
NARROW = 1.15  # farthest over nearest distance below which what changes with it cannot be told
FAR_OFF = 9.0  # times chi squared per number: the survey or the sighting is wrong
MOST_LEFT_OUT = 0.5
ROUNDS = 3
# Scatter beyond what the fit says, px, tried until the errors of poses held out are no larger than their covariances,
# by one standard error, since few poses may be lucky.
MORE_SCATTER_PX = (0.0, 0.003, 0.005, 0.007, 0.01, 0.014, 0.02, 0.028, 0.04, 0.056, 0.08, 0.11, 0.15)
POSE = 6  # numbers
BEYOND = math.radians(12.0)  # the largest angle seen: up to there the file says how little it knows
STRANGE_SHARE = 0.98  # of the LEDs' spots, whose strange light is counted as their own
# LEDs of whose light nothing is known: what is strange in it is no other light beside it.
UNKNOWN = LedOffset(np.zeros(1), math.pi / 2, np.zeros(1), 1.0, np.zeros((0, 1)), 0.15, LARGEST_SCATTER_PX, True)


@dataclass(frozen=True, slots=True, eq=False)
class OffsetCalibration:
    """``spread``: how far everything is off; ``sigmas`` (k,) m of the offset's values; ``used`` (n,) which sightings it
    rests on, the others being far off what they say.

    ``angles`` (n,) rad and ``distances`` (n,) m at which the robots were seen, single LEDs up to ``seen_up_to`` rad;
    ``before`` and ``after``: errors (n, 3) m and (n,) rad of poses, the latter held out, by the rig as it is and with
    the offset; ``weighted`` (n,): squared errors of the latter by their covariances. ``helps``: whether poses that it
    was not fitted to gain, so that it is worth having. ``told_distance``: whether the distances differ enough to tell
    what changes with them.
    """

    offset: LedOffset
    spread: Spread
    sigmas: Floats
    used: NDArray[np.bool_]
    angles: Floats
    distances: Floats
    seen_up_to: float
    before: tuple[Floats, Floats]
    after: tuple[Floats, Floats]
    weighted: Floats
    helps: bool
    told_distance: bool


class _Survey:
    """Pairs as they are fitted: by a rig without offset."""

    def __init__(self, rig: Rig, pairs: Pairs, largest: float, distance: float, told_distance: bool) -> None:
        self.pairs, self.distance, self.told_distance = pairs, distance, told_distance
        self.up_to = min(largest + BEYOND, math.pi / 2)
        self.rig = replace(rig, robots=tuple(replace(robot, led_offset=None) for robot in rig.robots))
        table = table_of(pairs, self.rig)
        axes = np.array([robot.T_robot_plane.rotation.T @ robot.axis for robot in rig.robots])
        self.axes = axes[table.robots]
        self.strange = np.array([s.centres.strange_px for s, _ in pairs])
        self.table = _plain(table, self.strange)

    def nothing(self) -> LedOffset:
        """The offset that a fit begins with."""
        return LedOffset.table(np.zeros(knots_for(self.up_to)), self.up_to)

    def linear(self, offset: LedOffset) -> Linear:
        """All pairs, linear about an offset."""
        offset = replace(offset, distance_m=self.distance)
        linear = linear_about(offset, self.table, self.rig.camera, self.axes)
        if not self.told_distance:
            linear.by_values[:, :, len(offset.values) :] = 0.0
        return linear

    def offset(self, found: Found, spread: Spread, used: NDArray[np.bool_]) -> LedOffset:
        """The offset of what was found."""
        knots = len(found.values) // 2
        seen = (self.table.noise[:, range(2 * LEDS), range(2 * LEDS)][:, ::2] < 1e6) & used[:, None]
        strange = float(np.quantile(self.strange[seen], STRANGE_SHARE))
        values, changes = found.values[:knots], found.values[knots:]
        doubts = doubts_of(found, spread)
        return LedOffset(values, self.up_to, changes, self.distance, doubts, spread.scatter, strange, True)


def calibrate_offset(rig: Rig, pairs: Pairs, film: str) -> OffsetCalibration:
    """Fit the offset that all LEDs in ``pairs`` share; ``film`` is what sentences call them.

    Raises InputError where the angles that are needed were not seen, or most poses are far off.
    """
    angles, distances, largest = _angles(pairs, rig)
    check_angles(film, angles)
    told_distance = bool(distances.max() >= NARROW * distances.min())
    survey = _Survey(rig, pairs, largest, float(np.median(distances)), told_distance)
    linear, found, spread, used = _fitted(survey)
    folds = np.arange(len(pairs)) % FOLDS
    before = errors_of(pairs, rig, solve_sightings(rig, [s for s, _ in pairs]))
    for more in MORE_SCATTER_PX:
        wider = spread._replace(scatter=math.hypot(spread.scatter, more))
        after, weighted, chi2 = _held_out(survey, linear, spread, wider, used, folds)
        if _at_most(weighted[used]) <= POSE:
            break
    spread = wider
    offset = survey.offset(found, spread, used)
    rms = [float(np.sqrt(np.nanmean(away[used] ** 2))) for away, _ in (before, after)]
    gain = (_chi2_as_it_is(survey, rig, spread) - chi2)[used]
    helps = rms[1] < rms[0] and float(gain.sum()) > float(gain.std()) * math.sqrt(len(gain))
    sigmas = np.sqrt(np.diag(found.covariance)[: len(offset.values)])
    return OffsetCalibration(
        offset, spread, sigmas, used, angles, distances, largest, before, after, weighted, helps, told_distance
    )


def _at_most(squared: Floats) -> float:
    """The mean of squared errors (n,) and one standard error of it."""
    return float(np.nanmean(squared) + np.nanstd(squared) / math.sqrt(max(np.isfinite(squared).sum(), 1)))


def _fitted(survey: _Survey) -> tuple[Linear, Found, Spread, NDArray[np.bool_]]:
    """The fit to all poses but those that are far off."""
    used = np.ones(len(survey.pairs), np.bool_)
    up_to, spread = survey.up_to, START
    linear = survey.linear(survey.nothing())
    for _ in range(ROUNDS):
        spread = most_likely(linear.rows(used), up_to, spread)
        found = posterior(linear.rows(used), up_to, spread)
        linear = survey.linear(survey.offset(found, spread, used))
        left = chi2_with(linear, found.values, spread) / (2.0 * survey.table.seen)
        now = left <= FAR_OFF * max(float(np.median(left)), 1e-9)
        if now.sum() < MOST_LEFT_OUT * len(now):
            raise InputError(
                f"{(~now).sum()} of {len(now)} surveyed poses are far off what the others say, expected few such; do "
                "truth and frames belong together, is the rig roughly right?"
            )
        if (now == used).all():
            break
        used = now
    return linear, found, spread, used


def _plain(table: Table, strange: Floats) -> Table:
    """With the centres' own noise alone."""
    noise = table.noise.copy()
    allowed = np.repeat(strange**2, 2, axis=1)
    numbers = np.arange(2 * LEDS)
    noise[:, numbers, numbers] = np.maximum(noise[:, numbers, numbers] - allowed, 1e-8)
    return replace(table, noise=noise)


def _chi2_as_it_is(survey: _Survey, rig: Rig, spread: Spread) -> Floats:
    """Squared residuals (n,) by the rig as it is."""
    had = table_of(survey.pairs, rig)
    linear = survey.linear(survey.nothing())
    predicted = had.spots(rig.camera, had.layouts, had.optics, had.rotations, had.ts)
    residuals = had.centres.reshape(len(had), -1) - predicted
    return chi2_with(linear._replace(residuals=residuals), np.zeros(linear.by_values.shape[2]), spread)


def _held_out(
    survey: _Survey, linear: Linear, spread: Spread, told: Spread, used: NDArray[np.bool_], folds: NDArray[np.int64]
) -> tuple[tuple[Floats, Floats], Floats, Floats]:
    """Errors of every pose with the offset fitted to the others, those by their covariances with ``told`` scatter, and
    the squared residuals of the centres at the surveyed poses.
    """
    n = len(survey.pairs)
    away, turned, weighted, chi2 = np.full((n, 3), np.nan), np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    for fold in range(FOLDS):
        out = folds == fold
        found = posterior(linear.rows(~out & used), survey.up_to, spread)
        chi2[out] = chi2_with(linear.rows(out), found.values, spread)
        tried = with_offset(survey.rig, survey.offset(found, told, used))
        rows = np.flatnonzero(out)
        here = [survey.pairs[k] for k in rows]
        solved = solve_sightings(tried, [s for s, _ in here])
        away[rows], turned[rows] = errors_of(here, tried, solved)
        weighted[rows] = weighted_errors(here, tried, solved, (spread.survey_m, spread.survey_rad))
    return (away, turned), weighted, chi2


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


def _angles(pairs: Pairs, rig: Rig) -> tuple[Floats, Floats, float]:
    """Angles (n,) rad between LED axis and line of sight at the robots' middles, their distances (n,) m, and the
    largest angle at any LED; by where robots were located, since of a survey single poses may be wrong.
    """
    middles, distances, largest = [], [], 0.0
    for sighting, _ in pairs:
        robot = rig.robot(sighting.robot)
        points = sighting.pose.map(np.vstack([robot.leds.mean(axis=0), robot.leds]))
        away = np.linalg.norm(points, axis=1)
        angles = np.arccos(np.clip(-(points @ (sighting.pose.rotation @ robot.axis)) / away, 0.0, 1.0))
        middles.append(angles[0])
        distances.append(away[0])
        largest = max(largest, float(angles.max()))
    return np.array(middles), np.array(distances), largest
