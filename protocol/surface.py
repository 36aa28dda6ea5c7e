"""The surface that robots work on: heights over a plane, how steep they are, and how well that is known.

Every surface is a height z over the x and y of its own frame, whose z points out of the material: a `Quadric` (a plane
is one), or a `Heights` grid. Beyond its edge there is no surface.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose, frozen_array

TERMS = ("one", "x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz")  # of a quadric, in this order
PLANE, QUADRIC, HEIGHTS, STL = "plane", "quadric", "heights", "stl"  # what a rig may name
STEEPEST = 4.0  # slope: beyond 76 degrees a height over the plane says nothing
_STEPS = 8  # of Newton's method, from a point to the nearest of the surface
_SETTLED_M = 1e-9  # a step so short is followed by none that matters: the next is the square of it


class Ground(NamedTuple):
    """A surface under n places, in its own frame: ``heights`` (n,) m; ``slopes`` (n, 2) dz/dx, dz/dy; ``bends`` (n, 3)
    1/m, the second derivatives xx, xy, yy; one sigma of the height along the normal, ``sigmas`` (n,) m, and of the
    normal's direction, ``tilt_sigmas`` (n,) rad; whether there is a surface, ``inside`` (n,). Numbers of places that
    are not inside mean nothing.
    """

    heights: Floats
    slopes: Floats
    bends: Floats
    sigmas: Floats
    tilt_sigmas: Floats
    inside: NDArray[np.bool_]

    @property
    def normals(self) -> Floats:
        """(n, 3) unit, out of the material."""
        up = np.concatenate([-self.slopes, np.ones((len(self.slopes), 1))], axis=1)
        normals: Floats = up / np.linalg.norm(up, axis=1, keepdims=True)
        return normals


class Touch(NamedTuple):
    """Where n points touch a surface, in the frame that they are given in: the surface's nearest ``points`` (n, 3) m,
    the ``normals`` (n, 3) there; how far each is from it along the normal, ``distances`` (n,) m, positive out of the
    material; ``sigmas``, ``tilt_sigmas`` and ``inside`` as of `Ground`.
    """

    points: Floats
    normals: Floats
    distances: Floats
    sigmas: Floats
    tilt_sigmas: Floats
    inside: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Quadric:
    """The sheet of 0 = sum of ``terms`` (10,) times 1, x, y, z, xx, yy, zz, xy, xz, yz (`TERMS`) on which the sum grows
    with z; coordinates are m from ``about`` (3,).
    """

    terms: Floats
    about: Floats = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", frozen_array(self.terms, len(TERMS)))
        object.__setattr__(self, "about", frozen_array(self.about, 3))

    @staticmethod
    def plane(point: Floats, normal: Floats) -> "Quadric":
        """The plane through a point (3,) m, with its normal (3,) out of the material."""
        return Quadric(np.array([0.0, *normal, *np.zeros(6)]), point)

    @property
    def is_plane(self) -> bool:
        """Whether nothing of it bends."""
        return not self.terms[4:].any()

    def ground(self, xy: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
        """Heights, slopes, bends and inside, as of `Ground`, at places (n, 2) m."""
        one, tx, ty, tz, xx, yy, zz, t_xy, t_xz, t_yz = self.terms
        x, y = (xy - self.about[:2]).T
        b = tz + t_xz * x + t_yz * y  # of z; c holds no z
        c = one + tx * x + ty * y + xx * x * x + yy * y * y + t_xy * x * y
        with np.errstate(all="ignore"):
            root = np.sqrt(b * b - 4.0 * zz * c)  # the sum's derivative by z on the sheet where it grows
            z = -2.0 * c / (b + root)
            fx, fy = tx + 2.0 * xx * x + t_xy * y + t_xz * z, ty + 2.0 * yy * y + t_xy * x + t_yz * z
            zx, zy = -fx / root, -fy / root
            # Differentiate 0 = f(x, y, z(x, y)) twice.
            zxx = -(2.0 * xx + 2.0 * t_xz * zx + 2.0 * zz * zx * zx) / root
            zxy = -(t_xy + t_xz * zy + t_yz * zx + 2.0 * zz * zx * zy) / root
            zyy = -(2.0 * yy + 2.0 * t_yz * zy + 2.0 * zz * zy * zy) / root
            inside = (root > 0.0) & np.isfinite(z) & (np.hypot(zx, zy) <= STEEPEST)
        slopes, bends = np.column_stack([zx, zy]), np.column_stack([zxx, zxy, zyy])
        return z + self.about[2], slopes, bends, inside


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """A grid of heights: node (i, j) is at ``origin`` (2,) + (i, j) * ``step`` (2,), m; ``values`` (nx, ny) m, nan
    where there is no surface; ``sigmas`` (nx, ny) m, how well each is known.

    Between four nodes that all exist it is the bicubic of Keys ("Cubic convolution interpolation", 1981), which goes
    through the nodes with continuous slopes; a node that a cubic wants and that is not there lies on the straight line
    through the two before it.
    """

    origin: Floats
    step: Floats
    values: Floats
    sigmas: Floats

    def __post_init__(self) -> None:
        shape = np.shape(self.values)
        object.__setattr__(self, "origin", frozen_array(self.origin, 2))
        object.__setattr__(self, "step", frozen_array(self.step, 2))
        object.__setattr__(self, "values", frozen_array(self.values, *shape))
        object.__setattr__(self, "sigmas", frozen_array(self.sigmas, *shape))

    def ground(self, xy: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_], Floats]:
        """Heights, slopes, bends and inside, as of `Ground`, at places (n, 2) m; and sigmas (n,) m of them."""
        place = (xy - self.origin) / self.step
        last = np.array(self.values.shape) - 1
        cell = np.clip(np.floor(np.nan_to_num(place)), 0, np.maximum(last - 1, 0)).astype(np.int64)
        t = place - cell
        padded = np.pad(self.values, 2, constant_values=np.nan)
        i, j = cell.T
        patch = np.stack([[padded[i + 1 + a, j + 1 + b] for b in range(4)] for a in range(4)])  # (4, 4, n)
        inside = np.isfinite(patch[1:3, 1:3]).all(axis=(0, 1))
        inside &= ((place >= 0.0) & (place <= last)).all(axis=1)
        patch = _filled(np.moveaxis(_filled(patch), 0, 1))  # now [y, x]
        (wx, wx1, wx2), (wy, wy1, wy2) = _weights(t[:, 0]), _weights(t[:, 1])

        def joined(by_x: Floats, by_y: Floats) -> Floats:
            out: Floats = np.einsum("ban,an,bn->n", patch, by_x, by_y)
            return out

        sx, sy = self.step
        slopes = np.column_stack([joined(wx1, wy) / sx, joined(wx, wy1) / sy])
        bends = np.column_stack([joined(wx2, wy) / sx**2, joined(wx1, wy1) / (sx * sy), joined(wx, wy2) / sy**2])
        inside &= np.hypot(*np.nan_to_num(slopes, nan=np.inf).T) <= STEEPEST
        a, b = np.clip(t, 0.0, 1.0).T
        s = np.pad(self.sigmas, ((0, 1), (0, 1)), mode="edge")
        sigmas = (
            (1 - a) * (1 - b) * s[i, j]
            + a * (1 - b) * s[i + 1, j]
            + (1 - a) * b * s[i, j + 1]
            + a * b * s[i + 1, j + 1]
        )
        return joined(wx, wy), slopes, bends, inside, sigmas


def _filled(patch: Floats) -> Floats:
    """A patch (4, ...) whose outer rows are, where they are not there, on the line through the two beside them."""
    out = patch.copy()
    out[0] = np.where(np.isfinite(patch[0]), patch[0], 2.0 * patch[1] - patch[2])
    out[3] = np.where(np.isfinite(patch[3]), patch[3], 2.0 * patch[2] - patch[1])
    return out


def _weights(t: Floats) -> tuple[Floats, Floats, Floats]:
    """What four values at -1, 0, 1, 2 count (4, n) at t from 0 to 1, and the derivatives of that."""
    one, zero = np.ones_like(t), np.zeros_like(t)
    values = [-0.5 * t + t**2 - 0.5 * t**3, 1 - 2.5 * t**2 + 1.5 * t**3, 0.5 * t + 2 * t**2 - 1.5 * t**3,
              -0.5 * t**2 + 0.5 * t**3]  # fmt: skip
    slopes = [-0.5 * one + 2 * t - 1.5 * t**2, -5 * t + 4.5 * t**2, 0.5 + 4 * t - 4.5 * t**2, -t + 1.5 * t**2]
    bends = [2 * one - 3 * t, -5 * one + 9 * t, 4 * one - 9 * t, -1 * one + 3 * t + zero]
    return np.stack(values), np.stack(slopes), np.stack(bends)


def between_nodes(values: Floats, every: int) -> Floats:
    """A grid's ``values`` (nx, ny) and what `Heights` has at ``every`` - 1 places between each two of them along x and
    y: ((nx - 1) every + 1, (ny - 1) every + 1).
    """
    for _ in range(2):
        padded = np.pad(values, ((1, 2), (0, 0)), constant_values=np.nan)
        patch = _filled(np.stack([padded[k : k + len(values)] for k in range(4)]))
        patch[2:, -1] = patch[1, -1]  # behind the last node nothing is asked for
        weights = _weights(np.arange(every) / every)[0]
        dense = np.einsum("an,aij->inj", weights, patch)
        dense[:, 0] = values  # where there is a node there is its value, whatever is beside it
        values = dense.reshape(-1, values.shape[1])[: (len(values) - 1) * every + 1].T
    return values


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A surface where it is: its ``shape`` in its own frame, ``T_world_surface``; how well it is known besides what a
    grid says of its nodes, ``sigma_m`` along the normal and ``tilt_sigma_rad`` about either axis across it; ``edge``
    (k, 2) m, a polygon in its x and y outside of which it is not (k = 0: it has no edge of its own).
    """

    shape: Quadric | Heights
    T_world_surface: Pose = field(default_factory=Pose.identity)
    sigma_m: float = 0.0
    tilt_sigma_rad: float = 0.0
    edge: Floats = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "edge", frozen_array(self.edge, -1, 2))

    def ground(self, xy: Floats) -> Ground:
        """The surface under places (n, 2) m of its own frame."""
        xy = np.asarray(xy, np.float64).reshape(-1, 2)
        sigmas = np.full(len(xy), self.sigma_m)
        if isinstance(self.shape, Heights):
            z, slopes, bends, inside, own = self.shape.ground(xy)
            sigmas = np.hypot(sigmas, own)
        else:
            z, slopes, bends, inside = self.shape.ground(xy)
        if len(self.edge):
            inside = inside & within(self.edge, xy)
        return Ground(z, slopes, bends, sigmas, np.full(len(xy), self.tilt_sigma_rad), inside)

    def touch(self, points: Floats) -> Touch:
        """Where points (n, 3) m, in the world's frame, touch it, or would; in the world's frame.

        ``inside`` is false as well of a point to which no nearest one was found.
        """
        turn, at = self.T_world_surface.rotation, self.T_world_surface.position
        p = (np.asarray(points, np.float64).reshape(-1, 3) - at) @ turn
        foot = p[:, :2].copy()
        for _ in range(_STEPS):
            ground = self.ground(foot)
            above = (p[:, 2] - ground.heights)[:, None]
            # The line from the point to its foot is along the normal: 0 = foot - p - above * slopes.
            off = foot - p[:, :2] - above * ground.slopes
            zx, zy = ground.slopes.T
            xx, xy, yy = ground.bends.T
            h = above[:, 0]
            a, b, d = 1.0 + zx * zx - h * xx, zx * zy - h * xy, 1.0 + zy * zy - h * yy
            with np.errstate(all="ignore"):
                det = a * d - b * b
                step = np.column_stack([d * off[:, 0] - b * off[:, 1], a * off[:, 1] - b * off[:, 0]]) / det[:, None]
            step = np.where(np.isfinite(step), step, 0.0)
            foot = foot - step
            if np.abs(step).max(initial=0.0) < _SETTLED_M:
                break
        ground = self.ground(foot)
        feet, normals = np.column_stack([foot, ground.heights]), ground.normals
        distances = ((p - feet) * normals).sum(axis=1)
        with np.errstate(invalid="ignore"):
            found = np.linalg.norm(p - feet - distances[:, None] * normals, axis=1) <= 1e-7 + 1e-6 * np.abs(distances)
        inside = ground.inside & found
        return Touch(feet @ turn.T + at, normals @ turn.T, distances, ground.sigmas, ground.tilt_sigmas, inside)


