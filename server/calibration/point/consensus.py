"""A first guess of a point that rests at one place in half of the frames at least, and at which it does so.

Three frames whose tilts differ say where such a point would be; many threes are tried, and the one with which most
frames agree is taken (RANSAC, scored as by Torr and Zisserman, "MLESAC", 2000, with the best refined). Of a plate's two
tilts either may be the right one: frames agree by the one that does.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.calibration.point.views import Views

THREES = 1000
MOST_FRAMES = 100  # that threes are judged by
BEST = 20  # threes that are refined
REFINED = 4  # times
AGREES = 16.3  # squared offset by its covariance: 99.9 % of chi squared for three numbers
# One sigma, m, of what poses are off beside their covariances, before anything is fitted; the larger one is for LEDs
# measured with a ruler.
LEEWAYS_M = (0.3e-3, 1e-3)
STEADY = 1e-9  # of a normal matrix, so that threes which determine nothing do no harm


class Guess(NamedTuple):
    """``point`` (3,) m in the robot's frame and its ``place`` (3,) m in the camera's; ``agree`` (n,) which frames do,
    by which of their ``tilts`` (n,).
    """

    point: Floats
    place: Floats
    agree: NDArray[np.bool_]
    tilts: NDArray[np.intp]


def guess(views: Views) -> Guess:
    """The point with which most frames agree, with more leeway where those are not half of them."""
    first = _guess(views, LEEWAYS_M[0])
    return first if 2 * first.agree.sum() >= len(first.agree) else _guess(views, LEEWAYS_M[1])


def _guess(views: Views, leeway_m: float) -> Guess:
    """The same for one leeway; which threes are tried does not depend on chance."""
    rng = np.random.default_rng(0)
    n = len(views.ts)
    judges = views.of(np.unique(np.linspace(0, n - 1, MOST_FRAMES).round().astype(np.int64)))
    threes = rng.integers(0, n, (THREES, 3))
    tilts = rng.integers(0, 2, threes.shape)
    tried = _solved(views.rotations[threes, tilts], views.ts[threes, tilts], np.ones(threes.shape))
    costs = np.array([np.minimum(_squares(judges, one, leeway_m).min(axis=1), AGREES).sum() for one in tried])
    refined = [_refined(views, tried[k], leeway_m) for k in np.argsort(costs)[:BEST]]
    best = min(refined, key=lambda one: float(np.minimum(_squares(views, one, leeway_m).min(axis=1), AGREES).sum()))
    squares = _squares(views, best, leeway_m)
    return Guess(best[:3], best[3:], squares.min(axis=1) < AGREES, squares.argmin(axis=1))


def _solved(rotations: Floats, ts: Floats, weights: Floats) -> Floats:
    """Point and place (..., 6) that fit poses (..., m, 3, 3), (..., m, 3) best, weighted (..., m)."""
    m = rotations.shape[-3]
    by_all = np.concatenate([rotations, np.broadcast_to(-np.eye(3), rotations.shape)], axis=-1)
    weighted = np.swapaxes((by_all * weights[..., None, None]).reshape(*rotations.shape[:-3], 3 * m, 6), -1, -2)
    normal = weighted @ by_all.reshape(*rotations.shape[:-3], 3 * m, 6) + STEADY * np.eye(6)
    found: Floats = np.linalg.solve(normal, -weighted @ ts.reshape(*ts.shape[:-2], 3 * m, 1))[..., 0]
    return found


def _squares(views: Views, found: Floats, leeway_m: float) -> Floats:
    """Squared offsets (n, 2) by their covariances, of both tilts, for point and place (6,)."""
    arms = views.rotations @ found[:3]
    offsets = arms + views.ts - found[3:]
    a, b, c = arms[:, 0, 0], arms[:, 0, 1], arms[:, 0, 2]
    zero = np.zeros_like(a)
    turn = np.stack([zero, c, -b, -c, zero, a, b, -a, zero], axis=-1).reshape(-1, 3, 3)
    by_pose = np.concatenate([np.broadcast_to(np.eye(3), turn.shape), turn], axis=-1)
    spreads = by_pose @ views.covariances @ np.swapaxes(by_pose, 1, 2) + leeway_m**2 * np.eye(3)
    squares: Floats = np.einsum("nti,nij,ntj->nt", offsets, np.linalg.inv(spreads), offsets)
    return squares


def _refined(views: Views, found: Floats, leeway_m: float) -> Floats:
    """Point and place (6,) by all frames that agree with them, the less the farther they are off."""
    rows = np.arange(len(views.ts))
    for _ in range(REFINED):
        squares = _squares(views, found, leeway_m)
        tilts, least = squares.argmin(axis=1), squares.min(axis=1)
        weights = np.where(least < 2.0 * AGREES, 1.0 / (1.0 + least), 0.0)
        if np.count_nonzero(weights) < 3:
            break
        found = _solved(views.rotations[rows, tilts], views.ts[rows, tilts], weights)
    return found
