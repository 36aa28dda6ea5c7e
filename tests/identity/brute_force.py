"""Who is who by trying everything: slow, obvious, and without anything of the product's search.

For every robot, every ordered choice of four spots as the images of four of its LEDs: the homography of the four
predicts the other two; where at least one of them has a spot near it, a calibrated pose is fitted to all five or six
(OpenCV's IPPE, then its Levenberg-Marquardt) and judged by its residual.
"""

import itertools
from dataclasses import dataclass

import cv2
import numpy as np

from asterism.protocol.geometry import Floats

# Of any six LEDs of which at most one is missing, the four of one of these are all there.
QUADS = ((0, 1, 2, 3), (2, 3, 4, 5), (0, 1, 4, 5))
NEAR_PX = 10.0  # of a prediction from four spots, which is good for little where they lie unfavourably
FITS_PX = 0.12  # root mean square residual of a pose: six times the noise of the spots that the tests make


@dataclass(frozen=True)
class Explanation:
    """A robot, the spots of its LEDs (-1: none), and how well they fit, px."""

    robot: int
    spots: tuple[int, ...]
    rms_px: float

    @property
    def used(self) -> frozenset[int]:
        """The spots it needs."""
        return frozenset(self.spots) - {-1}


def _weights(four: Floats) -> Floats:
    """How much of its first three points (..., 3) the fourth of ``four`` (..., 4, 2) is, in homogeneous coordinates."""
    points = np.concatenate([four, np.ones((*four.shape[:-1], 1))], axis=-1)
    weights: Floats = np.linalg.solve(points[..., :3, :].swapaxes(-1, -2), points[..., 3, :, None])[..., 0]
    return weights


def _area(three: Floats) -> Floats:
    """Twice the signed area (...) of triangles (..., 3, 2)."""
    (ux, uy), (vx, vy) = np.moveaxis(three[..., 1:, :] - three[..., :1, :], (-2, -1), (0, 1))
    area: Floats = ux * vy - uy * vx
    return area


def _transferred(scales: Floats, four: Floats, fifth: Floats, images: Floats) -> Floats:
    """Where the homography that maps ``four`` (4, 2) to each of ``images`` (n, 4, 2) maps ``fifth`` (2,): (n, 2).

    ``scales`` (n, 3) are what it does to the third homogeneous coordinate of the first three; of the fourth's, 1.
    """
    share = np.linalg.solve(np.column_stack([four[:3], np.ones(3)]).T, np.append(fifth, 1.0))
    weights = scales * share
    with np.errstate(divide="ignore", invalid="ignore"):
        predicted: Floats = np.einsum("nk,nkj->nj", weights, images[:, :3]) / weights.sum(axis=1, keepdims=True)
    return predicted


def _residual(layout: Floats, pixels: Floats, matrix: Floats, near: float, far: float) -> float:
    """Root mean square residual, px, of the best pose that faces the camera at a distance that may be; or infinity."""
    best = np.inf
    _, turns, positions, _ = cv2.solvePnPGeneric(layout, pixels, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    for start, there in zip(turns, positions, strict=True):
        if not np.isfinite(start).all() or there[2, 0] <= 0:
            continue
        turn, position = cv2.solvePnPRefineLM(layout, pixels, matrix, None, start.copy(), there.copy())
        normal = cv2.Rodrigues(turn)[0][:, 2]
        towards = -float(normal @ position[:, 0]) / float(np.linalg.norm(position))
        if towards < np.cos(np.radians(75)) or not near <= position[2, 0] <= far:
            continue
        projected = cv2.projectPoints(layout, turn, position, matrix, None)[0][:, 0]
        best = min(best, float(np.sqrt(((projected - pixels) ** 2).sum(axis=1).mean())))
    return best


def explanations(layouts: Floats, pixels: Floats, focal: float, near: float, far: float) -> list[Explanation]:
    """Everything that five or six of the spots can be.

    ``layouts`` (robots, 6, 3) m with z towards the side that shines; ``pixels`` (n, 2) of an ideal camera, y down,
    from its principal point; ``focal`` px; ``near`` and ``far`` m.
    """
    matrix = np.diag([focal, focal, 1.0])
    choices = np.array(list(itertools.permutations(range(len(pixels)), 4)))
    choices = choices[np.abs(_area(pixels[choices[:, :3]])) > 1.0]  # three spots on a line carry no homography
    images = pixels[choices]
    weights, areas = _weights(images), _area(images[:, :3])
    found: dict[tuple[int, tuple[int, ...]], Explanation] = {}
    for robot, layout in enumerate(layouts):
        tried = set()
        for quad in QUADS:
            others = [led for led in range(6) if led not in quad]
            four = layout[list(quad), :2]
            scales = weights / _weights(four)
            # All four before the camera, which sees the side that shines: y is down in the image.
            good = (scales > 0).all(axis=1) & (areas * _area(four[:3]) < 0)
            seen_as, there = choices[good], images[good]
            predicted = np.stack([_transferred(scales[good], four, layout[led, :2], there) for led in others], axis=1)
            away = np.linalg.norm(predicted[:, :, None] - pixels, axis=-1)  # (n, 2, spots)
            nearest, gap = away.argmin(axis=2), away.min(axis=2)
            for row in np.flatnonzero((gap < NEAR_PX).any(axis=1)):
                spots = np.full(6, -1)
                spots[list(quad)] = seen_as[row]
                near_enough = [(led, k) for k, led in enumerate(others) if gap[row, k] < NEAR_PX]
                for chosen in (near_enough, *([one] for one in near_enough if len(near_enough) > 1)):
                    full = spots.copy()
                    for led, k in chosen:
                        full[led] = nearest[row, k]
                    key = tuple(full.tolist())
                    if key in tried or len(set(full[full >= 0].tolist())) < (full >= 0).sum():
                        continue
                    tried.add(key)
                    seen = full >= 0
                    rms = _residual(layout[seen], pixels[full[seen]], matrix, near, far)
                    if rms < FITS_PX:
                        found[robot, key] = Explanation(robot, key, rms)
    return list(found.values())


def clear(candidates: list[Explanation]) -> dict[int, tuple[int, ...]]:
    """The robots about which there is no doubt, and the spots of their LEDs.

    Six spots outdo five of the same; after that a robot is clear if it has one explanation that shares no spot
    with any other robot's.
    """
    six = [c for c in candidates if -1 not in c.spots]
    left = [c for c in candidates if -1 not in c.spots or not any(c.used & other.used for other in six)]
    told = {}
    for robot in {c.robot for c in left}:
        own = [c for c in left if c.robot == robot]
        if len(own) == 1 and not any(c.robot != robot and c.used & own[0].used for c in left):
            told[robot] = own[0].spots
    return told
