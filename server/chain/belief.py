"""What is believed of robots' motion: an interacting multiple model filter (IMM) over `manners`, all robots at once.

Source: Blom, Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching coefficients",
IEEE Trans. Automatic Control 33, 1988.
"""

from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.chain.manners import COUNT, USUAL, changes, moved_on, unforeseen
from asterism.server.chain.turns import exp_rotations, hats, log_rotations
from asterism.server.pose.track import UNKNOWN_SPEED, UNKNOWN_TURN

LEAST = 1e-12  # likely every manner stays


class Sight(NamedTuple):
    """Measured poses of n robots: ``positions`` (n, 3) m, ``rotations`` (n, 3, 3), the part of their covariances that
    is new in every frame, ``noise`` (n, 6, 6), and ``axes`` (n, 3), the normals of their planes, in their own axes.
    """

    positions: Floats
    rotations: Floats
    noise: Floats
    axes: Floats


class Belief(NamedTuple):
    """The motion of n robots in m manners: ``rotations`` (n, 3, 3), against which states tell theirs; ``states``
    (n, m, 12) as in `manners`, ``covariances`` (n, m, 12, 12), and how likely the manners are, ``weights`` (n, m).
    """

    rotations: Floats
    states: Floats
    covariances: Floats
    weights: Floats


class Step(NamedTuple):
    """How a belief went on to the next frame: after ``dt`` (n,) s, the reference turning at ``turn`` (n, 3) rad/s and,
    when the pose was seen, by ``shift`` (n, 3) rad; with ``wider`` (n, 6, 6) added to what was believed of the pose;
    ``normals`` (n, 3) of the planes and ``speeds`` (n,) m/s then; ``chi2`` (n,) of the pose by the manner that
    foresaw it best.
    """

    dt: Floats
    turn: Floats
    shift: Floats
    wider: Floats
    normals: Floats
    speeds: Floats
    chi2: Floats


def begin(sight: Sight) -> Belief:
    """One pose each, moving at any speed."""
    n = len(sight.positions)
    states, covariance = np.zeros((n, COUNT, 12)), np.zeros((n, 12, 12))
    states[..., :3] = sight.positions[:, None]
    covariance[:, :6, :6] = sight.noise
    speed, turn = np.arange(6, 9), np.arange(9, 12)
    covariance[:, speed, speed], covariance[:, turn, turn] = UNKNOWN_SPEED**2, UNKNOWN_TURN**2
    covariances = np.repeat(covariance[:, None], COUNT, axis=1)
    return Belief(sight.rotations.copy(), states, covariances, np.tile(USUAL, (n, 1)))


def go_on(before: Belief, sight: Sight, dt: Floats, wider: Floats, doubt: Floats) -> tuple[Belief, Step]:
    """The belief ``dt`` (n,) s later, after poses were seen. ``wider`` (n, 6, 6) is added to what is believed of poses
    first; ``doubt`` (n, 6, 6) counts in `Step.chi2` alone.
    """
    mixed = _mixed(before, changes(dt))
    turn = (mixed.weights[:, None] @ mixed.states[..., 9:])[:, 0]
    states, by_state = moved_on(mixed.states, turn, dt)
    rotations = exp_rotations(turn * dt[:, None]) @ before.rotations
    normals = (rotations @ sight.axes[..., None])[..., 0]
    speeds = np.linalg.norm(mixed.weights[:, None] @ mixed.states[..., 6:9], axis=(1, 2))
    covariances = by_state @ mixed.covariances @ np.swapaxes(by_state, -1, -2) + unforeseen(normals, speeds, dt)
    covariances[..., :6, :6] += wider[:, None]
    after, chi2 = _corrected(Belief(rotations, states, covariances, mixed.weights), sight, doubt)
    # The reference follows, so that rotations against it stay small.
    shift = (after.weights[:, None] @ after.states[..., 3:6])[:, 0]
    after.states[..., 3:6] -= shift[:, None]
    return after._replace(rotations=exp_rotations(shift) @ rotations), Step(
        dt, turn, shift, wider, normals, speeds, chi2
    )


