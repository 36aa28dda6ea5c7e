"""Smoothing splines over a plane: tensor products of uniform cubic B-splines, and what their roughness is.

Source: Eilers, Marx: "Flexible smoothing with B-splines and penalties", 1996, with the penalty of Wahba's thin plates
of order 3 in its place ("Spline models for observational data", 1990): what a quadric cannot follow is rough.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from asterism.protocol.geometry import Floats

LOCAL = 4  # B-splines along an axis that are not 0 at a place
INTERVALS = 26  # along the longer axis, at first
LEAST_STEP_M = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Knots: ``origin`` (2,) m, ``step`` m, so many intervals along x and y, ``cells`` (2,)."""

    origin: Floats
    step: float
    cells: tuple[int, int]

    @staticmethod
    def over(xy: Floats, margin_m: float, intervals: int = INTERVALS) -> "Grid":
        """A grid over places (n, 2) m and a margin about them, so many intervals long or less."""
        low, high = xy.min(axis=0) - margin_m, xy.max(axis=0) + margin_m
        step = max(LEAST_STEP_M, float((high - low).max()) / intervals)
        nx, ny = (int(c) for c in np.ceil((high - low) / step))
        middle = 0.5 * (low + high)
        return Grid(middle - 0.5 * step * np.array([nx, ny]), step, (nx, ny))

    @property
    def numbers(self) -> int:
        """How many coefficients a spline over it has."""
        return (self.cells[0] + LOCAL - 1) * (self.cells[1] + LOCAL - 1)

    def columns(self, xy: Floats) -> tuple[csr_array, csr_array, csr_array]:
        """What each coefficient adds at places (n, 2): to the height, and to the slopes along x and y (n, numbers)."""
        place = (xy - self.origin) / self.step
        cell = np.clip(np.floor(place), 0, np.array(self.cells) - 1).astype(np.int64)
        (wx, dx), (wy, dy) = (_weights((place - cell)[:, axis]) for axis in (0, 1))
        across = self.cells[1] + LOCAL - 1
        which = (cell[:, 0, None] + np.arange(LOCAL))[:, :, None] * across + (cell[:, 1, None] + np.arange(LOCAL))[
            :, None
        ]
        rows = np.arange(0, len(xy) * LOCAL**2 + 1, LOCAL**2)

        def matrix(by_x: Floats, by_y: Floats) -> csr_array:
            values = (by_x[:, :, None] * by_y[:, None, :]).ravel()
            return csr_array((values, which.ravel(), rows), shape=(len(xy), self.numbers))

        return matrix(wx, wy), matrix(dx / self.step, wy), matrix(wx, dy / self.step)

    def roughness(self) -> Floats:
        """The quadratic form (numbers, numbers) of the integral of all squared third derivatives, 1/m^2."""
        (x0, x1, x2, x3), (y0, y1, y2, y3) = (_grams(cells, self.step) for cells in self.cells)
        rough: Floats = np.kron(x3, y0) + 3.0 * np.kron(x2, y1) + 3.0 * np.kron(x1, y2) + np.kron(x0, y3)
        return rough


def _weights(t: Floats) -> tuple[Floats, Floats]:
    """The four B-splines at t from 0 to 1 of an interval (n, 4), and their derivatives by t."""
    s = 1.0 - t
    values = np.stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3], axis=-1) / 6.0
    slopes = np.stack([-(s**2) / 2, (3 * t**2 - 4 * t) / 2, (-3 * s**2 + 4 * s) / 2, t**2 / 2], axis=-1)
    return values, slopes


def _grams(cells: int, step: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Integrals of the products of all B-splines of an axis, and of their first, second and third derivatives."""
    nodes, share = np.polynomial.legendre.leggauss(LOCAL)
    t, share = 0.5 * (nodes + 1.0), 0.5 * share
    values, slopes = _weights(t)
    bends = np.stack([1.0 - t, 3 * t - 2, 1 - 3 * t, t], axis=-1)
    thirds = np.broadcast_to(np.array([-1.0, 3.0, -3.0, 1.0]), bends.shape)
    grams = []
    for order, part in enumerate((values, slopes, bends, thirds)):
        local = step ** (1 - 2 * order) * (part * share[:, None]).T @ part
        gram = np.zeros((cells + LOCAL - 1,) * 2)
        for cell in range(cells):
            gram[cell : cell + LOCAL, cell : cell + LOCAL] += local
        grams.append(gram)
    return grams[0], grams[1], grams[2], grams[3]
