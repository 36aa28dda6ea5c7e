"""A surface of one kind fitted to touches, of which some touch nothing: lifted robots, wrong tilts."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.calibration.surface.normal_equations import Priors, Solved, Sums, solve
from asterism.server.calibration.surface.shapes import Shape
from asterism.server.calibration.surface.touches import Equations, Touches

MEDIAN = 0.4549  # of the square of a normal deviate
LEAST_FACTOR = 0.05  # of variances: what residuals of few numbers may pretend
FAR = 4.0  # sigmas, from which on a touch is none
STRETCH = 9  # touches of one robot after another that are judged together
STRETCH_FAR = 5.0  # sigmas of their mean
LOOK = 30  # touches after another within which errors may stay
ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """What heights scatter: ``factors`` (r,) of the variances that a robot's poses tell, ``stays`` how many times more
    the mean of many is off than if errors were new in every touch.
    """

    factors: Floats
    stays: float = 1.0

    def variances(self, touches: Touches, equations: Equations) -> Floats:
        """Of every touch's height, m^2 (n,)."""
        out: Floats = self.factors[touches.robots] * equations.variances
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A ``shape`` with its ``numbers`` (p,), every robot's ``causes`` (r, k), the last its offset, m; the
    ``covariance`` (p + r k, p + r k) of all. ``residuals`` (n,) m of heights, offsets taken off, and ``variances``
    (n,) m^2 of their noise; ``used`` (n,) which touches count.
    """

    shape: Shape
    numbers: Floats
    causes: Floats
    covariance: Floats | None
    residuals: Floats
    variances: Floats
    used: NDArray[np.bool_]
    noise: Noise

    def heights(self, xy: Floats) -> tuple[Floats, Floats]:
        """Of places (n, 2): heights (n,) m, and slopes (n, 2)."""
        by, by_x, by_y = self.shape.columns(xy)
        base, slopes = self.shape.base(xy)
        return base + by @ self.numbers, slopes + np.column_stack([by_x @ self.numbers, by_y @ self.numbers])

    def sigmas(self, xy: Floats) -> tuple[Floats, Floats]:
        """One sigma of heights (n,) m, and of the slopes (n, 2)."""
        assert self.covariance is not None
        p = self.shape.numbers
        own = self.covariance[:p, :p]
        sigmas = [np.sqrt(np.maximum(part.multiply(part @ own).sum(axis=1), 0.0)) for part in self.shape.columns(xy)]
        return sigmas[0], np.column_stack(sigmas[1:])


def fitted(touches: Touches, shape: Shape, priors: Priors, used: NDArray[np.bool_], noise: Noise) -> Fitted:
    """The most likely surface by those touches, with its covariance."""
    numbers: Floats | None = None
    for _ in range(2):  # slopes tell what moves a touch up
        equations = Equations.of(touches, shape, numbers)
        variances = noise.variances(touches, equations)
        weights = used / variances
        found = _solve(touches, shape, Sums.of(equations, weights), priors, True)
        numbers = found.numbers[: shape.numbers]
    assert found.covariance is not None
    covariance = noise.stays * found.covariance
    return _fitted(shape, replace(found, covariance=covariance), touches, (equations, variances, used), noise)


def settled(touches: Touches, shape: Shape, priors: Priors, start: Floats | None = None) -> Fitted:
    """The surface that most touches agree on, and which those are: weights fall with the residuals (Cauchy's), whose
    scale is that of the middle half; then those that are farther off than noise can be are left out, alone and in
    stretches. ``start`` (n,) are residuals to begin with.
    """
    numbers: Floats | None = None
    residuals = np.zeros(len(touches)) if start is None else start
    for turn in range(ROUNDS):
        equations = Equations.of(touches, shape, numbers)
        scales = _scales(touches, equations, residuals)
        variances = scales[touches.robots] * equations.variances
        given = turn > 0 or start is not None
        weights = 1.0 / (variances * (1.0 + (residuals**2 / (4.0 * variances) if given else 0.0)))
        found = _solve(touches, shape, Sums.of(equations, weights), priors, False)
        residuals = equations.heights - equations.rows @ found.numbers
        numbers = found.numbers[: shape.numbers]
    used = ~_off(touches, residuals, variances)
    noise = noise_of(touches, residuals, equations.variances, used)
    return _fitted(shape, found, touches, (equations, noise.variances(touches, equations), used), noise)


def noise_of(
    touches: Touches, residuals: Floats, variances: Floats, used: NDArray[np.bool_], numbers: float = 0.0
) -> Noise:
    """What residuals that are used scatter beside what poses tell, robot by robot, and how long errors stay; so many
    ``numbers`` were fitted to them.
    """
    factors = np.ones(touches.count)
    fewer = max(1.0 - numbers / max(used.sum(), 1), 0.1)
    for robot in range(touches.count):
        mine = used & (touches.robots == robot)
        if mine.any():
            factors[robot] = max(float(np.mean(residuals[mine] ** 2 / variances[mine])) / fewer, LEAST_FACTOR)
    return Noise(factors, _stays(touches, residuals / np.sqrt(factors[touches.robots] * variances), used))


def _solve(touches: Touches, shape: Shape, sums: Sums, priors: Priors, sure: bool) -> Solved:
    return solve(sums, priors.information(shape, touches.causes, touches.count), sure)


def _fitted(
    shape: Shape,
    found: Solved,
    touches: Touches,
    by: tuple[Equations, Floats, NDArray[np.bool_]],
    noise: Noise,
) -> Fitted:
    equations, variances, used = by
    p = shape.numbers
    residuals = equations.heights - equations.rows @ found.numbers
    causes = found.numbers[p:].reshape(touches.count, touches.causes)
    return Fitted(shape, found.numbers[:p], causes, found.covariance, residuals, variances, used, noise)


def _scales(touches: Touches, equations: Equations, residuals: Floats) -> Floats:
    """How many times larger than told the variances of the middle half of a robot's residuals are (r,)."""
    scales = np.ones(touches.count)
    for robot in range(touches.count):
        mine = touches.robots == robot
        if mine.any():
            ratio = float(np.median(residuals[mine] ** 2 / equations.variances[mine])) / MEDIAN
            scales[robot] = max(ratio, LEAST_FACTOR)
    return scales


def _off(touches: Touches, residuals: Floats, variances: Floats) -> NDArray[np.bool_]:
    """Which touches are none: farther off than noise can be, alone or in a stretch of one robot's."""
    alone = residuals / np.sqrt(variances)
    off: NDArray[np.bool_] = np.abs(alone) > FAR
    stays = _stays(touches, alone, ~off)
    for robot in range(touches.count):
        mine = np.flatnonzero(touches.robots == robot)
        if len(mine) < 2 * STRETCH:
            continue
        ordered = mine[np.argsort(touches.times_s[mine], kind="stable")]
        summed = np.convolve(np.clip(alone[ordered], -FAR, FAR), np.ones(STRETCH), mode="valid")
        far = np.abs(summed) > STRETCH_FAR * np.sqrt(STRETCH * stays)
        off[ordered[STRETCH // 2 : STRETCH // 2 + len(far)][far]] = True
    return off


def _stays(touches: Touches, alone: Floats, used: NDArray[np.bool_]) -> float:
    """How many times more the mean of touches one after another is off than if errors were new in each: one and twice
    the sum of their correlations, as far as these are above chance; never less than one.

    Source: Sokal, "Monte Carlo methods in statistical mechanics", 1996: summed up to where they vanish.
    """
    products, counts = np.zeros(LOOK), np.zeros(LOOK)
    for robot in range(touches.count):
        mine = np.flatnonzero(used & (touches.robots == robot))
        values = alone[mine[np.argsort(touches.times_s[mine], kind="stable")]]
        for lag in range(min(LOOK, len(values))):
            products[lag] += float(values[lag:] @ values[: len(values) - lag])
            counts[lag] += len(values) - lag
    if products[0] <= 0.0:
        return 1.0
    correlations = products[1:] / np.maximum(counts[1:], 1.0) / (products[0] / counts[0])
    above = correlations > 2.0 / np.sqrt(np.maximum(counts[1:], 1.0))
    last = int(np.argmin(above)) if not above.all() else len(above)
    return 1.0 + 2.0 * float(correlations[:last].sum())
