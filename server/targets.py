"""Planar calibration targets: what people name on the command line, and where their points are in an image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats


@dataclass(frozen=True, slots=True)
class Target:
    """A board with ``columns`` x ``rows`` points, ``pitch`` m apart."""

    kind: str
    columns: int
    rows: int
    pitch: float


def parse_target(text: str) -> Target:
    """The target that ``KIND:COLSxROWS:PITCH`` names. Raises InputError."""
    kind, _, rest = text.partition(":")
    size, _, pitch_text = rest.partition(":")
    columns, _, rows = size.partition("x")
    try:
        pitch = float(pitch_text)
    except ValueError:
        pitch = 0.0
    if kind != "chessboard" or not columns.isdigit() or not rows.isdigit() or not 0 < pitch < 10:
        raise InputError(f"--target {text}: expected chessboard:COLSxROWS:PITCH, inner corners and m")
    return Target(kind, int(columns), int(rows), pitch)


def find_target(image: NDArray[np.uint8], target: Target) -> tuple[Floats, Floats] | None:
    """The target's points in an image (h, w): object points (n, 3) m, z = 0, and image points (n, 2) px; None where it
    is not found.
    """
    import cv2

    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(image, (target.columns, target.rows), flags=flags)
    if not found:
        return None
    # The detector alone was seen to put single corners of tilted boards some px off (OpenCV 5.0).
    grid = corners.reshape(target.rows, target.columns, 2)
    spacing = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min()) for axis in (0, 1))
    window = (max(2, min(7, int(0.3 * spacing))),) * 2
    corners = cv2.cornerSubPix(
        image, corners, window, (-1, -1), (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    )
    row, column = np.divmod(np.arange(target.columns * target.rows), target.columns)
    points = np.column_stack([column, row, np.zeros(len(row))]) * target.pitch
    return points, corners.reshape(-1, 2).astype(np.float64)
