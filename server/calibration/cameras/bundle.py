"""Bundle adjustment of cameras: their places, clocks, lenses on request, LEDs and how robots move, fitted to all spots.

Method: Levenberg-Marquardt on the normal equations with each moment's motion eliminated (Schur complement; Triggs,
McLauchlan, Hartley, Fitzgibbon: "Bundle adjustment - a modern synthesis", 2000, section 6). The first camera's frame
and clock are the origin. LEDs are where the rig has them but for an error whose size is known beforehand, and by that
the scale is; first with Cauchy weights, then what lies far off is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Robot
from asterism.server.calibration.cameras.moments import Bools, Moments
from asterism.server.calibration.cameras.motion import UNKNOWNS
from asterism.server.calibration.cameras.predicted import Belief, Layout, Predictor

ITERATIONS = 40
CONVERGED = 1e-7  # of the cost, relative
CAUCHY = 3.0  # sigmas: the residual that the robust loss gives half its weight
MEDIAN_CHI2 = 1.386  # of two degrees of freedom
MOST_DAMPING = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Before:
    """What is known before any spot tells: the inverse covariance (p, p) of what moments share, as `Layout` orders it,
    about ``mean`` (p,), relative to the belief that a fit begins with.
    """

    information: Floats
    mean: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Normal equations of g moments, each of its motion (18), what is shared but for LEDs (q), its robot's LEDs (18)
    and the residuals (1): ``squares`` (g, w, w).
    """

    squares: Floats
    robots: "np.ndarray[tuple[int], np.dtype[np.int64]]"
    used: Bools
    layout: Layout

    def reduced(self, damping: float = 0.0) -> tuple[Floats, Floats, Floats, Floats]:
        """With the motion eliminated: matrix (p, p) and right side (p,) of what is shared, its diagonal before, and
        what leads back to the motion, (g, 18, w - 18).
        """
        own = self.squares[:, :UNKNOWNS, :UNKNOWNS].copy()
        diagonal = np.arange(UNKNOWNS)
        own[:, diagonal, diagonal] *= 1.0 + damping
        own[:, diagonal, diagonal] += np.where(self.used, 0.0, 1.0)
        back = np.asarray(np.linalg.solve(own, self.squares[:, :UNKNOWNS, UNKNOWNS:]), np.float64)
        rest = self.squares[:, UNKNOWNS:, UNKNOWNS:]
        left = rest - np.swapaxes(self.squares[:, :UNKNOWNS, UNKNOWNS:], 1, 2) @ back
        p, q = self.layout.width, self.layout.shared
        matrix, right, before = np.zeros((p, p)), np.zeros(p), np.zeros(p)
        for robot in np.unique(self.robots):
            total, alone = left[self.robots == robot].sum(axis=0), rest[self.robots == robot].sum(axis=0)
            rows = np.concatenate([np.arange(q), np.arange(p)[self.layout.of_robot(robot)]])
            matrix[np.ix_(rows, rows)] += total[:-1, :-1]
            right[rows] += total[:-1, -1]
            before[rows] += np.diag(alone)[:-1]
        return matrix, right, before, back

    def motion_moves(self, back: Floats, shared: Floats) -> Floats:
        """How the motion (g, 18) then moves."""
        q = self.layout.shared
        leds = shared[self.layout.of_leds].reshape(-1, 3 * LEDS)[self.robots]
        step = np.concatenate([np.tile(shared[:q], (len(leds), 1)), leds], axis=1)
        moves: Floats = back[:, :, -1] - (back[:, :, :-1] @ step[..., None])[..., 0]
        return np.where(self.used, moves, 0.0)


