"""Where the camera is, by constellations that stand still in the world: weighted least squares over all their LEDs.

Every LED says where in the image a known point of the world is; six numbers, the camera's shift and rotation about the
world's axes, are to fit them all (Gauss-Newton on rays). Errors of an LED's spot are of two kinds: some are new in
every frame, others stay, as what the rig has wrong; only the first average out.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation

STEPS = 12
SMALL = 1e-10  # m and rad: a step that is none
STEADY = 1e-12  # of the normal matrix


class Pinned(NamedTuple):
    """n LEDs whose ``points`` (n, 3) m in the world are known: their ``rays`` (n, 2), without what shifts spots, the
    ``own`` covariances (n, 2, 2) of the spots, which are new in every frame, and those that ``stay`` (n, 2, 2).
    """

    points: Floats
    rays: Floats
    own: Floats
    stay: Floats


class PlaceFit(NamedTuple):
    """T_world_camera; its covariance by the spots' ``noise`` and by what ``stays`` (6, 6) each, m and rad about the
    world's axes; ``chi2`` of all residuals, which have ``freedom`` degrees of freedom, and ``residuals`` (n, 2), rays.
    """

    T_world_camera: Pose
    noise: Floats
    stays: Floats
    chi2: float
    freedom: int
    residuals: Floats


def fit_place(pinned: Pinned, start: Pose, steps: int = STEPS) -> PlaceFit:
    """The place that fits best near ``start``."""
    T = start
    weights = np.linalg.inv(pinned.own + pinned.stay)
    for _ in range(steps):
        by_move, off = linearized(pinned, T)
        across = np.swapaxes(by_move, 1, 2) @ weights
        move = _solved((across @ by_move).sum(axis=0), (across @ off[..., None]).sum(axis=0)[:, 0])
        T = moved(T, move)
        if np.abs(move).max() < SMALL:
            break
    by_move, off = linearized(pinned, T)
    across = np.swapaxes(by_move, 1, 2) @ weights
    normal = (across @ by_move).sum(axis=0)
    both = np.linalg.inv(normal + STEADY * np.diag(np.diag(normal)))
    noise = both @ (across @ pinned.own @ np.swapaxes(across, 1, 2)).sum(axis=0) @ both
    stays = both @ (across @ pinned.stay @ np.swapaxes(across, 1, 2)).sum(axis=0) @ both
    chi2 = float((off[:, None] @ weights @ off[..., None]).sum())
    return PlaceFit(T, noise, stays, chi2, 2 * len(off) - 6, off)


def linearized(pinned: Pinned, T_world_camera: Pose) -> tuple[Floats, Floats]:
    """Derivatives (n, 2, 6) of the rays by the camera's shift and rotation about the world's axes, and the rays' own
    distance (n, 2) from where this place has them.
    """
    turn = T_world_camera.rotation
    arms = pinned.points - T_world_camera.position
    x, y, z = (arms @ turn).T
    by_point = np.zeros((len(arms), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1.0 / z
    by_point[:, 0, 2], by_point[:, 1, 2] = -x / z**2, -y / z**2
    by_place = by_point @ turn.T  # by the point in the world, as seen along the camera's axes
    return -np.concatenate([by_place, by_place @ turning(arms)], axis=-1), pinned.rays - np.stack(
        [x / z, y / z], axis=-1
    )


def turning(arms: Floats) -> Floats:
    """Derivatives (..., 3, 3) of points by a rotation vector about where ``arms`` (..., 3) begin."""
    by_turn = np.zeros((*arms.shape, 3))
    x, y, z = np.moveaxis(arms, -1, 0)
    by_turn[..., 0, 1], by_turn[..., 0, 2] = z, -y
    by_turn[..., 1, 0], by_turn[..., 1, 2] = -z, x
    by_turn[..., 2, 0], by_turn[..., 2, 1] = y, -x
    return by_turn


def _solved(normal: Floats, right: Floats) -> Floats:
    return np.asarray(np.linalg.solve(normal + STEADY * np.diag(np.diag(normal)), right), np.float64)


def moved(T: Pose, move: Floats) -> Pose:
    """The pose shifted (m) and turned (rad) about the parent's axes."""
    return Pose.from_matrix(exp_rotation(move[3:]) @ T.rotation, T.position + move[:3])


def apart(here: Pose, there: Pose) -> Floats:
    """The move (6,), m and rad about the parent's axes, from one pose to another."""
    return np.concatenate([there.position - here.position, log_rotation(there.rotation @ here.rotation.T)])


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where the camera is taken to be in a frame: T_world_camera, its ``covariance`` (6, 6), m and rad about the
    world's axes, and the part of it that is new from frame to frame, ``noise`` (6, 6). ``at_ns`` is the frame's time,
    ``seen_ns`` that of the newest frame in which a constellation that stands still was located, 0: none was yet.
    ``kick`` (6,) is how far it jumped in this frame, none otherwise.
    """

    T_world_camera: Pose
    covariance: Floats
    noise: Floats
    at_ns: int
    seen_ns: int
    kick: Floats | None = None
