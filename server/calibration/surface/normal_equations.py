"""The most likely surface by weighted touches, and how sure it is: a linear model with normal priors, solved whole.

Numbers of the surface are held by their roughness, times a stiffness, causes by what is known of them. The covariance
of such a spline tells of its noise and of what a spline so stiff cannot follow (Nychka, "Bayesian confidence intervals
for smoothing splines", 1988).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from asterism.protocol.geometry import Floats
from asterism.server.calibration.surface.shapes import Shape
from asterism.server.calibration.surface.touches import Equations

OPEN_M = 0.01  # one sigma of a robot's offset of which nothing is known yet


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Normal equations of touches, without priors: ``matrix`` (q, q), ``vector`` (q,)."""

    matrix: Floats
    vector: Floats

    @staticmethod
    def of(equations: Equations, weights: Floats) -> "Sums":
        """Of all touches, each with its weight (n,), 1/m^2."""
        rows = equations.rows
        weighted = rows.multiply(weights[:, None]).tocsr()
        return Sums((rows.T @ weighted).toarray(), weighted.T @ equations.heights)

    def without(self, other: "Sums") -> "Sums":
        """Those of the others' touches."""
        return Sums(self.matrix - other.matrix, self.vector - other.vector)


@dataclass(frozen=True, slots=True)
class Priors:
    """What is known before: the spline's ``stiffness``, and one sigma of robots' offsets, ``offset_m``."""

    stiffness: float
    offset_m: float = OPEN_M

    def information(self, shape: Shape, causes: int, robots: int) -> Floats:
        """Of all numbers (q, q)."""
        p = shape.numbers
        out = np.zeros((p + causes * robots,) * 2)
        out[:p, :p] = self.stiffness * shape.penalty
        own = np.ones((robots, causes))
        own[:, -1] = self.offset_m**-2
        out[np.arange(p, len(out)), np.arange(p, len(out))] = own.ravel()
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The most likely numbers (q,), and the ``covariance`` (q, q), None where it was not asked for."""

    numbers: Floats
    covariance: Floats | None


def solve(sums: Sums, information: Floats, sure: bool = False) -> Solved:
    """The most likely numbers, with their covariance where it matters how ``sure`` they are."""
    matrix = sums.matrix + information
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    factor = cho_factor(matrix * np.outer(scale, scale) + 1e-12 * np.eye(len(matrix)), lower=True)
    numbers = scale * cho_solve(factor, scale * sums.vector)
    if not sure:
        return Solved(numbers, None)
    return Solved(numbers, cho_solve(factor, np.eye(len(matrix))) * np.outer(scale, scale))