def within(polygon: Floats, xy: Floats) -> NDArray[np.bool_]:
    """Which places (n, 2) lie inside a polygon (k, 2): those from which a ray crosses its sides an odd number of times.

    Source: Shimrat, "Algorithm 112: position of point relative to polygon", 1962.
    """
    x, y = xy.T
    inside = np.zeros(len(xy), np.bool_)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        crossed = (y0 > y) != (y1 > y)
        with np.errstate(all="ignore"):
            inside ^= crossed & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return inside


def crossing(polygon: Floats) -> tuple[int, int] | None:
    """Two sides of a polygon (k, 2), by the corners they begin at, that cross or lie on one another; None: none do."""
    ends = np.roll(polygon, -1, axis=0)

    def left(a: Floats, b: Floats, c: Floats) -> Floats:
        turned: Floats = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1])
        return turned - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])

    for k in range(len(polygon)):
        others = np.arange(k + 2, len(polygon) - (k == 0))  # not its neighbours
        a, b, c, d = polygon[k], ends[k], polygon[others], ends[others]
        apart = (np.maximum(a, b) < np.minimum(c, d)).any(axis=1) | (np.maximum(c, d) < np.minimum(a, b)).any(axis=1)
        crossed = (left(a, b, c) * left(a, b, d) <= 0.0) & (left(c, d, a) * left(c, d, b) <= 0.0) & ~apart
        if crossed.any():
            return k, int(others[int(np.argmax(crossed))])
    return None
