"""Where the camera is: T_world_camera from robots at surveyed places, or from a board on the floor.

Robots: every surveyed pose is compared with the pose the camera saw, weighted by that pose's covariance and by how well
the survey itself turns out to be (one variance of its positions, one of its orientations, so that the residuals are
as large as they should be). A gross mistake in the survey is found by its residual and left out.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, angle_between, exp_rotation, log_rotation
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.gauge import rigid_fit
from asterism.server.calibration.leds.observations import Sighting
from asterism.server.calibration.survey.survey import SurveyedPose
from asterism.server.calibration.survey.world_table import (
    POSITION,
    ROTATION,
    Sample,
    Table,
    moved,
    normal_equations,
    residuals_of,
    spreads_of,
)

FEWEST_POINTS = 3
NARROWEST = 0.05  # of the points' spread along their line: how far they must spread across it
ENOUGH_TO_DOUBT = 6  # points, from which one that is far off can be told
FAR_OFF = 5.0  # sigmas
PLACE_DECIMALS = 6  # places that agree to a micrometre are one
MOST_TRIPLES = 300
MOST_PAIRED = 200
SCALE_OFF = 0.05
MEDIAN_CHI2 = 2.366  # of three degrees of freedom
ITERATIONS = 30


@dataclass(frozen=True, slots=True, eq=False)
class WorldFit:
    """T_world_camera and how well it fits.

    ``covariance`` (6, 6), m and rad about the world's axes; ``residuals_m`` (n, 3) surveyed minus predicted positions,
    ``residuals_rad`` (n, 3) the same of rotations, nan where none was surveyed; ``held_out_m`` (n, 3) residuals of each
    sample against the fit to all others, nan where the others do not determine it; ``used`` (n,) False for samples that
    were left out; ``survey_sigma_m`` and ``survey_sigma_rad``: how far off the survey seems to be.
    """

    T_world_camera: Pose
    covariance: Floats
    samples: tuple[Sample, ...]
    residuals_m: Floats
    residuals_rad: Floats
    held_out_m: Floats
    used: NDArray[np.bool_]
    survey_sigma_m: float
    survey_sigma_rad: float


def without_world(rig: Rig) -> Rig:
    """The rig as if nobody knew where its camera is: a wrong world must not choose between two tilts."""
    robots = tuple(replace(robot, normal=None) for robot in rig.robots)
    return replace(rig, T_world_camera=None, follows_world=False, robots=robots)


def fit_world(pairs: Sequence[tuple[Sighting, SurveyedPose]], survey: str) -> WorldFit:
    """Fit T_world_camera to robots seen at surveyed places (T_world_robot); ``survey`` is what sentences call them.

    Raises InputError for too few places, places on one line, or places that cannot be those of the robots seen.
    """
    places = np.array([surveyed.position for _, surveyed in pairs]).reshape(-1, 3)
    _check_spread(np.unique(places.round(PLACE_DECIMALS), axis=0), survey, "surveyed and seen")
    seen = np.array([sighting.pose.position for sighting, _ in pairs])
    _check_scale(seen, places, survey)
    start = _rough(seen, places)
    samples = _merged([_likelier_tilt(sighting, surveyed, start) for sighting, surveyed in pairs])
    table, n = Table.of(samples), len(samples)
    T, sigmas = _refined(table, start, robust=True)
    used = np.ones(n, np.bool_)
    if n >= ENOUGH_TO_DOUBT:
        used = _sigmas_off(table, T, sigmas) < FAR_OFF
    if 2 * used.sum() <= n:
        raise InputError(f"{survey}: no more than {used.sum()} of its {n} places agree with what the camera sees")
    _check_spread(table.positions[used], survey, "surveyed and seen alike")
    T, sigmas = _refined(table[used], T, robust=False)
    held_out, covariance = _held_out(table, used, T, sigmas)
    off = residuals_of(table, T)
    turned = np.where(table.oriented[:, None], off[:, 3:], np.nan)
    return WorldFit(T, covariance, tuple(samples), off[:, :3], turned, held_out, used, *sigmas)


def _spread(places: Floats) -> tuple[float, float]:
    """How far (rms, m) the places spread along their longest direction and across it."""
    lengths = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / np.sqrt(len(places))
    return float(lengths[0]), float(lengths[1])


def _check_spread(places: Floats, survey: str, what: str) -> None:
    if len(places) < FEWEST_POINTS:
        raise InputError(
            f"{survey}: {len(places)} places are {what}, expected at least {FEWEST_POINTS} that do not lie on one line"
        )
    along, across = _spread(places)
    if across < NARROWEST * along:
        raise InputError(
            f"{survey}: the {len(places)} places that are {what} lie on one line (collinear: they spread by "
            f"{along:.3f} m along it and {across:.4f} m across), expected at least {FEWEST_POINTS} that do not"
        )


def _determined(places: Floats) -> bool:
    """Whether robots at these places alone determine the camera's pose."""
    if len(places) < FEWEST_POINTS:
        return False
    along, across = _spread(places)
    return across >= NARROWEST * along


