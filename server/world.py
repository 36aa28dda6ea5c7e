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
from asterism.server.bundle import rigid_fit
from asterism.server.observations import Sighting
from asterism.server.survey import SurveyedPose

FEWEST_POINTS = 3
NARROWEST = 0.05  # of the points' spread along their line: how far they must spread across it
ENOUGH_TO_DOUBT = 6  # points, from which one that is far off can be told
FAR_OFF = 5.0  # sigmas
SAME_PLACE_M = 1e-6
MOST_TRIPLES = 300
SCALE_OFF = 0.05
MEDIAN_CHI2 = 2.366  # of three degrees of freedom
ITERATIONS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A robot at a surveyed place: ``seen`` is T_camera_robot with ``covariance`` (6, 6), m and rad about the camera's
    axes, from ``frames`` frames; ``position`` (3,) m and ``orientation`` (a Pose's, or None) are T_world_robot.
    """

    name: str
    frames: int
    seen: Pose
    covariance: Floats
    position: Floats
    orientation: Floats | None


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
    return replace(rig, T_world_camera=None, robots=robots)


def fit_world(pairs: Sequence[tuple[Sighting, SurveyedPose]]) -> WorldFit:
    """Fit T_world_camera to robots seen at surveyed places (T_world_robot).

    Raises InputError for too few places, places on one line, or places that cannot be those of the robots seen.
    """
    places = np.array([surveyed.position for _, surveyed in pairs]).reshape(-1, 3)
    _check_spread(_distinct(places), "surveyed")
    seen = np.array([sighting.pose.position for sighting, _ in pairs])
    start = _rough(seen, places)
    _check_scale(seen, places)
    samples = _merged([_likelier_tilt(sighting, surveyed, start) for sighting, surveyed in pairs])
    n = len(samples)
    T, (sigma_m, sigma_rad) = _refined(samples, np.ones(n), start, robust=True)
    used = np.ones(n, np.bool_)
    if n >= ENOUGH_TO_DOUBT:
        used = _sigmas_off(samples, T, sigma_m, sigma_rad) < FAR_OFF
    good = [sample for sample, keep in zip(samples, used, strict=True) if keep]
    if 2 * len(good) <= n:
        raise InputError(f"the surveyed places: no more than {len(good)} of {n} agree with what the camera sees")
    _check_spread(np.array([sample.position for sample in good]), "surveyed (those that agree)")
    T, (sigma_m, sigma_rad) = _refined(good, np.ones(len(good)), T, robust=False)
    held_out = np.full((n, 3), np.nan)
    for k, sample in enumerate(samples):
        others = [other for other, keep in zip(samples, used, strict=True) if keep and other is not sample]
        if _determined(others):
            alone = _solved(others, np.ones(len(others)), T, sigma_m, sigma_rad)[0] if used[k] else T
            held_out[k] = _off(sample, alone)[0]
    residuals = [_off(sample, T) for sample in samples]
    covariance = _solved(good, np.ones(len(good)), T, sigma_m, sigma_rad)[1]
    return WorldFit(
        T,
        covariance,
        tuple(samples),
        np.array([position for position, _ in residuals]),
        np.array([rotation for _, rotation in residuals]),
        held_out,
        used,
        sigma_m,
        sigma_rad,
    )


def _distinct(places: Floats) -> Floats:
    kept: list[Floats] = []
    for place in places:
        if all(np.linalg.norm(place - other) > SAME_PLACE_M for other in kept):
            kept.append(place)
    return np.array(kept).reshape(-1, 3)


def _spread(places: Floats) -> tuple[float, float]:
    """How far (rms, m) the places spread along their longest direction and across it."""
    lengths = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / np.sqrt(len(places))
    return float(lengths[0]), float(lengths[1])


def _check_spread(places: Floats, what: str) -> None:
    if len(places) < FEWEST_POINTS:
        raise InputError(
            f"the places: {len(places)} {what} and seen, expected at least {FEWEST_POINTS} that do not lie on one line"
        )
    along, across = _spread(places)
    if across < NARROWEST * along:
        raise InputError(
            f"the places: the {len(places)} that are {what} and seen lie on one line (collinear: they spread by "
            f"{along:.3f} m along it and {across:.4f} m across), expected at least {FEWEST_POINTS} that do not"
        )


def _determined(samples: list[Sample]) -> bool:
    """Whether the samples alone determine the camera's pose."""
    if len(samples) < FEWEST_POINTS:
        return False
    along, across = _spread(np.array([sample.position for sample in samples]))
    return across >= NARROWEST * along


def _check_scale(seen: Floats, places: Floats) -> None:
    """Surveyed distances must be those seen: the median of their ratios, over all pairs that are well apart."""
    first, second = np.triu_indices(len(seen), 1)
    a = np.linalg.norm(seen[first] - seen[second], axis=1)
    b = np.linalg.norm(places[first] - places[second], axis=1)
    far = a > 0.5 * a.max()
    scale = float(np.median(b[far] / a[far]))
    if abs(scale - 1.0) > SCALE_OFF:
        hint = "; are the surveyed positions in mm?" if abs(scale / 1e3 - 1.0) < SCALE_OFF else ""
        raise InputError(
            f"the surveyed places: they are {scale:.3g} times as far apart as the robots that the camera sees, expected "
            f"positions in m of the same robots{hint}"
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
    name = f"{sighting.robot} in {sighting.frame}"
    return Sample(name, 1, pose, sighting.covariance, surveyed.position, surveyed.orientation)


def _merged(samples: list[Sample]) -> list[Sample]:
    """Samples of one surveyed place made one: further frames of it measure the camera's noise, not the survey's."""
    groups: list[list[Sample]] = []
    for sample in samples:
        for group in groups:
            if _same_place(sample, group[0]):
                group.append(sample)
                break
        else:
            groups.append([sample])
    return [_mean(group) for group in groups]


def _same_place(a: Sample, b: Sample) -> bool:
    if np.linalg.norm(a.position - b.position) > SAME_PLACE_M or a.name.split(" in ")[0] != b.name.split(" in ")[0]:
        return False
    if a.orientation is None or b.orientation is None:
        return a.orientation is b.orientation
    return bool(np.abs(a.orientation - b.orientation).max() < 1e-9)


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
    covariance = np.linalg.inv(total)
    move = covariance @ right
    seen = Pose.from_matrix(exp_rotation(move[3:]) @ first.seen.rotation, first.seen.position + move[:3])
    robot, _, frame = first.name.partition(" in ")
    name = f"{robot} in {len(group)} frames from {frame}"
    return Sample(name, len(group), seen, covariance, first.position, first.orientation)


def _off(sample: Sample, T_world_camera: Pose) -> tuple[Floats, Floats]:
    """Surveyed minus predicted: position (3,) m and rotation vector (3,) about the world's axes, nan without one."""
    predicted = T_world_camera @ sample.seen
    if sample.orientation is None:
        return sample.position - predicted.position, np.full(3, np.nan)
    surveyed = Pose(sample.position, sample.orientation)
    return sample.position - predicted.position, log_rotation(surveyed.rotation @ predicted.rotation.T)


def _spreads(sample: Sample, T_world_camera: Pose) -> Floats:
    """The seen pose's covariance (6, 6) about the world's axes."""
    turn = np.kron(np.eye(2), T_world_camera.rotation)
    turned: Floats = turn @ sample.covariance @ turn.T
    return turned


def _sigmas_off(samples: list[Sample], T: Pose, sigma_m: float, sigma_rad: float) -> Floats:
    """How far off every sample is (n,), the larger of position and rotation, sigmas."""
    sigmas = []
    for sample in samples:
        spread, (position, rotation) = _spreads(sample, T), _off(sample, T)
        off = position @ np.linalg.solve(spread[:3, :3] + sigma_m**2 * np.eye(3), position)
        if sample.orientation is not None:
            off = max(off, rotation @ np.linalg.solve(spread[3:, 3:] + sigma_rad**2 * np.eye(3), rotation))
        sigmas.append(np.sqrt(off))
    return np.array(sigmas)


def _refined(samples: list[Sample], weights: Floats, T: Pose, robust: bool) -> tuple[Pose, tuple[float, float]]:
    """The fit with the survey's own variances, which are found together with it; robust: both by medians."""
    sigma_m = sigma_rad = 0.0
    for _ in range(ITERATIONS):
        before = T
        sigma_m = _survey_sigma(samples, T, slice(0, 3), robust)
        sigma_rad = _survey_sigma(samples, T, slice(3, 6), robust)
        if robust:
            weights = 1.0 / (1.0 + (_sigmas_off(samples, T, sigma_m, sigma_rad) / 3.0) ** 2)
        T, _ = _solved(samples, weights, T, sigma_m, sigma_rad)
        moved = np.linalg.norm(T.position - before.position) + angle_between(T.rotation, before.rotation)
        if moved < 1e-12:
            break
    return T, (sigma_m, sigma_rad)


def _solved(
    samples: list[Sample], weights: Floats, T: Pose, sigma_m: float, sigma_rad: float
) -> tuple[Pose, Floats]:
    """Gauss-Newton on the camera's pose, six numbers (shift, rotation about the world's axes), and its covariance."""
    extra = np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
    inverse = np.eye(6)
    for _ in range(5):
        normal, right = np.zeros((6, 6)), np.zeros(6)
        for sample, weight in zip(samples, weights, strict=True):
            x, y, z = T.rotation @ sample.seen.position
            by_pose = np.eye(6)
            by_pose[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
            spread, off = _spreads(sample, T) + extra, np.concatenate(_off(sample, T))
            rows = 3 if sample.orientation is None else 6
            weighted = weight * by_pose[:rows].T @ np.linalg.inv(spread[:rows, :rows])
            normal += weighted @ by_pose[:rows]
            right += weighted @ off[:rows]
        inverse = np.linalg.inv(normal)
        move = inverse @ right
        T = Pose.from_matrix(exp_rotation(move[3:]) @ T.rotation, T.position + move[:3])
    return T, inverse


def _survey_sigma(samples: list[Sample], T: Pose, part: slice, robust: bool) -> float:
    """One sigma of the survey's own error, m or rad, such that the residuals are as large as they should be."""
    which = 0 if part.start == 0 else 1
    given = [(_off(s, T)[which], _spreads(s, T)[part, part]) for s in samples if which == 0 or s.orientation is not None]
    if not given:
        return 0.0
    offs, spreads = np.array([off for off, _ in given]), np.array([spread for _, spread in given])
    # The six numbers of the fit take their share of the positions' residuals.
    freedom = max(3.0 * len(given) - (6.0 if which == 0 else 0.0), 1.0)

    def surplus(sigma: float) -> float:
        solved = np.linalg.solve(spreads + sigma**2 * np.eye(3), offs[..., None])[..., 0]
        chi2 = (offs * solved).sum(axis=1)
        if robust:
            return float(np.median(chi2)) / MEDIAN_CHI2 * 3.0 * len(given) / freedom - 1.0
        return float(chi2.sum()) / freedom - 1.0

    most = 10.0 * float(np.abs(offs).max())
    if surplus(0.0) <= 0.0 or most == 0.0:
        return 0.0
    return float(brentq(surplus, 0.0, most, xtol=1e-9))
