"""Which spot is which LED of a flat board, seen by a camera that is not calibrated yet.

Four points in general position fix a homography. Groups of neighbours on the board are kept with the affine
coordinates of the fourth in the frame of the other three, which a view changes little; groups of neighbouring spots
look theirs up, and the homography that finds most of the other LEDs at their places wins. Source: geometric hashing
(Lamdan and Wolfson, 1988), verified by a homography.
"""

from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from asterism.protocol.geometry import Floats

NEIGHBOURS = 5  # of a point, of which groups of four are made
WHOLE = 7  # boards of so many points are small enough for all groups of four
ALIKE = 0.25  # difference of affine coordinates of a group on the board and in the image
CANDIDATES = 24  # groups of the board that a group of spots is compared with
BATCH = 4096
NEAR = 0.25  # of the spacing of LEDs: spots so far from their place count
LEAST_SHARE = 0.8  # of the LEDs
FIT = 0.04  # of the spacing: RMS that the lens' distortion may leave of a homography
MARGIN = 2.0  # times that the second-best naming must fit worse
SYMMETRIC = 1e-3  # of the board's size
ALMOST = 3e-3  # the same, of what a person wrote with few digits
MOST_PERSPECTIVE = 0.5  # change of scale over the board


def match_layout(spots: Floats, layout: Floats) -> NDArray[np.int64] | None:
    """Spot (n,) of every LED, -1 where it is not seen; None where the board is not found or not sure.

    ``spots`` (m, 2) px; ``layout`` (n, 2) m as seen from where the LEDs shine to: y is left of x. A board that looks
    the same turned about gives any of its namings.
    """
    least = max(6, int(np.ceil(LEAST_SHARE * len(layout))))
    if len(spots) < least:
        return None
    middle, size = layout.mean(axis=0), float(np.abs(layout - layout.mean(axis=0)).max())
    board = (layout - middle) / size
    board_groups, board_keys = _keyed(board, ordered=True)
    spot_groups, spot_keys = _keyed(spots, ordered=False)
    if not len(board_groups) or not len(spot_groups):
        return None
    count = min(CANDIDATES, len(board_keys))
    near = cKDTree(board_keys).query(spot_keys, k=np.arange(1, count + 1), distance_upper_bound=ALIKE)
    spot_rows, place = np.nonzero(np.isfinite(near[0]))
    board_rows = np.asarray(near[1])[spot_rows, place]
    spacing = float(np.asarray(cKDTree(board).query(board, k=2)[0])[:, 1].min())
    tree = cKDTree(spots)
    best: list[tuple[int, float, NDArray[np.int64]]] = []
    for start in range(0, len(spot_rows), BATCH):
        part = slice(start, start + BATCH)
        maps = _homographies(board[board_groups[board_rows[part]]], spots[spot_groups[spot_rows[part]]])
        counts = _count_near(maps, board, spacing, tree)
        for k in np.argsort(-counts)[:8]:
            if counts[k] >= least:
                best += _polished(maps[k], board, spots, tree, spacing, least)
    if not best:
        return None
    best.sort(key=lambda entry: (-entry[0], entry[1]))
    count_best, rms, chosen = best[0]
    for other_count, other_rms, other in best[1:]:
        rival = other_count == count_best and not np.array_equal(other, chosen)
        if rival and other_rms < MARGIN * rms and not _is_symmetry(board, chosen, other):
            return None
    return chosen


def looks_the_same_turned(layout: Floats) -> bool:
    """Whether a turn maps the layout (n, 2) onto itself, but for what rounding does to it."""
    points = (layout - layout.mean(axis=0)) @ [1.0, 1.0j]
    points = points / np.abs(points).max()
    tree, first = cKDTree(np.column_stack([points.real, points.imag])), points[np.argmax(np.abs(points))]
    for angle in np.angle(points / first):
        turned = points * np.exp(1.0j * angle)
        away, to = (np.asarray(found) for found in tree.query(np.column_stack([turned.real, turned.imag])))
        if abs(angle) > ALMOST and away.max() < ALMOST and len(np.unique(to)) == len(points):
            return True
    return False


def _keyed(points: Floats, ordered: bool) -> tuple[NDArray[np.int64], Floats]:
    """Groups (k, 4) of points and the affine coordinates (k, 2) of the last in the frame of the first three.

    ``ordered``: every group in all its orders, else in one.
    """
    if len(points) <= WHOLE:
        groups = np.array(list(combinations(range(len(points)), 4)), np.int64)
    else:
        near = np.asarray(cKDTree(points).query(points, k=min(NEIGHBOURS + 1, len(points)))[1])
        groups = np.unique(
            np.sort([[row[0], *some] for row in near.tolist() for some in combinations(row[1:], 3)], axis=1), axis=0
        )
    if ordered:
        groups = np.concatenate([groups[:, list(order)] for order in permutations(range(4))])
    a, b, c, d = (points[groups[:, k]] for k in range(4))
    u, v, w = b - a, c - a, d - a
    det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    longest = np.maximum((u**2).sum(axis=1), (v**2).sum(axis=1))
    sound = np.abs(det) > 0.1 * longest
    groups, u, v, w, det = groups[sound], u[sound], v[sound], w[sound], det[sound]
    keys = np.column_stack([w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0], u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]])
    return groups, keys / det[:, None]


