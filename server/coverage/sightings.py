"""What a robot's poses say of where its tool touched the surface, and why some of them say nothing."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Standing, State
from asterism.protocol.surface import Surface, Touch
from asterism.protocol.surface_file import Stands
from asterism.server.coverage.visits import BEYOND, LIFTED, NOT_TRACKED, REASONS, SUNK, TILTED, UNSURE

COUNTS = -1  # of a pose that says where the tool was; else the reason's place in REASONS
SURE_RADII = 0.5  # one sigma of the point across the surface may be so many radii of the tool
LIFTED_SIGMAS = 5.0  # that light must see between point and surface, where nobody judged that before
LEAVES_RADII = 0.25  # so far beyond its rim, and never less than this many sigmas, the tool has left a patch
LEAVES_SIGMAS = 4.0

# xx, xy, xz, yy, yz, zz of a covariance (3, 3), as its six numbers go.
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_OF_STANDING = {
    Standing.LIFTED: LIFTED, Standing.SUNK: SUNK, Standing.TILTED: TILTED, Standing.BEYOND: BEYOND,
}  # fmt: skip


class Told(NamedTuple):
    """One robot in n frames, in their order: exposure ``times_ns`` (n,), ``states`` (n,) as of `State`, ``standings``
    (n,) as of `Standing`; its tool's point in the world, ``points`` (n, 3) m, and their covariances (n, 6) m^2, xx, xy,
    xz, yy, yz, zz. Without a pose points mean nothing.
    """

    times_ns: NDArray[np.int64]
    states: NDArray[np.int64]
    standings: NDArray[np.int64]
    points: Floats
    covariances: Floats


class Tool(NamedTuple):
    """How a robot stands, and the radius of the disc about its point, m."""

    stands: Stands
    radius_m: float


class Sighted(NamedTuple):
    """Where a tool touched the surface in n frames: ``feet`` (n, 3) m and ``slopes`` (n, 2) in the surface's frame,
    ``leaves`` (n,) m how far beyond its rim a patch must be to be left; ``why`` (n,) is COUNTS, or the place in REASONS
    of why the pose does not say it, and then the rest means nothing.
    """

    times_ns: NDArray[np.int64]
    feet: Floats
    slopes: Floats
    leaves: Floats
    why: NDArray[np.int64]


def sighted(told: Told, surface: Surface, tool: Tool) -> Sighted:
    """What poses say of where a tool was."""
    tracked = told.states == State.TRACKED
    points = np.where(tracked[:, None], told.points, 0.0)
    touch = surface.touch(points)
    along, across = _sigmas(told.covariances, touch.normals)
    why = np.full(len(points), COUNTS, np.int64)
    for wrong, reason in (
        *_by_standing(told.standings, touch, np.sqrt(along**2 + touch.sigmas**2 + tool.stands.sigma_m**2)),
        (~touch.inside, BEYOND),
        (~(across <= SURE_RADII * tool.radius_m), UNSURE),
        (~tracked, NOT_TRACKED),
    ):
        why[wrong] = REASONS.index(reason)
    turn, at = surface.T_world_surface.rotation, surface.T_world_surface.position
    normals = touch.normals @ turn
    leaves = np.maximum(LEAVES_RADII * tool.radius_m, LEAVES_SIGMAS * across)
    return Sighted(told.times_ns, (touch.points - at) @ turn, -normals[:, :2] / normals[:, 2:], leaves, why)


def _by_standing(standings: NDArray[np.int64], touch: Touch, sigmas: Floats) -> list[tuple[NDArray[np.bool_], str]]:
    """Who does not stand, as the server found; where it did not look, as the point's distance says."""
    unsaid, sure = standings == Standing.STANDING_UNSPECIFIED, LIFTED_SIGMAS * sigmas
    found = [(unsaid & (touch.distances > sure), LIFTED), (unsaid & (touch.distances < -sure), SUNK)]
    return [*found, *((standings == standing, reason) for standing, reason in _OF_STANDING.items())]


def _sigmas(covariances: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """One sigma of points (n,) m: along the normals, and the greatest across them."""
    full = covariances[:, _FULL]
    turned = np.einsum("nij,nj->ni", full, normals)
    along2 = np.einsum("ni,ni->n", turned, normals)
    # Of the two variances across the normal: their sum, and their product, by the minors of what is left there.
    flat = full - normals[:, :, None] * turned[:, None, :] - turned[:, :, None] * normals[:, None, :]
    flat += along2[:, None, None] * normals[:, :, None] * normals[:, None, :]
    total = np.trace(full, axis1=1, axis2=2) - along2
    product = sum(flat[:, i, i] * flat[:, j, j] - flat[:, i, j] ** 2 for i, j in ((0, 1), (0, 2), (1, 2)))
    greatest = 0.5 * total + np.sqrt(np.maximum(0.25 * total**2 - product, 0.0))
    return np.sqrt(np.maximum(along2, 0.0)), np.sqrt(np.maximum(greatest, 0.0))
