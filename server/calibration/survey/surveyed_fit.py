"""Fitting what a rig has in common to centres seen at surveyed poses, when the survey is not exact either.

Every pose is off its survey by an unknown small shift and turn, every centre by its own noise and by what the model
lacks. Both are integrated out: the six spots of a sighting have the covariance N + J S J', N of the centres, J their
derivatives by the pose, S the survey's. How large S and the lack are is found by maximum likelihood together with the
fit (generalized least squares with estimated variance components; Bates and Pinheiro, "Mixed-effects models in S and
S-PLUS", 2000, ch. 2). Priors hold what the poses do not determine.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from asterism.protocol.camera import Camera
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, angle_between, exp_rotation, log_rotation
from asterism.protocol.rig import Rig
from asterism.server.calibration.survey.surveyed import Pairs, true_poses
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import lens_of
from asterism.server.pose.matched import LEAST_SIGMA_PX
from asterism.server.pose.spot_shift import optics_of, spots_at

NUMBERS = 2 * LEDS
NOT_SEEN = 1e12  # px^2, variance of a centre that is not there
POSE_STEPS = np.array([1e-5] * 3 + [1e-4] * 3)  # m, rad: of numeric derivatives
# Noise beyond the centres' own px, survey m and rad: at the start, and never less than.
START = np.array([0.05, 1e-3, 5e-3])
LEAST = np.array([1e-4, 1e-6, 1e-6])
ROUNDS = 5
FAR_OFF = 9.0  # times chi squared per number, after the lack is known: the survey or the sighting is wrong
MOST_FOR_SIGMAS = 300  # sightings the variances are found from


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """n sightings at surveyed poses.

    ``robots`` (n,) index the rig's; ``layouts`` (n, 6, 3) m in the plane's frame; ``optics`` (n, OPTICS);
    ``rotations`` (n, 3, 3), ``ts`` (n, 3) the surveyed T_camera_plane; ``centres`` (n, 6, 2) px, 0 where not seen;
    ``noise`` (n, 12, 12) px^2 their covariances, NOT_SEEN where they are not; ``seen`` (n,) how many are.
    """

    robots: NDArray[np.int64]
    layouts: Floats
    optics: Floats
    rotations: Floats
    ts: Floats
    centres: Floats
    noise: Floats
    seen: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.robots)

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "Table":
        return Table(
            self.robots[rows], self.layouts[rows], self.optics[rows], self.rotations[rows], self.ts[rows],
            self.centres[rows], self.noise[rows], self.seen[rows],
        )  # fmt: skip

    def spots(self, camera: Camera, layouts: Floats, optics: Floats, rotations: Floats, ts: Floats) -> Floats:
        """Where the spots (n, 12) px lie, for other layouts, optics or poses than the table's."""
        pixels = np.empty((len(self), LEDS, 2))
        spots_at(lens_of(camera), layouts, optics, rotations, ts, pixels)
        return pixels.reshape(-1, NUMBERS)


def table_of(pairs: Pairs, rig: Rig) -> Table:
    """The sightings and their surveyed poses, for a rig."""
    index = {robot.id: k for k, robot in enumerate(rig.robots)}
    robots = np.array([index[s.robot] for s, _ in pairs])
    planes = [
        pose @ rig.robots[k].T_robot_plane for pose, k in zip(true_poses(pairs, rig), robots.tolist(), strict=True)
    ]
    centres = np.array([s.centres.centres_px for s, _ in pairs])
    there = np.isfinite(centres[:, :, 0])
    spreads = np.array([s.centres.covariances_px2 for s, _ in pairs]) + LEAST_SIGMA_PX**2 * np.eye(2)
    noise = np.zeros((len(pairs), NUMBERS, NUMBERS))
    for led in range(LEDS):
        block = np.where(there[:, led, None, None], spreads[:, led], NOT_SEEN * np.eye(2))
        noise[:, 2 * led : 2 * led + 2, 2 * led : 2 * led + 2] = block
    return Table(
        robots,
        np.array([rig.robots[k].leds_plane for k in robots]),
        np.array([optics_of(rig.robots[k]) for k in robots]),
        np.array([pose.rotation for pose in planes]),
        np.array([pose.position for pose in planes]),
        np.where(there[:, :, None], centres, 0.0),
        noise,
        there.sum(axis=1),
    )


