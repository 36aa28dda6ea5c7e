"""How well a kind of surface tells touches that it was not fitted to: patches of it, and stretches of time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.calibration.surface.fitting import Noise
from asterism.server.calibration.surface.normal_equations import Priors, Sums, solve
from asterism.server.calibration.surface.shapes import Shape
from asterism.server.calibration.surface.touches import Equations, Touches

PARTS = 5  # of all patches, and of all stretches: each is left out once
PATCHES = 15  # along the longer side of where robots were
LEAST_PATCH_M = 0.02
STRETCH_S = 1.0
TAILS = 5.0  # degrees of freedom of Student's distribution, by which far ones count little
CHANCE = 2.0  # standard errors that a richer kind must be better by
STEP = 10.0**0.5  # from one stiffness tried to the next
FARTHEST = 12  # steps from 1


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Which block every touch is of, by patches and by stretches (2, n), and of which part every block is."""

    blocks: NDArray[np.int64]
    parts: NDArray[np.int64]
    count: int

    @staticmethod
    def of(touches: Touches) -> "Blocks":
        """Those of touches."""
        side = max(float(np.ptp(touches.xy, axis=0).max()) / PATCHES, LEAST_PATCH_M)
        cells = np.floor((touches.xy - touches.xy.min(axis=0)) / side).astype(np.int64)
        stretches = np.floor((touches.times_s - touches.times_s.min()) / STRETCH_S).astype(np.int64)
        patch = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
        stretch = np.unique(np.column_stack([touches.robots, stretches]), axis=0, return_inverse=True)[1].ravel()
        count = int(patch.max()) + 1
        blocks = np.stack([patch, stretch + count])
        total = int(blocks.max()) + 1
        order = np.random.default_rng(0)  # neighbours are not left out together
        parts = np.concatenate([order.permutation(count) % PARTS, PARTS + order.permutation(total - count) % PARTS])
        return Blocks(blocks, parts[blocks], total)


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """How far touches (2, n) m are off a surface that was fitted without their patch, and their stretch; ``losses``
    (blocks,) of each, the less the better.
    """

    shape: Shape
    priors: Priors
    residuals: Floats
    losses: Floats
    numbers: float

    @property
    def rms_m(self) -> float:
        """Over all."""
        return float(np.sqrt((self.residuals**2).mean()))

    def beats(self, simpler: "HeldOut") -> bool:
        """Whether it is better by more than chance."""
        gains = simpler.losses - self.losses
        return bool(gains.sum() > CHANCE * np.sqrt((gains**2).sum()))


def held_out(
    touches: Touches, shape: Shape, priors: Priors, blocks: Blocks, noise: Noise, about: Floats | None
) -> HeldOut:
    """Of touches that all count; slopes by the numbers ``about`` (p,)."""
    equations = Equations.of(touches, shape, about)
    variances = noise.variances(touches, equations)
    information = priors.information(shape, touches.causes, touches.count)
    sums = _sums(equations, 1.0 / variances, blocks)
    return _held_out(equations, variances, blocks, sums, (information, priors))


def stiffest(touches: Touches, shape: Shape, blocks: Blocks, noise: Noise, about: Floats | None) -> HeldOut:
    """Of a spline, with the stiffness by which held-out touches are told best."""
    equations = Equations.of(touches, shape, about)
    variances = noise.variances(touches, equations)
    sums = _sums(equations, 1.0 / variances, blocks)

    def at(stiffness: float) -> HeldOut:
        priors = Priors(stiffness)
        information = priors.information(shape, touches.causes, touches.count)
        return _held_out(equations, variances, blocks, sums, (information, priors))

    tried = {0: at(1.0)}
    for way in (1, -1):  # the loss falls to one side
        k = way
        while abs(k) <= FARTHEST and _loss(at_k := at(STEP**k)) < _loss(tried[k - way]):
            tried[k] = at_k
            k += way
    return min(tried.values(), key=_loss)


def _loss(found: HeldOut) -> float:
    return float(found.losses.sum())


def _sums(equations: Equations, weights: Floats, blocks: Blocks) -> list[Sums]:
    """Of all touches, then of every part."""
    parts = [(blocks.parts == part).any(axis=0) for part in range(2 * PARTS)]
    return [Sums.of(equations, weights), *(Sums.of(equations, weights * part) for part in parts)]


def _held_out(
    equations: Equations, variances: Floats, blocks: Blocks, sums: list[Sums], known: tuple[Floats, Priors]
) -> HeldOut:
    information, priors = known
    residuals = np.zeros(blocks.blocks.shape)
    for part, own in enumerate(sums[1:]):
        numbers = solve(sums[0].without(own), information).numbers
        way, rows = divmod(part, PARTS)[0], np.flatnonzero((blocks.parts == part).any(axis=0))
        residuals[way, rows] = equations.heights[rows] - equations.rows[rows] @ numbers
    losses = TAILS * np.log1p(residuals**2 / (TAILS * variances))
    summed = np.bincount(blocks.blocks.ravel(), losses.ravel(), blocks.count)
    p = equations.shape.numbers
    told = float(np.trace(np.linalg.solve(sums[0].matrix + information, sums[0].matrix)[:p, :p]))
    return HeldOut(equations.shape, priors, residuals, np.asarray(summed, np.float64), told)
