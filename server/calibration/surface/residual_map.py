"""How the real mould differs from its drawing, where robots were, and the surface that a rig uses then."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline, RegularGridInterpolator
from scipy.linalg import solve_triangular
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import cKDTree
from scipy.stats import norm

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights, Surface
from asterism.server.calibration.surface.register import Registration
from asterism.server.calibration.surface.register_field import matern
from asterism.server.calibration.surface.register_left import extent_of, moves
from asterism.server.calibration.surface.visited import GAP_M

MOST_NODES = 5000
FINEST_M = 0.002
CHANCE = 0.01  # that anywhere a difference is called one that is none
REACH = 1.5  # patches from touches within which a place was visited, if that is not between two ways
LEAST_SIGMA_M = 1e-6


class ResidualMap(NamedTuple):
    """How the mould differs from its drawing, on a grid in the drawing's frame: node (i, j) is at ``origin`` (2,) +
    (i, j) * ``step`` (2,), m. ``values`` (nx, ny) m along the normal, out of the material, with ``sigmas``; nan where
    there is no drawing. ``visited`` (nx, ny) where robots were; ``real``, where there it differs by more than
    ``chance`` sigmas, which chance does nowhere. ``totals``: one sigma of the mould itself, the pose's with it, m;
    ``tilt_sigma``: of its direction where it was visited, rad.
    """

    origin: Floats
    step: Floats
    values: Floats
    sigmas: Floats
    visited: NDArray[np.bool_]
    totals: Floats
    tilt_sigma: float
    chance: float

    @property
    def real(self) -> NDArray[np.bool_]:
        """(nx, ny)."""
        with np.errstate(invalid="ignore"):
            real: NDArray[np.bool_] = self.visited & (np.abs(self.values) > self.chance * self.sigmas)
        return real

    @property
    def rms_m(self) -> float:
        """Of the differences where robots were."""
        return float(np.sqrt((self.values[self.visited] ** 2).mean()))


def residual_map(found: Registration) -> ResidualMap:
    """The map of a registered drawing."""
    drawing, laid = found.drawing, found.laid
    low, high = extent_of(drawing)
    step = max(FINEST_M, min(laid.units.size_m, 0.25 * laid.field.width_m), math.sqrt((high - low).prod() / MOST_NODES))
    counts = np.ceil((high - low) / step).astype(np.int64) + 1
    steps = (high - low) / (counts - 1)
    xy = (low + steps * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)).reshape(-1, 2)
    ground = Surface(_whole(drawing)).ground(xy)
    places = found.T_world_drawing.map(np.column_stack([xy, ground.heights]))
    normals = ground.normals @ found.T_world_drawing.rotation.T
    values, own, slopes = _posterior(found, places, normals, counts, steps)
    reach = max(REACH * max(laid.units.size_m, FINEST_M), 0.5 * GAP_M)
    away = cKDTree(laid.left.xy[laid.used]).query(xy, distance_upper_bound=reach)[0]
    there = Surface(drawing).ground(xy).inside
    sigmas, totals = (np.where(there, np.sqrt(np.maximum(part, 0.0)), np.nan).reshape(counts) for part in own)
    visited = (np.isfinite(away) & there).reshape(counts)
    tilt = math.sqrt(max(float(np.median(slopes.reshape(counts)[visited])), 0.0)) if visited.any() else 0.0
    values = np.where(there, values, np.nan).reshape(counts)
    return ResidualMap(low, steps, values, sigmas, visited, totals, tilt, _chance(found, visited, steps))


def _chance(found: Registration, visited: NDArray[np.bool_], steps: Floats) -> float:
    """How many sigmas noise is off at most in all the places that are told apart by the field's width."""
    places = max(float(visited.sum() * steps.prod()) / found.laid.field.width_m**2, 1.0)
    return float(norm.isf(0.5 * CHANCE / places))


def _whole(drawing: Heights) -> Heights:
    """The drawing with a height everywhere: where it has none, that of the nearest node."""
    nearest = distance_transform_edt(~np.isfinite(drawing.values), return_distances=False, return_indices=True)
    return Heights(drawing.origin, drawing.step, drawing.values[tuple(nearest)], drawing.sigmas)


def _posterior(
    found: Registration, places: Floats, normals: Floats, counts: NDArray[np.int64], steps: Floats
) -> tuple[Floats, tuple[Floats, Floats], Floats]:
    """Of the field at places (n, 3) of a grid: its mean; the variances of it and of it and the pose together; and the
    variance of the slope of these about either axis.
    """
    laid = found.laid
    across = laid.field.between(places, laid.units.places)
    whitened = solve_triangular(laid.joint.factor[0], across.T, lower=True)
    by = solve_triangular(laid.joint.factor[0], laid.joint.by, lower=True)
    root = np.linalg.cholesky(laid.joint.covariance)
    aside = -whitened.T @ by
    prior = laid.field.at(places) ** 2 - (whitened**2).sum(axis=0)
    pose = aside.copy()
    pose[:, :6] += moves(normals, places - found.centre)
    own = prior + ((aside @ root) ** 2).sum(axis=1), prior + ((pose @ root) ** 2).sum(axis=1)
    return across @ laid.joint.weighted, own, _slopes(found, places, whitened, pose @ root, counts, steps)