def moved(rotations: Floats, ts: Floats, move: Floats) -> tuple[Floats, Floats]:
    """Poses (n, 3, 3), (n, 3) all moved by (6,): shift m, then turn rad about their own origins, camera's axes."""
    return exp_rotation(move[3:]) @ rotations, ts + move[:3]


# Parameters (p,) and a table's rows -> predicted spots (n, 12) px, derivatives by the parameters (n, 12, p) and by the
# surveyed poses (n, 12, 6), shift m, turn rad.
Model = Callable[[Floats, Table], tuple[Floats, Floats, Floats]]


def by_pose(table: Table, camera: Camera, layouts: Floats, optics: Floats, rotations: Floats, ts: Floats) -> Floats:
    """Derivatives (n, 12, 6) of the spots by shift and turn of the poses, central differences."""
    columns = []
    for k, step in enumerate(POSE_STEPS):
        move = np.zeros(6)
        move[k] = step
        up = table.spots(camera, layouts, optics, *moved(rotations, ts, move))
        down = table.spots(camera, layouts, optics, *moved(rotations, ts, -move))
        columns.append((up - down) / (2 * step))
    return np.stack(columns, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedFit:
    """``parameters`` (p,) with their ``covariance`` (p, p); ``sigmas`` (3,): what centres lack, px, and what the survey
    is off, m and rad; ``used`` (n,) which sightings the fit rests on, the others being far off.
    """

    parameters: Floats
    covariance: Floats
    sigmas: Floats
    used: NDArray[np.bool_]


def fit(model: Model, table: Table, priors: Floats, sigmas: Floats | None = None) -> SurveyedFit:
    """Parameters that explain the centres, near zero as ``priors`` (p,), one sigma each, say.

    With ``sigmas`` given they are taken as known and nothing is left out: for subsets of a table that was fitted.
    Raises InputError where more than half of the sightings are far off.
    """
    n = len(table)
    parameters = np.zeros(len(priors))
    used = np.ones(n, np.bool_)
    known = sigmas is not None
    current = START if sigmas is None else sigmas
    information = np.diag(1.0 / priors**2)
    for round_ in range(1 if known else ROUNDS):
        for _ in range(3):
            predicted, by_parameters, jacobian = model(parameters, table)
            residuals = table.centres.reshape(n, NUMBERS) - predicted
            inverse = np.linalg.inv(_covariances(table, jacobian, current))
            chi2 = np.einsum("ni,nij,nj->n", residuals, inverse, residuals)
            # A single wrong pose must not pull before it is found out.
            weights = used / (1.0 + (0.0 if known or round_ > 1 else 1.0) * chi2 / (9.0 * 2 * table.seen))
            weighted = weights[:, None, None] * (np.swapaxes(by_parameters, 1, 2) @ inverse)
            normal = np.tensordot(weighted, by_parameters, ([0, 2], [0, 1])) + information
            right = np.tensordot(weighted, residuals, ([0, 2], [0, 1])) - information @ parameters
            # In units of the priors, since metres, pixels and coefficients are of different sizes.
            step = priors * np.linalg.solve(priors[:, None] * normal * priors, priors * right)
            parameters = parameters + step
            if np.abs(step / priors).max() < 1e-7:
                break
        if known:
            break
        predicted, _, jacobian = model(parameters, table)
        residuals = table.centres.reshape(n, NUMBERS) - predicted
        if round_ >= 1:
            used = chi2_of(table, residuals, jacobian, current) <= FAR_OFF * 2 * table.seen
            if 2 * used.sum() < n:
                raise InputError(
                    f"{n - used.sum()} of {n} surveyed poses are far off what the others say, expected few such; do "
                    "truth and frames belong together, is the rig roughly right?"
                )
        if round_ < ROUNDS - 1:
            current = _most_likely(table[used], residuals[used], jacobian[used], current, robust=round_ == 0)
    covariance = priors[:, None] * np.linalg.inv(priors[:, None] * normal * priors) * priors
    return SurveyedFit(parameters, covariance, current, used)


def chi2_of(table: Table, residuals: Floats, jacobian: Floats, sigmas: Floats) -> Floats:
    """Squared residuals (n,) of every sighting, in units of their covariance."""
    inverse = np.linalg.inv(_covariances(table, jacobian, sigmas))
    squared: Floats = np.einsum("ni,nij,nj->n", residuals, inverse, residuals)
    return squared


def _covariances(table: Table, jacobian: Floats, sigmas: Floats) -> Floats:
    survey = np.repeat(sigmas[1:] ** 2, 3)
    spreads: Floats = table.noise + sigmas[0] ** 2 * np.eye(NUMBERS) + (jacobian * survey) @ np.swapaxes(jacobian, 1, 2)
    return spreads


def _most_likely(table: Table, residuals: Floats, jacobian: Floats, start: Floats, robust: bool) -> Floats:
    """The sigmas (3,) that make the residuals most likely; robust: a sighting that is far off counts little."""
    if len(table) > MOST_FOR_SIGMAS:
        rows = np.linspace(0, len(table) - 1, MOST_FOR_SIGMAS).round().astype(int)
        table, residuals, jacobian = table[rows], residuals[rows], jacobian[rows]
    freedom = 2.0 * table.seen

    def cost(logs: Floats) -> float:
        spreads = _covariances(table, jacobian, np.maximum(np.exp(logs), LEAST))
        _, determinants = np.linalg.slogdet(spreads)
        squared = (residuals * np.linalg.solve(spreads, residuals[..., None])[..., 0]).sum(axis=1)
        if robust:
            # Student's t with four degrees of freedom.
            squared = (4.0 + freedom) * np.log1p(squared / 4.0)
        return float((determinants + squared).sum())

    best = minimize(cost, np.log(start), method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.05, "maxfev": 250})
    found: Floats = np.maximum(np.exp(best.x), LEAST)
    return found