def _homographies(board: Floats, image: Floats) -> Floats:
    """Exact homographies (k, 3, 3) from four points (k, 4, 2) each; nan where there is none."""
    k = len(board)
    a, b = np.zeros((k, 8, 8)), np.empty((k, 8))
    x, y = board[..., 0], board[..., 1]
    for axis in range(2):
        rows = slice(4 * axis, 4 * axis + 4)
        u = image[..., axis]
        a[:, rows, 3 * axis], a[:, rows, 3 * axis + 1], a[:, rows, 3 * axis + 2] = x, y, 1.0
        a[:, rows, 6], a[:, rows, 7] = -u * x, -u * y
        b[:, rows] = u
    singular = np.abs(np.linalg.det(a)) < 1e-12
    a[singular] = np.eye(8)
    h = np.concatenate([np.linalg.solve(a, b[..., None])[..., 0], np.ones((k, 1))], axis=1)
    h[singular] = np.nan
    return h.reshape(k, 3, 3)


def _mapped(h: Floats, board: Floats) -> Floats:
    """Images (..., n, 2) of the board's points (n, 2); nan where the view would be absurd."""
    homogeneous = np.column_stack([board, np.ones(len(board))]) @ np.swapaxes(h, -1, -2)
    weight = homogeneous[..., 2:]
    absurd = (np.abs(weight - 1.0) > MOST_PERSPECTIVE).any(axis=-2, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(absurd, np.nan, homogeneous[..., :2] / weight)


def _scale(h: Floats) -> Floats:
    """Smallest scale of the view at the board's middle, px per unit."""
    affine = h[..., :2, :2] - h[..., :2, 2:] * h[..., 2:, :2]
    return np.asarray(np.linalg.svd(np.nan_to_num(affine))[1][..., -1], np.float64)


def _count_near(maps: Floats, board: Floats, spacing: float, tree: cKDTree) -> NDArray[np.int64]:
    """How many LEDs have a spot near where each of the maps (k, 3, 3) puts them."""
    places = _mapped(maps, board)
    # Pixels count y downwards: a board seen from its front appears mirrored.
    affine = maps[:, :2, :2] - maps[:, :2, 2:] * maps[:, 2:, :2]
    places[np.nan_to_num(np.linalg.det(affine)) >= 0.0] = np.nan
    away = tree.query(np.nan_to_num(places, nan=1e9))[0]
    near = NEAR * spacing * _scale(maps)[:, None]
    return np.asarray((away < near).sum(axis=1), np.int64)


def _polished(
    h: Floats, board: Floats, spots: Floats, tree: cKDTree, spacing: float, least: int
) -> list[tuple[int, float, NDArray[np.int64]]]:
    """LEDs found, RMS in spacings and naming, the homography fitted to all of them; nothing if it does not fit."""
    import cv2

    chosen = np.full(len(board), -1, np.int64)
    rms = np.inf
    for _ in range(3):
        places, unit = _mapped(h, board), spacing * float(_scale(h))
        away, spot = (np.asarray(found) for found in tree.query(np.nan_to_num(places, nan=1e9)))
        chosen = np.where(away < NEAR * unit, spot, -1)
        for twice in [s for s in np.unique(chosen[chosen >= 0]) if (chosen == s).sum() > 1]:
            rows = np.nonzero(chosen == twice)[0]
            chosen[rows[np.argsort(away[rows])[1:]]] = -1
        lit = chosen >= 0
        if lit.sum() < least:
            return []
        fitted = cv2.findHomography(board[lit], spots[chosen[lit]])[0]
        if fitted is None:
            return []
        h = np.asarray(fitted, np.float64)
        off = _mapped(h, board[lit]) - spots[chosen[lit]]
        rms = float(np.sqrt((off**2).sum(axis=1).mean())) / unit
    return [(int(lit.sum()), rms, chosen.astype(np.int64))] if rms < FIT else []


def _is_symmetry(board: Floats, first: NDArray[np.int64], second: NDArray[np.int64]) -> bool:
    """Whether two namings of the very same spots differ by a turn that maps the board onto itself."""
    led_of = {int(spot): led for led, spot in enumerate(first) if spot >= 0}
    pairs = [(led, led_of.get(int(spot), -1)) for led, spot in enumerate(second) if spot >= 0]
    if any(other < 0 for _, other in pairs):
        return False
    here, there = board[[led for led, _ in pairs]], board[[other for _, other in pairs]]
    here, there = here - here.mean(axis=0), there - there.mean(axis=0)
    u, _, vt = np.linalg.svd(here.T @ there)
    return float(np.abs(here @ u @ vt - there).max()) < SYMMETRIC