class Bundle:
    """The spots of moments, their robots, and what is free."""

    def __init__(self, robots: Sequence[Robot], moments: Moments, layout: Layout, held: Bools) -> None:
        """``held`` (p,): what moments share and is not to be fitted."""
        self.moments = moments
        self.layout = layout
        self.free = ~held
        self._predictor = Predictor(robots, moments)

    def squared(self, belief: Belief) -> Floats:
        """Squared residuals (g, n), in sigmas as the spots' covariances say; 0 where there is no spot."""
        off = self.off(belief)
        squared = (off[..., None, :] @ self.moments.information @ off[..., None])[..., 0, 0]
        return np.where(self.moments.lit, np.where(np.isfinite(squared), squared, 1e12), 0.0)

    def off(self, belief: Belief) -> Floats:
        """Residuals (g, n, 2), px; 0 where there is no spot."""
        off = np.nan_to_num(self._predictor.residuals(belief), posinf=1e6, neginf=-1e6, nan=1e6)
        return np.where(self.moments.lit[..., None], off, 0.0)

    def scale2(self, squared: Floats) -> float:
        """What squared residuals are, from their median, in those that they should be."""
        lit = self.moments.lit
        freedom = 1.0 - UNKNOWNS * len(self.moments) / max(2.0 * lit.sum(), 1.0)
        return max(float(np.median(squared[lit])) / MEDIAN_CHI2 / max(float(freedom), 0.2), 1e-12)

    def equations(self, belief: Belief, weights: Floats) -> Equations:
        """The normal equations at a belief; ``weights`` (g, n) of the spots."""
        layout = self.layout
        derivatives, off = self._predictor.linearised(belief, layout)
        roots = np.linalg.cholesky(self.moments.information + 1e-30 * np.eye(2)) * np.sqrt(weights)[..., None, None]
        joined = np.concatenate([derivatives, off[..., None]], axis=-1)
        joined = np.where(self.moments.lit[..., None, None], joined, 0.0)
        rows = (np.swapaxes(roots, -1, -2) @ joined).reshape(len(self.moments), -1, joined.shape[-1])
        squares = np.swapaxes(rows, 1, 2) @ rows
        return Equations(squares, self.moments.robots, belief.motion.used(), layout)

    def fitted(self, belief: Belief, before: Before, robust: bool, scale2: float | None = None) -> tuple[Belief, float]:
        """Levenberg-Marquardt from a belief to the minimum; returns it, and what the squares were divided by.

        ``before`` is relative to ``belief``; ``scale2`` None: from the residuals.
        """
        damping, so_far = 1e-4, np.zeros(self.layout.width)
        begun = scale2
        for _ in range(ITERATIONS):
            squared = self.squared(belief)
            scale2 = self.scale2(squared) if begun is None else begun
            weights = 1.0 / (1.0 + squared / (scale2 * CAUCHY**2)) if robust else np.ones_like(squared)
            cost = self._cost(squared, scale2, robust, before, so_far)
            equations = self.equations(belief, weights / scale2)
            better = False
            while not better and damping < MOST_DAMPING:
                step, moves = self._step(equations, before, so_far, damping)
                trial = belief.moved(self.layout, step, moves)
                new = self._cost(self.squared(trial), scale2, robust, before, so_far + step)
                better = new <= cost
                damping = max(damping / 10.0, 1e-10) if better else damping * 10.0
            if not better:
                break
            belief, so_far = trial, so_far + step
            if cost - new <= CONVERGED * cost:
                break
        return belief, float(scale2 or 1.0)

    def _step(self, equations: Equations, before: Before, so_far: Floats, damping: float) -> tuple[Floats, Floats]:
        matrix, right, diagonal, back = equations.reduced(damping)
        matrix = matrix + before.information + damping * np.diag(diagonal)
        right = right + before.information @ (before.mean - so_far)
        step = np.zeros(self.layout.width)
        rows = self.free
        step[rows] = solved(matrix[np.ix_(rows, rows)], right[rows])
        return step, equations.motion_moves(back, step)

    def _cost(self, squared: Floats, scale2: float, robust: bool, before: Before, so_far: Floats) -> float:
        apart = so_far - before.mean
        known = float(apart @ before.information @ apart)
        if not robust:
            return float(squared.sum()) / scale2 + known
        return float(CAUCHY**2 * np.log1p(squared / (scale2 * CAUCHY**2)).sum()) + known


def solved(matrix: Floats, right: Floats) -> Floats:
    """The solution of symmetric equations whose unknowns are of very unlike sizes."""
    sizes = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    scaled = matrix * np.outer(sizes, sizes) + 1e-13 * np.eye(len(matrix))
    across = sizes if right.ndim == 1 else sizes[:, None]
    return np.asarray(across * np.linalg.solve(scaled, across * right), np.float64)


def inverse(matrix: Floats) -> Floats:
    """The inverse of such a matrix."""
    return solved(matrix, np.eye(len(matrix)))


def with_moments(belief: Belief, rows: Bools) -> Belief:
    """The belief about some of the moments."""
    motion = belief.motion
    columns = {name: getattr(motion, name)[rows] for name in motion.__dataclass_fields__}
    return replace(belief, motion=type(motion)(**columns))
