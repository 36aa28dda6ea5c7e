"""Where the points of a planar target are in an image."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.protocol.rig import ESTIMATORS
from asterism.server.calibration.lens.layout_match import match_layout
from asterism.server.calibration.lens.targets import Target
from asterism.server.centres.blobs import find_blobs
from asterism.server.identity.plan import LARGEST_SPOT
from asterism.server.segmentation.segment import Scratch

DICTIONARIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")
LEAST_SHARE = 0.25  # of a charuco board's corners
LEAST_CORNERS = 6
FAR_OFF = 0.3  # of the spacing: a corner that refinement moves farther is another one
DOT_SHARE = 0.45  # of the spacing: a dot and what surrounds it


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The target in one image: ``points`` (n, 3) m on the board, z = 0, their ``pixels`` (n, 2), and the ``areas`` (n,)
    px^2 of dots, None where points are no dots.
    """

    points: Floats
    pixels: Floats
    areas: Floats | None = None


def find_points(image: NDArray[np.uint8], target: Target) -> Seen | None:
    """The target's points in an image (h, w); None where it is not found. A charuco board may be seen in part."""
    if target.kind == "chessboard":
        return _chessboard(image, target)
    if target.kind == "charuco":
        return _charuco(image, target)
    if target.kind == "leds":
        return _leds(image, target)
    return _circles(image, target)


def chessboard_size(image: NDArray[np.uint8]) -> tuple[int, int] | None:
    """Columns and rows of inner corners of the chessboard in an image, however many there are."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    found, _, cells = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags=flags)
    return (int(cells.shape[1]), int(cells.shape[0])) if found else None


def _chessboard(image: NDArray[np.uint8], target: Target) -> Seen | None:
    size = (target.columns, target.rows)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(image, size, flags=flags)
    if not found:
        return None
    light = _squares(image, corners.reshape(target.rows, target.columns, 2))
    if not _between_squares(light):
        return None
    pixels = _refined(image, corners.reshape(-1, 2))[0]
    return Seen(target.points, pixels if target.symmetric or _light_first(light) else pixels[::-1])


def _squares(image: NDArray[np.uint8], grid: Floats) -> Floats:
    """How light the four squares about every corner (rows, columns, 2) are (4, rows, columns): before it along row and
    column, behind it along both, and the two others.
    """
    across, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    places = np.array([grid + 0.5 * (a * across + b * down) for a, b in ((-1, -1), (1, 1), (-1, 1), (1, -1))])
    smooth = cv2.blur(image, (3, 3)).astype(np.float64)
    return np.asarray(map_coordinates(smooth, [places[..., 1], places[..., 0]], order=1, mode="nearest"), np.float64)


def _between_squares(light: Floats) -> bool:
    """Whether every corner lies between two dark and two light squares.

    Asked for one column more than there is, the detector takes the outer corners of the outermost squares for inner
    ones (OpenCV 5.0); there three of the four squares are light.
    """
    one, other = light[:2], light[2:]
    return bool(((one.min(axis=0) > other.max(axis=0)) | (other.min(axis=0) > one.max(axis=0))).all())


def _light_first(light: Floats) -> bool:
    """Whether the first corner is the one at a light corner square, as OpenCV (5.0) counts without saying so."""
    contrast = light[:2].mean(axis=0) - light[2:].mean(axis=0)
    rows, columns = np.indices(contrast.shape)
    return bool((np.where((rows + columns) % 2 == 0, contrast, -contrast)).mean() > 0.0)


def _refined(image: NDArray[np.uint8], corners: Floats) -> tuple[Floats, Floats]:
    """Corners (n, 2) px to sub-pixel accuracy, and how far each moved in spacings.

    The detector alone was seen to put single corners of tilted boards some px off (OpenCV 5.0).
    """
    spacing = _spacings(corners)
    moved = np.empty_like(corners, dtype=np.float64)
    # Foreshortened squares want a small window, others a large one.
    windows = np.clip(0.3 * spacing, 2, 7).astype(int)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    for window in np.unique(windows):
        chosen = windows == window
        some = np.ascontiguousarray(corners[chosen], np.float32).reshape(-1, 1, 2)
        moved[chosen] = cv2.cornerSubPix(image, some, (int(window),) * 2, (-1, -1), stop).reshape(-1, 2)
    return moved, np.asarray(np.linalg.norm(moved - corners, axis=1) / spacing, np.float64)


def _spacings(corners: Floats) -> Floats:
    """Distance (n,) of every point to the nearest other, px."""
    return np.asarray(cKDTree(corners).query(corners, k=2)[0], np.float64)[:, 1]


def _charuco(image: NDArray[np.uint8], target: Target) -> Seen | None:
    """Corners of a charuco board from the centres of its markers: of whatever size and dictionary they are."""
    squares = (target.columns + 1, target.rows + 1)
    best: tuple[list[Floats], list[Floats]] = ([], [])
    for name in DICTIONARIES:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        board = cv2.aruco.CharucoBoard(squares, 1.0, 0.5, dictionary)
        corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(image)
        known = dict(zip(np.ravel(board.getIds()).tolist(), board.getObjPoints(), strict=True))
        places, pixels = [], []
        for quad, number in zip(corners, [] if ids is None else np.ravel(ids).tolist(), strict=True):
            if number in known:
                places.append(np.asarray(known[number], np.float64).reshape(4, 3)[:, :2].mean(axis=0))
                pixels.append(_crossing(np.asarray(quad, np.float64).reshape(4, 2)))
        if len(places) > len(best[0]):
            best = (places, pixels)
    if len(best[0]) < 4:
        return None
    places_known, seen = np.array(best[0]), np.array(best[1])
    wanted = target.points[:, :2] / target.pitch + 1.0  # inner corners, in squares from the board's corner
    guesses = np.full((len(wanted), 2), np.nan)
    tree = cKDTree(places_known)
    for k, place in enumerate(wanted):
        # The lens bends the board: what is near tells best.
        near = np.asarray(tree.query(place, k=min(8, len(places_known)))[1])
        if np.linalg.norm(places_known[near[0]] - place) > 1.5 or np.ptp(places_known[near], axis=0).min() < 0.5:
            continue
        h, _ = cv2.findHomography(places_known[near], seen[near])
        if h is not None:
            mapped = h @ [*place, 1.0]
            guesses[k] = mapped[:2] / mapped[2]
    height, width = image.shape
    inside = (guesses > 3.0).all(axis=1) & (guesses[:, 0] < width - 4.0) & (guesses[:, 1] < height - 4.0)
    if inside.sum() < max(LEAST_CORNERS, LEAST_SHARE * len(wanted)):
        return None
    refined, moved = _refined(image, guesses[inside])
    good = moved < FAR_OFF
    if good.sum() < max(LEAST_CORNERS, LEAST_SHARE * len(wanted)):
        return None
    return Seen(target.points[inside][good], refined[good])


def _crossing(quad: Floats) -> Floats:
    """Where the diagonals of a quadrilateral (4, 2) cross: the square's centre, in perspective as well."""
    a, b = quad[2] - quad[0], quad[3] - quad[1]
    along = np.linalg.solve(np.column_stack([a, -b]), quad[1] - quad[0])[0]
    return np.asarray(quad[0] + along * a, np.float64)