def _corrected(foreseen: Belief, sight: Sight, doubt: Floats) -> tuple[Belief, Floats]:
    """The belief by what was seen, and `Step.chi2`."""
    rotations, states, covariances, weights = foreseen
    turned = log_rotations(sight.rotations @ np.swapaxes(rotations, -1, -2))
    off = (np.concatenate([sight.positions, turned], axis=-1)[:, None] - states[..., :6])[..., None]
    spreads = covariances[..., :6, :6] + sight.noise[:, None]
    inverse = np.linalg.inv(spreads)
    squared = np.sum(off * (inverse @ off), axis=(-1, -2))
    gains = covariances[..., :6] @ inverse
    # Joseph's form: stays symmetric and positive.
    back = np.swapaxes(gains, -1, -2)
    kept = covariances - gains @ covariances[..., :6, :]
    kept = kept - kept[..., :6] @ back + gains @ sight.noise[:, None] @ back
    likely = np.log(weights) - 0.5 * (squared + np.linalg.slogdet(spreads)[1])
    weights = np.exp(likely - likely.max(axis=1, keepdims=True))
    weights = np.maximum(weights / weights.sum(axis=1, keepdims=True), LEAST)
    chi2 = np.sum(off * np.linalg.solve(spreads + doubt[:, None], off), axis=(-1, -2)).min(axis=1)
    return Belief(rotations, states + (gains @ off)[..., 0], kept, weights), chi2


def together(belief: Belief) -> tuple[Floats, Floats]:
    """State (n, 12) and covariance (n, 12, 12) of all manners together, the spread of their means included."""
    mean = belief.weights[:, None] @ belief.states
    off = belief.states - mean
    n, m = belief.weights.shape
    spread = belief.covariances + off[..., :, None] * off[..., None, :]
    covariance = (belief.weights[:, None] @ spread.reshape(n, m, 144)).reshape(n, 12, 12)
    return mean[:, 0], 0.5 * (covariance + np.swapaxes(covariance, -1, -2))


def twists(rotations: Floats, states: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """How robots move in their own axes (n, 6), m/s and rad/s, and its covariance (n, 6, 6), from states (n, 12) with
    covariances (n, 12, 12), the robots being turned by ``rotations`` (n, 3, 3).

    Where the orientation is off by e and the parent's velocity by d, the robot's is off by R^T (d + v x e).
    """
    back = np.swapaxes(rotations, -1, -2)
    told = (back[:, None] @ states[:, 6:].reshape(-1, 2, 3, 1)).reshape(-1, 6)
    by_state = np.zeros((len(states), 6, 12))
    for first in (0, 3):
        rows, rate = slice(first, first + 3), slice(first + 6, first + 9)
        by_state[:, rows, 3:6] = back @ hats(states[:, rate])
        by_state[:, rows, rate] = back
    spread = by_state @ covariances @ np.swapaxes(by_state, -1, -2)
    return told, 0.5 * (spread + np.swapaxes(spread, -1, -2))


def mix(weights: Floats, states: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """States (n, i, 12) and covariances (n, i, 12, 12) mixed anew, to j of them, by ``weights`` (n, j, i)."""
    n, j, i = weights.shape
    middle = states.mean(axis=1, keepdims=True)
    off = states - middle
    spread = covariances + off[..., :, None] * off[..., None, :]
    mean = weights @ off
    out = (weights @ spread.reshape(n, i, 144)).reshape(n, j, 12, 12) - mean[..., :, None] * mean[..., None, :]
    return middle + mean, out


def _mixed(before: Belief, becomes: Floats) -> Belief:
    """The belief as every manner begins with it, ``becomes`` (n, m, m) being how likely one becomes another."""
    joint = becomes * before.weights[..., None]
    weights = joint.sum(axis=1)
    shares = np.swapaxes(joint / weights[:, None], 1, 2)
    return Belief(before.rotations, *mix(shares, before.states, before.covariances), weights)