def _check_scale(seen: Floats, places: Floats, survey: str) -> None:
    """Surveyed distances must be those seen: the median of their ratios, over pairs that are well apart."""
    rows = np.unique(np.linspace(0, len(seen) - 1, MOST_PAIRED).round().astype(int))
    seen, places = seen[rows], places[rows]
    first, second = np.triu_indices(len(seen), 1)
    a = np.linalg.norm(seen[first] - seen[second], axis=1)
    b = np.linalg.norm(places[first] - places[second], axis=1)
    far = a > 0.5 * a.max()
    scale = float(np.median(b[far] / a[far]))
    if abs(scale - 1.0) > SCALE_OFF:
        hint = "; are the surveyed positions in mm?" if abs(scale / 1e3 - 1.0) < SCALE_OFF else ""
        raise InputError(
            f"{survey}: its places are {scale:.3g} times as far apart as the robots that the camera sees, "
            f"expected positions in m of the same robots{hint}"
        )


def _rough(seen: Floats, places: Floats) -> Pose:
    """The rigid fit to three of the places that has the least median residual over all (Rousseeuw: "Least median of
    squares regression", 1984).
    """
    n = len(seen)
    if n * (n - 1) * (n - 2) // 6 <= MOST_TRIPLES:
        triples = np.array(list(itertools.combinations(range(n), 3)))
    else:
        rng = np.random.default_rng(0)
        triples = np.array([rng.choice(n, 3, replace=False) for _ in range(MOST_TRIPLES)])
    best, best_off = (np.eye(3), np.zeros(3)), np.inf
    candidates = [rigid_fit(seen, places)]
    for triple in triples:
        along, across = _spread(places[triple])
        if across > NARROWEST * along:
            candidates.append(rigid_fit(seen[triple], places[triple]))
    for turn, shift in candidates:
        off = float(np.median(np.linalg.norm(seen @ turn.T + shift - places, axis=1)))
        if off < best_off:
            best, best_off = (turn, shift), off
    return Pose.from_matrix(*best)


def _likelier_tilt(sighting: Sighting, surveyed: SurveyedPose, T_world_camera: Pose) -> Sample:
    """The sighting as a sample; of two tilts the one that is nearer to the surveyed orientation."""
    pose = sighting.pose
    if surveyed.orientation is not None and sighting.alternative is not None:
        there = T_world_camera.inverse().rotation @ surveyed.pose.rotation
        if angle_between(sighting.alternative.rotation, there) < angle_between(pose.rotation, there):
            pose = sighting.alternative
    return Sample(sighting.robot, sighting.frame, 1, pose, sighting.covariance, surveyed.position, surveyed.orientation)


def _merged(samples: list[Sample]) -> list[Sample]:
    """Samples of one surveyed place made one: further frames of it measure the camera's noise, not the survey's."""
    groups: dict[tuple[object, ...], list[Sample]] = {}
    for sample in samples:
        turned = None if sample.orientation is None else tuple(sample.orientation.round(9).tolist())
        place = tuple(sample.position.round(PLACE_DECIMALS).tolist())
        groups.setdefault((sample.robot, place, turned), []).append(sample)
    return [_mean(group) for group in groups.values()]


