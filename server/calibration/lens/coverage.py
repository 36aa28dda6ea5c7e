"""What views of a target a calibration rests on: which of a film's, and which are missing."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.calibration.lens.bundle import View
from asterism.server.calibration.lens.fit import CameraFit

COLUMNS, ROWS = 5, 4  # cells of the image
LEAST_IN_CELL = 3  # points
ENOUGH_POINTS = 3000  # of all views: more tell next to nothing
LEAST_VIEWS, MOST_VIEWS = 20, 250
SAME_PX = 0.5  # views that differ less are one
LEAST_TILT_DEG = 15.0  # of the board against the image plane, about both axes
LEAST_DEPTHS = 1.3  # farthest over nearest
_ACROSS = ("left", "left", "middle", "right", "right")
_DOWN = ("top", "upper half", "lower half", "bottom")


def distinct(views: Sequence[View]) -> list[View]:
    """Views as different as can be, in their order: all, unless they are a film's and more than tell something.

    Farthest-point sampling (Gonzalez, 1985) of where the board's points are in the image.
    """
    most = int(np.clip(ENOUGH_POINTS // max(len(views[0].seen.points), 1), LEAST_VIEWS, MOST_VIEWS)) if views else 0
    if len(views) <= most:
        return list(views)
    signs = np.array([signature(view) for view in views])
    chosen = [0]
    away = np.abs(signs - signs[0]).max(axis=1)
    while len(chosen) < most and away.max() > SAME_PX:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.abs(signs - signs[chosen[-1]]).max(axis=1))
    return [views[k] for k in sorted(chosen)]


def signature(view: View) -> Floats:
    """Where the board is and how it lies (6,): middle of its image and both axes of the board in it, px."""
    board, pixels = view.seen.points[:, :2], view.seen.pixels
    axes, *_ = np.linalg.lstsq(np.column_stack([board - board.mean(axis=0), np.ones(len(board))]), pixels, rcond=None)
    size = float(np.ptp(board, axis=0).max())
    return np.concatenate([axes[2], size * axes[0], size * axes[1]])


def points_by_cell(views: Sequence[View], width: int, height: int) -> NDArray[np.int64]:
    """Points (ROWS, COLUMNS) that lie in each part of the image."""
    pixels = np.concatenate([view.seen.pixels for view in views])
    counts, _, _ = np.histogram2d(
        pixels[:, 1], pixels[:, 0], bins=(ROWS, COLUMNS), range=((-0.5, height - 0.5), (-0.5, width - 0.5))
    )
    return np.asarray(counts, np.int64)


def empty_parts(counts: NDArray[np.int64]) -> list[str]:
    """Names of the parts of the image without enough points, such as `top left`."""
    names: list[str] = []
    for row, column in np.argwhere(counts < LEAST_IN_CELL):
        name = f"{_DOWN[row]} {_ACROSS[column]}"
        if name not in names:
            names.append(name)
    return names


def tilts_deg(fit: CameraFit) -> Floats:
    """Tilt (v, 2) of the board in every view about the image's x and y axes, degrees."""
    normal = fit.rotations[:, :, 2] * np.sign(fit.rotations[:, 2, 2])[:, None]
    about_x, about_y = np.arctan2(-normal[:, 1], normal[:, 2]), np.arctan2(normal[:, 0], normal[:, 2])
    return np.asarray(np.degrees(np.column_stack([about_x, about_y])), np.float64)


def missing(fit: CameraFit) -> list[str]:
    """What the views do not cover, as sentences; empty where nothing is missing."""
    camera = fit.camera
    told = []
    counts = points_by_cell(fit.views, camera.width, camera.height)
    if parts := empty_parts(counts):
        told.append(f"no view covers the image's {', '.join(parts)}: poses there rest on extrapolation")
    tilts = tilts_deg(fit)
    for axis, name in ((0, "x (top or bottom nearer)"), (1, "y (left or right nearer)")):
        if np.ptp(tilts[:, axis]) < 2.0 * LEAST_TILT_DEG:
            told.append(
                f"the board's tilt about {name} varies by {np.ptp(tilts[:, axis]):.0f} degrees only, expected "
                f"{2 * LEAST_TILT_DEG:.0f} or more"
            )
    depths = fit.ts[:, 2]
    if depths.max() < LEAST_DEPTHS * depths.min():
        told.append(
            f"the board was {depths.min():.2f} to {depths.max():.2f} m away only; show it over the whole working range"
        )
    return told
