"""What the errors of lens and robots do to a camera placed by robots at surveyed places.

All samples are seen through one lens, and those of a robot share its frame and its size: such errors do not average
out. Part of it looks like a move of the camera, the
rest stays in the residuals, where `fit_world` takes it for the survey's. So the survey's variances are found again, as
those which together with the lens make the squared residuals as large as they are (method of moments), and the weights
that the fit had give the covariance of its result (the "sandwich": Huber, "The behavior of maximum likelihood estimates
under nonstandard conditions", 1967).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.calibration.lens.lens_error import pose_by_lens
from asterism.server.calibration.lens.values import pixels_by_lens
from asterism.server.calibration.survey.world import WorldFit
from asterism.server.calibration.survey.world_table import (
    POSITION,
    ROTATION,
    Sample,
    Table,
    residuals_of,
    spreads_of,
    weighted_by_pose,
)

STEP = 1e-6  # m, of numeric derivatives


class RobotError(NamedTuple):
    """One sigma of what is not known of a robot: the size of its constellation, as a share, and where its frame lies,
    m, rad of tilt against the plate, and rad about the plate's normal.
    """

    size_relative: float
    frame_m: float
    tilt_rad: float
    turn_rad: float


class Shares(NamedTuple):
    """The parts (6, 6) of the covariance of T_world_camera, m and rad about the world's axes."""

    lens: Floats
    robots: Floats


def with_systematic_errors(
    fit: WorldFit, rig: Rig, lens: Floats, robots: Mapping[str, RobotError]
) -> tuple[WorldFit, Shares]:
    """The fit with a covariance and survey's sigmas that know of lens and robots, and their shares of the covariance;
    ``lens`` (p, p) is the covariance of fx, fy, cx, cy and coefficients.
    """
    table, T = Table.of(fit.samples)[fit.used], fit.T_world_camera
    samples = [sample for sample, used in zip(fit.samples, fit.used, strict=True) if used]
    sigmas = (fit.survey_sigma_m, fit.survey_sigma_rad)
    by_pose, weighted = weighted_by_pose(table, T, sigmas)
    to_camera = np.linalg.inv((weighted @ by_pose).sum(axis=0)) @ weighted  # (n, 6, 6)
    seen = np.array(
        [np.hstack([_seen_by_lens(sample, rig), _seen_by_robots(sample, rig, robots)]) for sample in samples]
    )
    causes = block_diag(lens, np.eye(seen.shape[2] - len(lens)))
    by_cause = -np.kron(np.eye(2), T.rotation) @ seen  # (n, 6, p), of the residuals
    moved = (to_camera @ by_cause).sum(axis=0)
    left = by_cause - by_pose @ moved
    survey = tuple(
        _survey_sigma(fit, table, part, np.einsum("nij,jk,nlk->nil", left, causes, left))
        for part in (POSITION, ROTATION)
    )
    spreads = spreads_of(table, T, (survey[0], survey[1]))
    own = (to_camera @ spreads @ np.swapaxes(to_camera, 1, 2)).sum(axis=0)
    p = len(lens)
    shares = Shares(moved[:, :p] @ lens @ moved[:, :p].T, moved[:, p:] @ moved[:, p:].T)
    told = replace(
        fit, covariance=own + shares.lens + shares.robots, survey_sigma_m=survey[0], survey_sigma_rad=survey[1]
    )
    return told, shares


def _survey_sigma(fit: WorldFit, table: Table, part: slice, left: Floats) -> float:
    """The survey's sigma when the other causes left residuals of covariance ``left`` (n, 6, 6) beside it."""
    sigmas = (fit.survey_sigma_m, fit.survey_sigma_rad)
    rows = np.ones(len(table.seen), np.bool_) if part == POSITION else table.oriented
    if sigmas[0 if part == POSITION else 1] == 0.0 or not rows.any():
        return 0.0
    off = residuals_of(table, fit.T_world_camera)[rows, part]
    own, seen = (spreads_of(table, fit.T_world_camera, each)[rows, part, part] for each in (sigmas, (0.0, 0.0)))
    information = np.linalg.inv(own)
    numbers = 3.0 * int(rows.sum())
    free = max(numbers - (6.0 if part == POSITION else 0.0), 1.0) / numbers
    found = np.einsum("ni,nij,nj->", off, information, off) - np.einsum(
        "nij,nji->", information, left[rows, part, part]
    )
    unexplained = found / free - np.einsum("nij,nji->", information, seen)
    return float(np.sqrt(max(unexplained, 0.0) / np.einsum("nii->", information)))


def _seen_by_lens(sample: Sample, rig: Rig) -> Floats:
    """How the robot's pose in the camera's frame moves (6, p) with the lens that it is seen through."""
    arms = rig.robot(sample.robot).leds @ sample.seen.rotation.T
    points = arms + sample.seen.position
    shifts = STEP * np.eye(3)[:, None]
    by_point = (rig.camera.project(points + shifts) - rig.camera.project(points - shifts)) / (2.0 * STEP)
    by_point = np.moveaxis(by_point, 0, -1)  # (6, 2, 3)
    by_turn = by_point @ np.swapaxes(np.cross(np.eye(3), arms[:, None]), 1, 2)
    by_pose = np.concatenate([by_point, by_turn], axis=-1).reshape(-1, 6)
    return pose_by_lens(by_pose, pixels_by_lens(rig.camera, points).reshape(len(by_pose), -1))


def _seen_by_robots(sample: Sample, rig: Rig, robots: Mapping[str, RobotError]) -> Floats:
    """How the robot's pose in the camera's frame moves (6, 7 robots) for one sigma of every robot's errors."""
    moved = np.zeros((6, 7 * len(robots)))
    for k, (robot, error) in enumerate(robots.items()):
        if robot == sample.robot:
            part = moved[:, 7 * k : 7 * k + 7]
            part[:3, 0] = error.size_relative * sample.seen.position
            part[:3, 1:4] = error.frame_m * sample.seen.rotation
            plane = sample.seen.rotation @ rig.robot(robot).T_robot_plane.rotation
            part[3:, 4:] = plane * [error.tilt_rad, error.tilt_rad, error.turn_rad]
    return moved
