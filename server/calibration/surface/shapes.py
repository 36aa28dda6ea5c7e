"""Kinds of surfaces whose heights are fitted: linear in their numbers, over a base that is there already."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import HEIGHTS, PLANE, QUADRIC, Quadric
from asterism.server.calibration.surface.splines import Grid

PARABOLOID = "paraboloid"  # z over x, y of degree 2; a quadric as well, in a rig
Columns = tuple[csr_array, csr_array, csr_array]  # (n, p) of heights, and of slopes along x and y
LOOSE = 3.0  # one sigma of a quadric's numbers, in units of its size: they are of the order of 1 at most
_STEP = 1e-5  # of numeric slopes, in units of its size


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Heights over x, y: those of ``base``, and ``columns`` times as many numbers as ``penalty`` (p, p) has rows, which
    is what of them is rough, 0 of what costs nothing.
    """

    kind: str
    columns: Callable[[Floats], Columns]
    penalty: Floats
    base: Callable[[Floats], tuple[Floats, Floats]] = field(default=lambda xy: (np.zeros(len(xy)), np.zeros_like(xy)))

    @property
    def numbers(self) -> int:
        """How many."""
        return len(self.penalty)


def plane(xy: Floats) -> Shape:
    """Planes, about the middle of places (n, 2) m."""
    return Shape(PLANE, _polynomial(xy, [(0, 0), (1, 0), (0, 1)]), np.zeros((3, 3)))


def paraboloid(xy: Floats) -> Shape:
    """Heights of degree 2."""
    return Shape(PARABOLOID, _polynomial(xy, [(0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1)]), np.zeros((6, 6)))


def spline(grid: Grid) -> Shape:
    """Splines over a grid; their penalty is for one unit of stiffness."""
    return Shape(HEIGHTS, grid.columns, grid.roughness())


def middle_and_size(xy: Floats) -> tuple[Floats, float]:
    """About what, m, and in what unit, m, numbers are of the order of 1."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    return 0.5 * (low + high), 0.5 * float((high - low).max())


def _polynomial(xy: Floats, powers: list[tuple[int, int]]) -> Callable[[Floats], Columns]:
    about, size = middle_and_size(xy)

    def columns(places: Floats) -> Columns:
        x, y = ((places - about) / size).T
        values = [x**a * y**b for a, b in powers]
        by_x = [a * x ** max(a - 1, 0) * y**b / size for a, b in powers]
        by_y = [b * x**a * y ** max(b - 1, 0) / size for a, b in powers]
        return tuple(csr_array(np.stack(part, axis=-1)) for part in (values, by_x, by_y))  # type: ignore[return-value]

    return columns


def polynomial_quadric(xy: Floats, numbers: Floats) -> Quadric:
    """What `plane` or `paraboloid` of those places is with those numbers (3,) or (6,)."""
    about, size = middle_and_size(xy)
    one, x, y, xx, yy, xy_ = [*numbers, 0.0, 0.0, 0.0][:6]
    bends = np.array([-xx, -yy, 0.0, -xy_, 0.0, 0.0]) / size
    return Quadric(np.array([0.0, -x / size, -y / size, 1.0, *bends / size]) + 0.0, np.array([*about, one]))


def whole_quadric(base: Quadric, size: float) -> Shape:
    """Quadrics near a ``base`` whose z counts once: all ten terms but that of z may change."""

    def terms_of(places: Floats) -> Floats:
        heights, *_ = base.ground(places)
        x, y, z = (np.column_stack([places, heights]) - base.about).T / size
        *_, zz, _, xz, yz = base.terms
        grows = 1.0 + size * (2.0 * zz * z + xz * x + yz * y)  # of the sum, with z
        out: Floats = -size * np.stack([np.ones_like(x), x, y, x * x, y * y, z * z, x * y, x * z, y * z], axis=-1)
        out /= grows[:, None]
        return out

    def columns(places: Floats) -> Columns:
        h = _STEP * size
        by = [(terms_of(places + step) - terms_of(places - step)) / (2.0 * h) for step in h * np.eye(2)]
        return csr_array(terms_of(places)), csr_array(by[0]), csr_array(by[1])

    def heights(places: Floats) -> tuple[Floats, Floats]:
        return base.ground(places)[:2]

    return Shape(QUADRIC, columns, np.eye(9) / LOOSE**2, heights)


def moved_quadric(base: Quadric, size: float, numbers: Floats) -> Quadric:
    """The quadric of `whole_quadric` at those numbers (9,)."""
    unit = np.array([size, 1.0, 1.0, *[1.0 / size] * 6])
    terms = base.terms.copy()
    terms[[0, 1, 2, 4, 5, 6, 7, 8, 9]] += numbers * unit
    return Quadric(terms, base.about)