def _mean(group: list[Sample]) -> Sample:
    """Weighted mean of the poses, about the first."""
    first = group[0]
    if len(group) == 1:
        return first
    total, right = np.zeros((6, 6)), np.zeros(6)
    for sample in group:
        information = np.linalg.inv(sample.covariance)
        turned = log_rotation(sample.seen.rotation @ first.seen.rotation.T)
        total += information
        right += information @ np.concatenate([sample.seen.position - first.seen.position, turned])
    covariance = np.linalg.inv(total).astype(np.float64)
    move = covariance @ right
    seen = Pose.from_matrix(exp_rotation(move[3:]) @ first.seen.rotation, first.seen.position + move[:3])
    return replace(first, frames=len(group), seen=seen, covariance=covariance)


def _sigmas_off(table: Table, T: Pose, sigmas: tuple[float, float]) -> Floats:
    """How far off every sample is (n,), the larger of position and rotation, sigmas."""
    off, spreads = residuals_of(table, T), spreads_of(table, T, sigmas)
    squared = [
        (off[:, part] * np.linalg.solve(spreads[:, part, part], off[:, part, None])[..., 0]).sum(axis=1)
        for part in (POSITION, ROTATION)
    ]
    larger: Floats = np.sqrt(np.maximum(*squared))
    return larger


def _refined(table: Table, T: Pose, robust: bool) -> tuple[Pose, tuple[float, float]]:
    """The fit with the survey's own sigmas, m and rad, which are found together with it; robust: by medians."""
    weights = np.ones(len(table.seen))
    sigmas = (0.0, 0.0)
    for _ in range(ITERATIONS):
        before = T
        sigmas = (_survey_sigma(table, T, POSITION, robust), _survey_sigma(table, T, ROTATION, robust))
        if robust:
            weights = 1.0 / (1.0 + (_sigmas_off(table, T, sigmas) / 3.0) ** 2)
        normals, rights = normal_equations(table, T, sigmas)
        move = np.linalg.solve((weights[:, None, None] * normals).sum(axis=0), weights @ rights)
        T = moved(T, move)
        if np.linalg.norm(T.position - before.position) + np.linalg.norm(move[3:]) < 1e-12:
            break
    return T, sigmas


def _held_out(table: Table, used: NDArray[np.bool_], T: Pose, sigmas: tuple[float, float]) -> tuple[Floats, Floats]:
    """Positions' residuals (n, 3) of every sample against the fit to the others, and the fit's covariance (6, 6).

    One Gauss-Newton step from the fit to all is the fit to all but one: it moves by far less than the pose bends.
    """
    normals, rights = normal_equations(table, T, sigmas)
    normal, right = normals[used].sum(axis=0), rights[used].sum(axis=0)
    held_out = np.full((len(used), 3), np.nan)
    for k in range(len(used)):
        others = used.copy()
        others[k] = False
        if not _determined(table.positions[others]):
            continue
        alone = T
        if used[k]:
            alone = moved(T, np.linalg.solve(normal - normals[k], right - rights[k]))
        held_out[k] = residuals_of(table[np.array([k])], alone)[0, :3]
    return held_out, np.linalg.inv(normal)


def _survey_sigma(table: Table, T: Pose, part: slice, robust: bool) -> float:
    """One sigma of the survey's own error, m or rad, such that the residuals are as large as they should be."""
    rows = np.ones(len(table.seen), np.bool_) if part == POSITION else table.oriented
    if not rows.any():
        return 0.0
    off, spreads = residuals_of(table, T)[rows, part], spreads_of(table, T, (0.0, 0.0))[rows, part, part]
    # The six numbers of the fit take their share of the positions' residuals.
    numbers = 3.0 * int(rows.sum())
    freedom = max(numbers - (6.0 if part == POSITION else 0.0), 1.0)

    def surplus(sigma: float) -> float:
        chi2 = (off * np.linalg.solve(spreads + sigma**2 * np.eye(3), off[..., None])[..., 0]).sum(axis=1)
        if robust:
            return float(np.median(chi2)) / MEDIAN_CHI2 * numbers / freedom - 1.0
        return float(chi2.sum()) / freedom - 1.0

    if surplus(0.0) <= 0.0:
        return 0.0
    return float(brentq(surplus, 0.0, 10.0 * float(np.abs(off).max()), rtol=1e-6))