def _circles(image: NDArray[np.uint8], target: Target) -> Seen | None:
    """Dots, dark on light or light on dark: centres of gravity, and areas for the correction of their perspective."""
    grid = cv2.CALIB_CB_ASYMMETRIC_GRID if target.kind == "acircles" else cv2.CALIB_CB_SYMMETRIC_GRID
    detector = _blob_detector(image.size / len(target.points))
    for dark in (image, 255 - image):
        found, centres = cv2.findCirclesGrid(dark, (target.columns, target.rows), flags=grid, blobDetector=detector)
        if found:
            pixels, areas = _dots(dark, np.asarray(centres, np.float64).reshape(-1, 2))
            return Seen(target.points, pixels, areas)
    return None


def _blob_detector(largest: float) -> cv2.SimpleBlobDetector:
    """OpenCV's own for dots, but for those of up to ``largest`` px^2: it leaves out what is over 5000."""
    params = cv2.SimpleBlobDetector.Params()
    params.maxArea = max(params.maxArea, largest)
    return cv2.SimpleBlobDetector.create(params)


def _dots(image: NDArray[np.uint8], centres: Floats) -> tuple[Floats, Floats]:
    """Centres of gravity (n, 2) and areas (n,) px^2 of dark dots on a light board, each pixel by how dark it is.

    What is light is told by the brightest, what is dark by the darkest pixels about each dot.
    """
    pixels, areas = centres.copy(), np.zeros(len(centres))
    height, width = image.shape
    for k, reach in enumerate(DOT_SHARE * _spacings(centres)):
        x, y = centres[k]
        for _ in range(2):
            x0, x1 = max(int(x - reach), 0), min(int(np.ceil(x + reach)) + 1, width)
            y0, y1 = max(int(y - reach), 0), min(int(np.ceil(y + reach)) + 1, height)
            across, down = np.meshgrid(np.arange(x0, x1) - x, np.arange(y0, y1) - y)
            inside = np.hypot(across, down) <= reach
            window = image[y0:y1, x0:x1].astype(np.float64)
            dark, light = np.percentile(window[inside], [5, 90])
            weights = np.where(inside, np.clip((light - window) / max(light - dark, 1.0), 0.0, 1.0), 0.0)
            weights[weights < 0.1] = 0.0  # the light side's noise would pull towards the window's middle
            areas[k] = weights.sum()
            x, y = x + (weights * across).sum() / areas[k], y + (weights * down).sum() / areas[k]
        pixels[k] = x, y
    return pixels, areas


def _leds(image: NDArray[np.uint8], target: Target) -> Seen | None:
    height, width = image.shape
    blobs = find_blobs(
        np.ascontiguousarray(image), LARGEST_SPOT * float(np.hypot(width, height)), np.zeros((0, 4), np.int64),
        ESTIMATORS[0], Scratch.of(height, width),
    )  # fmt: skip
    spots = blobs.centres_px[blobs.fates == Fate.UNEXPLAINED]
    chosen = match_layout(spots, target.points[:, :2])
    if chosen is None:
        return None
    lit = chosen >= 0
    return Seen(target.points[lit], spots[chosen[lit]])