def _slopes(
    found: Registration, places: Floats, whitened: Floats, pose: Floats, counts: NDArray[np.int64], steps: Floats
) -> Floats:
    """Variances (n,) of the slope from every node to the next, the mean of both ways."""
    index = np.arange(len(places)).reshape(counts)
    field, out = found.laid.field, np.zeros(counts)
    for axis in range(2):
        here = np.take(index, np.arange(counts[axis] - 1), axis=axis).ravel()
        after = np.take(index, np.arange(1, counts[axis]), axis=axis).ravel()
        sizes = field.at(places[here]), field.at(places[after])
        apart = np.linalg.norm(places[here] - places[after], axis=1) / field.width_m
        variances = sizes[0] ** 2 + sizes[1] ** 2 - 2.0 * sizes[0] * sizes[1] * matern(apart)
        variances -= ((whitened[:, here] - whitened[:, after]) ** 2).sum(axis=0)
        variances += ((pose[here] - pose[after]) ** 2).sum(axis=1)
        shape = tuple(counts - np.eye(2, dtype=np.int64)[axis])
        slope = (variances / steps[axis] ** 2).reshape(shape)
        out += 0.5 * np.pad(slope, [(0, 1) if k == axis else (0, 0) for k in range(2)], mode="edge")
    return out.ravel()


class Place(NamedTuple):
    """Where a mould differs for sure: the middle of it, ``xy`` (2,) m in the drawing's frame, by how much at most,
    ``off_m`` +- ``sigma_m``, and its area, ``area_m2``.
    """

    xy: Floats
    off_m: float
    sigma_m: float
    area_m2: float


def places_of(differs: ResidualMap) -> list[Place]:
    """All such places, the worst first."""
    names, count = label(differs.real, np.ones((3, 3)))
    out = []
    for name in range(1, count + 1):
        nodes = np.argwhere(names == name)
        worst = nodes[np.abs(differs.values[tuple(nodes.T)]).argmax()]
        i, j = worst
        at = differs.origin + differs.step * worst
        area = len(nodes) * float(differs.step.prod())
        out.append(Place(at, float(differs.values[i, j]), float(differs.sigmas[i, j]), area))
    return sorted(out, key=lambda place: -abs(place.off_m))


def table_text(differs: ResidualMap) -> str:
    """The map as a table: a row for every node of the drawing, m."""
    lines = ["x,y,differs,sigma,visited,real"]
    for i, j in np.argwhere(np.isfinite(differs.values)).tolist():
        x, y = differs.origin + differs.step * [i, j]
        told = f"{differs.values[i, j]:.7f},{differs.sigmas[i, j]:.2g}"
        lines.append(f"{x:.6g},{y:.6g},{told},{int(differs.visited[i, j])},{int(differs.real[i, j])}")
    return "\n".join(lines) + "\n"


def as_it_is(found: Registration, differs: ResidualMap) -> Heights:
    """The drawing with what differs, at the drawing's nodes: heights and one sigma along the normal."""
    return _table(found.drawing, differs, differs.values, np.hypot(differs.totals, LEAST_SIGMA_M))


def as_drawn(found: Registration, differs: ResidualMap) -> Heights:
    """The drawing where it lies; its sigma holds what the mould differs where it was visited (RMS)."""
    pose = np.sqrt(np.maximum(differs.totals**2 - differs.sigmas**2, 0.0))
    rms = math.sqrt(differs.rms_m**2 + float((differs.sigmas[differs.visited] ** 2).mean()))
    return _table(found.drawing, differs, np.zeros_like(differs.values), np.hypot(pose, rms))


def _table(drawing: Heights, grid: ResidualMap, values: Floats, sigmas: Floats) -> Heights:
    nodes = tuple(drawing.origin[k] + drawing.step[k] * np.arange(n) for k, n in enumerate(drawing.values.shape))
    axes = tuple(grid.origin[k] + grid.step[k] * np.arange(n) for k, n in enumerate(values.shape))
    xy = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1)
    inner = np.clip(xy, [axis[0] for axis in axes], [axis[-1] for axis in axes])
    filled = [_whole(Heights(grid.origin, grid.step, part, part)).values for part in (values, sigmas)]
    ups = Surface(_whole(drawing)).ground(xy.reshape(-1, 2)).normals[:, 2].reshape(drawing.values.shape)
    degrees = [min(3, len(axis) - 1) for axis in axes]
    smooth = RectBivariateSpline(axes[0], axes[1], filled[0], kx=degrees[0], ky=degrees[1])
    more = smooth.ev(inner[..., 0], inner[..., 1]) / ups
    told = RegularGridInterpolator(axes, filled[1])(inner)
    return Heights(drawing.origin, drawing.step, drawing.values + more, np.hypot(told, drawing.sigmas))
