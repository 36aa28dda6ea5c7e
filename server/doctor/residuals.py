"""Residuals of poses, in units of their noise, with all that a pose can take up removed.

A robot's pose is fitted to its spots, so of 2 k residuals 2 k - 6 tell something. Every sighting is whitened with its
spots' covariances, and what it and any explanation of it share with the six directions of the pose is projected out
(QR of the whitened Jacobian); then sightings may be added up as plain least squares, and improvements are chi squared.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server.doctor.gather import Sightings

STEP = 1e-5  # m and rad


class Whitened(NamedTuple):
    """m sightings: ``residuals`` (m, 12), LED by LED x and y, 0 for LEDs not seen; ``freedom`` (m,), how many of them
    are free; ``whiten`` (m, 6, 2, 2) and ``away`` (m, 12, 6), an orthonormal basis of the pose: for `explained_by`;
    ``points`` (m, 6, 3) m, the LEDs in the camera's frame.
    """

    residuals: Floats
    freedom: Floats
    whiten: Floats
    away: Floats
    points: Floats


def whitened(rig: Rig, seen: Sightings) -> Whitened:
    """Of all sightings with four LEDs and more; the others have no freedom."""
    m = len(seen.frames)
    turns = np.array([pose.rotation for pose in seen.poses]).reshape(m, 3, 3)
    places = np.array([pose.position for pose in seen.poses]).reshape(m, 3)
    leds = np.array([rig.robots[robot].leds for robot in seen.robots.tolist()]).reshape(m, LEDS, 3)
    arms = np.einsum("mij,mlj->mli", turns, leds)
    points = arms + places[:, None]
    lit = seen.lit
    whiten = _square_roots(seen.covariances, lit)
    residuals = np.einsum("mlij,mlj->mli", whiten, np.where(lit[..., None], seen.residuals, 0.0)).reshape(m, -1)
    by_pose = _by_pose(rig, arms, places)
    flat = np.einsum("mlij,mljk->mlik", whiten, by_pose).reshape(m, 2 * LEDS, 6)
    away = np.linalg.qr(flat)[0] if m else np.empty((0, 2 * LEDS, 6))
    free = 2.0 * np.count_nonzero(lit, axis=1) - 6.0
    residuals = _without(residuals[..., None], away)[..., 0] * (free > 0)[:, None]
    return Whitened(residuals, np.maximum(free, 0.0), whiten, away, points)


def explained_by(told: Whitened, by: Floats) -> Floats:
    """Derivatives (m, 6, 2, p) of pixels by parameters, whitened and without what the pose takes up: (m, 12, p)."""
    m, p = len(by), by.shape[-1]
    flat = np.einsum("mlij,mljk->mlik", told.whiten, by).reshape(m, 2 * LEDS, p)
    return _without(flat, told.away) * (told.freedom > 0)[:, None, None]


def _without(columns: Floats, away: Floats) -> Floats:
    """Columns (m, 12, p) less their part in the span of ``away`` (m, 12, 6)."""
    left: Floats = columns - away @ (away.transpose(0, 2, 1) @ columns)
    return left


def _square_roots(covariances: Floats, lit: NDArray[np.bool_]) -> Floats:
    """W (m, 6, 2, 2) with W' W the inverse of covariances (m, 6, 3) xx, xy, yy; 0 for LEDs not seen."""
    xx, xy, yy = (np.where(lit, covariances[..., k], fill) for k, fill in ((0, 1.0), (1, 0.0), (2, 1.0)))
    # Cholesky's factor of the inverse, written out.
    low = np.sqrt(xx)
    rest = np.sqrt(np.maximum(yy - xy * xy / xx, 1e-18))
    zero = np.zeros_like(xx)
    roots = np.stack([np.stack([1.0 / low, zero], -1), np.stack([-xy / (xx * rest), 1.0 / rest], -1)], -2)
    return np.where(lit[..., None, None], roots, 0.0)


def _by_pose(rig: Rig, arms: Floats, places: Floats) -> Floats:
    """Derivatives (m, 6, 2, 6) of the pixels by the poses' position and rotation about the camera's axes."""
    columns = []
    for k in range(3):
        turn = exp_rotation(STEP * np.eye(3)[k])
        moved = [(arms, places + sign * STEP * np.eye(3)[k]) for sign in (1.0, -1.0)]
        turned = [(arms @ turn.T, places), (arms @ turn, places)]
        columns.append((moved, k))
        columns.append((turned, 3 + k))
    by = np.empty((*arms.shape[:2], 2, 6))
    for (ahead, behind), k in columns:
        pixels = [rig.camera.project(arm + place[:, None]) for arm, place in (ahead, behind)]
        by[..., k] = (pixels[0] - pixels[1]) / (2.0 * STEP)
    return by
