"""Planar constellations of six LEDs: the plane they lie in, and how well two of them can be told apart.

Separation of constellation i from j: the residual norm, in m, of the best affine map of j's points onto a
permutation of i's, d = || (I - P_j) X_i[permutation] ||, P_j the projector on span{x, y, 1} of j. In the
weak-perspective limit this equals the residual of the best calibrated pose (both have six degrees of freedom), so
d * f / Z is how far, in px, i's image stays from every image of j. Maps that mirror are left out: they are plates
seen from behind.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats, Pose

LEDS = 6


def plane_of(leds: Floats, axis: Floats) -> tuple[Pose, Floats]:
    """The plane of the LEDs: T_robot_plane and the LEDs in it.

    ``leds`` is (n, 3), ``axis`` (3,) the side to which they shine, both in the robot's frame. The plane's frame has
    its origin at the LEDs' centroid and +z towards that side; the returned (n, 3) has the distances from the
    plane as third column.
    """
    centre = leds.mean(axis=0)
    normal = np.linalg.svd(leds - centre)[2][2]
    if normal @ axis < 0:
        normal = -normal
    # x of the plane: the robot's own x as far as it lies in the plane, so that frames look familiar.
    start = np.eye(3)[int(np.argmin(np.abs(normal)))] if abs(normal[0]) > 0.9 else np.array([1.0, 0.0, 0.0])
    x = start - (start @ normal) * normal
    x /= np.linalg.norm(x)
    turn = np.column_stack([x, np.cross(normal, x), normal])
    return Pose.from_matrix(turn, centre), (leds - centre) @ turn


def extent(points: Floats) -> float:
    """The largest distance between two of the points (n, d)."""
    return float(np.linalg.norm(points[:, None] - points[None], axis=-1).max())


@dataclass(frozen=True, slots=True)
class Confusion:
    """The nearest way to mistake robot ``seen`` for robot ``taken`` (indices into the list of layouts)."""

    seen: int
    taken: int
    separation: float  # m
    seen_leds: tuple[int, ...]  # LED seen_leds[k] of the one would be taken for
    taken_leds: tuple[int, ...]  # LED taken_leds[k] of the other


def confusions(layouts: Sequence[Floats], hidden: int = 0, mirrored: bool = False) -> Iterator[Confusion]:
    """For every ordered pair of layouts (6, 2), and every layout with itself, the nearest confusion.

    ``hidden`` LEDs (0 or 1) are not visible. A layout taken for itself with every LED in its own place is no
    confusion. ``mirrored``: what is seen is the mirror image, as a polished surface shows it.
    """
    count = LEDS - hidden
    orders = np.array(list(itertools.permutations(range(LEDS), count)))  # which LEDs are seen, in what order
    subsets = list(itertools.combinations(range(LEDS), count))  # which LEDs of the other they are taken for
    bases = np.concatenate([_basis(layout[list(subset)]).T for layout in layouts for subset in subsets])
    for seen, layout in enumerate(layouts):
        points = (layout * [-1.0, 1.0] if mirrored else layout)[orders]  # (orders, count, 2)
        points = points - points.mean(axis=1, keepdims=True)
        total = (points**2).sum(axis=(1, 2))
        flat = points.transpose(1, 0, 2).reshape(count, -1)  # (count, orders * 2)
        fits = (bases @ flat).reshape(len(layouts), len(subsets), 2, len(orders), 2)
        left = total - (fits**2).sum(axis=(2, 4))  # (layouts, subsets, orders) squared residuals
        reflects = fits[:, :, 0, :, 0] * fits[:, :, 1, :, 1] < fits[:, :, 0, :, 1] * fits[:, :, 1, :, 0]
        left = np.where(reflects, np.inf, np.maximum(left, 0.0))
        for number, subset in enumerate(subsets):
            left[seen, number, (orders == subset).all(axis=1)] = np.inf
        for taken in range(len(layouts)):
            place = np.unravel_index(int(np.argmin(left[taken])), left[taken].shape)
            number, order = int(place[0]), int(place[1])
            yield Confusion(
                seen,
                taken,
                float(np.sqrt(left[taken, number, order])),
                tuple(orders[order].tolist()),
                subsets[number],
            )


def _basis(points: Floats) -> Floats:
    """Orthonormal basis (n, 2) of the centred coordinates' column space, with the points' own handedness."""
    q, r = np.linalg.qr(points - points.mean(axis=0))
    signed: Floats = q * np.sign(np.diag(r))
    return signed
