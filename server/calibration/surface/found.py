"""What is told of a surface whose kind is chosen: the surface itself, its map of standard deviations, its robots."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.surface import HEIGHTS, Heights, Quadric, Surface
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.fitting import Fitted, Noise, fitted
from asterism.server.calibration.surface.kinds import Tried
from asterism.server.calibration.surface.normal_equations import Priors
from asterism.server.calibration.surface.offsets import spread_of
from asterism.server.calibration.surface.robots import stood
from asterism.server.calibration.surface.shapes import middle_and_size, moved_quadric, polynomial_quadric
from asterism.server.calibration.surface.surface_fit import Score, SurfaceFit
from asterism.server.calibration.surface.touches import Touches
from asterism.server.calibration.surface.visited import Visited


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """All ``touches``, in the ``frame`` T_world_surface; ``used`` (n,) which count, and those ones' ``noise``."""

    frame: Pose
    touches: Touches
    used: NDArray[np.bool_]
    noise: Noise


def found(
    contacts: Contacts, settled: Settled, tried: Sequence[Tried], best: Tried, axes: Sequence[Floats]
) -> SurfaceFit:
    """All of it, of the ``best`` kind."""
    kept = settled.touches[settled.used]
    fit = sure(kept, settled.noise, best)
    visited = Visited.by(kept.xy)
    grid, tilt_sigma = _map(fit, visited)
    distances, sigmas, normals = _distances(settled, fit)
    whole = replace(fit, used=settled.used, residuals=_residuals(settled.touches, fit, distances, normals))
    whole = replace(whole, variances=(sigmas / normals[:, 2]) ** 2)
    used = settled.used
    return SurfaceFit(
        _surface(fit, best, kept, (settled.frame, visited), (grid, tilt_sigma)),
        best.found.shape.kind,
        tuple(Score(each.found.shape.kind, each.found.rms_m, each.found.numbers) for each in tried),
        grid,
        contacts,
        used,
        distances,
        sigmas,
        float(np.sqrt(((whole.residuals * normals[:, 2])[used] ** 2).mean())),
        stood(contacts, settled.touches, whole, axes, normals @ settled.frame.rotation.T),
    )


def sure(touches: Touches, noise: Noise, best: Tried) -> Fitted:
    """The surface by touches that all count, with what robots are off by themselves as far as they differ."""
    every = np.ones(len(touches), np.bool_)
    shape, stiffness = best.found.shape, best.found.priors.stiffness
    first = fitted(touches, shape, Priors(stiffness), every, noise)
    assert first.covariance is not None
    offsets = shape.numbers + np.arange(1, touches.count + 1) * touches.causes - 1
    spread = spread_of(first.causes[:, -1], first.covariance[np.ix_(offsets, offsets)])
    return fitted(touches, shape, Priors(stiffness, max(spread, 1e-7)), every, noise)


def _map(fit: Fitted, visited: Visited) -> tuple[Heights, float]:
    """The grid of nodes with sigmas along the normal; and one sigma of the normal's direction, rad, over all."""
    there = visited.there.ravel()
    heights, slopes = fit.heights(visited.nodes[there])
    by_height, by_slope = fit.sigmas(visited.nodes[there])
    values, sigmas = np.full(there.shape, np.nan), np.full(there.shape, np.nan)
    values[there], sigmas[there] = heights, by_height / np.sqrt(1.0 + (slopes**2).sum(axis=1))
    shape = visited.there.shape
    grid = Heights(visited.origin, np.full(2, visited.step), values.reshape(shape), sigmas.reshape(shape))
    return grid, float(np.sqrt((by_slope**2).mean()))


def _surface(
    fit: Fitted, best: Tried, kept: Touches, where: tuple[Pose, Visited], sigmas: tuple[Heights, float]
) -> Surface:
    """A spline is a table, and so is what no polygon goes about."""
    (frame, visited), (grid, tilt_sigma) = where, sigmas
    edge = None if fit.shape.kind == HEIGHTS else visited.outline()
    if edge is None:
        return Surface(grid, frame, 0.0, tilt_sigma)
    sigma = float(np.sqrt(np.nanmean(grid.sigmas**2)))
    return Surface(_quadric(fit, best, kept), frame, sigma, tilt_sigma, edge)


def _quadric(fit: Fitted, best: Tried, kept: Touches) -> Quadric:
    if best.quadric is None:
        return polynomial_quadric(kept.xy, fit.numbers)
    return moved_quadric(best.quadric, middle_and_size(kept.xy)[1], fit.numbers)


def _distances(settled: Settled, fit: Fitted) -> tuple[Floats, Floats, Floats]:
    """Of all touches: distances along the normal (n,) m, their noise (n,) m, and normals (n, 3) in the surface's
    frame.
    """
    touches = settled.touches
    heights, slopes = fit.heights(touches.xy)
    up = np.column_stack([-slopes, np.ones(len(touches))])
    length = np.linalg.norm(up, axis=1)
    own = np.einsum("ni,nij,nj->n", up, touches.covariances, up) * fit.noise.factors[touches.robots]
    return (touches.z - heights) / length, np.sqrt(own) / length, up / length[:, None]


def _residuals(touches: Touches, fit: Fitted, distances: Floats, normals: Floats) -> Floats:
    """Heights (n,) m over the surface, what robots are off by themselves taken off."""
    up = normals / normals[:, 2:]
    causes = np.concatenate([np.einsum("ni,nik->nk", up, touches.shared), np.ones((len(touches), 1))], axis=1)
    out: Floats = distances / normals[:, 2] - (causes * fit.causes[touches.robots]).sum(axis=1)
    return out