def errors_of(pairs: Pairs, rig: Rig, solved: list[tuple[Pose, Floats] | None]) -> tuple[Floats, Floats]:
    """Errors (n, 3) m in the camera's frame, and rotation (n,) rad, of solved poses against the survey; nan: none."""
    away, turned = np.full((len(pairs), 3), np.nan), np.full(len(pairs), np.nan)
    for k, (truth, answer) in enumerate(zip(true_poses(pairs, rig), solved, strict=True)):
        if answer is not None:
            away[k] = answer[0].position - truth.position
            turned[k] = angle_between(answer[0].rotation, truth.rotation)
    return away, turned


def weighted_errors(
    pairs: Pairs, rig: Rig, solved: list[tuple[Pose, Floats] | None], survey: tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """Squared errors (n,) of solved poses by their covariances and the ``survey``'s, one sigma in m and rad, which
    average 6 where these are meant; nan: none.
    """
    own = np.diag(np.repeat(np.square(survey), 3))
    squared = np.full(len(pairs), np.nan)
    for k, (truth, answer) in enumerate(zip(true_poses(pairs, rig), solved, strict=True)):
        if answer is not None:
            turned = log_rotation(answer[0].rotation @ truth.rotation.T)
            error = np.concatenate([answer[0].position - truth.position, turned])
            squared[k] = error @ np.linalg.solve(answer[1] + own, error)
    return squared
