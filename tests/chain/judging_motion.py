"""Poses and velocities of drives as smoothing has them, and how far off they are."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.chain.belief import Belief, Sight, begin, go_on, together, twists
from asterism.server.chain.smooth import Seen
from asterism.server.chain.smooth_both import Look, joined
from asterism.server.chain.turns import exp_rotations, log_rotations
from tests.chain.drives import Drives


class Found(NamedTuple):
    """Errors (k, n, 6) of poses, m and rad, and of twists, m/s and rad/s, with their covariances (k, n, 6, 6)."""

    poses: Floats
    pose_covariances: Floats
    twists: Floats
    twist_covariances: Floats


def seen_of(
    positions: Floats, rotations: Floats, noise: Floats, stays: Floats, leds: Sequence[tuple[int, ...]]
) -> Seen:
    """Robots whose planes are their own x and y."""
    return Seen(Sight(positions, rotations, noise, np.tile([0.0, 0.0, 1.0], (len(noise), 1))), stays, leds)


def forwards(told: Drives, positions: Floats, rotations: Floats, covariances: Floats) -> Found:
    """All drives at once."""
    n = positions.shape[1]
    none, dt = np.zeros((n, 6, 6)), np.full(n, told.dt)
    axes = np.tile([0.0, 0.0, 1.0], (n, 1))
    belief: Belief | None = None
    rows = []
    for k, sight in enumerate(map(Sight, positions, rotations, covariances, [axes] * len(positions))):
        belief = begin(sight) if belief is None else go_on(belief, sight, dt, none, none)[0]
        state, spread = together(belief)
        turned = exp_rotations(state[:, 3:6]) @ belief.rotations
        twist, twist_spread = twists(turned, state, spread)
        off = _apart(state[:, :3], turned, told.positions[k], told.rotations[k])
        rows.append((off, spread[:, :6, :6], twist - told.twists[k], twist_spread))
    return Found(*(np.array(part) for part in zip(*rows, strict=True)))


def both_ways(told: Drives, positions: Floats, rotations: Floats, covariances: Floats) -> Found:
    """As `joined` has them."""
    n = positions.shape[1]
    names = [str(robot) for robot in range(n)]
    none, leds = np.zeros((n, 6, 6)), [(0,)] * n
    looks = (
        Look(1 + round(k * told.dt * 1e9), names, seen_of(positions[k], rotations[k], covariances[k], none, leds))
        for k in range(len(positions))
    )
    rows = []
    for k, answers in enumerate(joined(looks)):
        poses, spreads, velocities = zip(*(answers[name] for name in names), strict=True)
        turned, places = np.array([pose.rotation for pose in poses]), np.array([pose.position for pose in poses])
        twist = np.array([[*velocity.linear, *velocity.angular] for velocity in velocities])
        off = _apart(places, turned, told.positions[k], told.rotations[k])
        rows.append((off, spreads, twist - told.twists[k], [velocity.covariance for velocity in velocities]))
    return Found(*(np.array(part) for part in zip(*rows, strict=True)))


def pose_errors(told: Drives, positions: Floats, rotations: Floats) -> Floats:
    """Errors (k, n, 6) of poses, m and rad about the parent's axes."""
    return _apart(positions, rotations, told.positions, told.rotations)


def twist_errors(told: Drives, positions: Floats, rotations: Floats) -> Floats:
    """Errors (k - 1, n, 6) of differences of successive poses, taken for the twist at the later one."""
    back = np.swapaxes(rotations[1:], -1, -2)
    moved = back @ (positions[1:] - positions[:-1])[..., None]
    turned = back @ log_rotations(rotations[1:] @ np.swapaxes(rotations[:-1], -1, -2))[..., None]
    return np.concatenate([moved, turned], axis=-2)[..., 0] / told.dt - told.twists[1:]


def weighted(errors: Floats, covariances: Floats) -> Floats:
    """Squared errors (...,) weighted by their covariances: 6 on average, where these are meant."""
    return np.sum(errors * np.linalg.solve(covariances, errors[..., None])[..., 0], axis=-1)


def _apart(positions: Floats, rotations: Floats, true_positions: Floats, true_rotations: Floats) -> Floats:
    turned = log_rotations(rotations @ np.swapaxes(true_rotations, -1, -2))
    return np.concatenate([positions - true_positions, turned], axis=-1)
