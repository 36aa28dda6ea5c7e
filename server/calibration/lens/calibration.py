"""The steps of `asterism calibrate camera`: views chosen, models compared, refusals in words."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.server.calibration.lens.board_points import chessboard_size
from asterism.server.calibration.lens.bundle import View
from asterism.server.calibration.lens.coverage import distinct, tilts_deg
from asterism.server.calibration.lens.fit import NAMES, CameraFit, ends_inside, fit_camera
from asterism.server.calibration.lens.targets import Target

LEAST_VIEWS = 4
LEAST_POINTS = 120  # of all views: as many as four views of a small chessboard
PARALLEL_DEG = 8.0
UNSURE_FOCAL = 0.02  # relative sigma of the focal length, beyond which the views do not determine it
BETTER = 0.97  # of the held-out error: what a model must gain to be taken for a simpler one
MISFIT_SHARE = 0.02  # of the image's width: RMS beyond which the board is not the one that was said
FARTHEST_M, NEAREST_M = 30.0, 0.02


def calibrate_camera(
    views: Sequence[View], width: int, height: int, target: Target, model: str, doing: Callable[[str], None]
) -> tuple[CameraFit, dict[str, float]]:
    """The lens that the views tell of, and the held-out error, px, of every model that was tried.

    ``model`` is a name or `auto`; ``doing`` is told what is worked on. Raises InputError for views that do not
    determine it.
    """
    chosen = distinct(views)
    names = list(NAMES) if model == "auto" else [model]
    fits = {}
    for number, name in enumerate(names, 1):
        doing(f"model {number} of {len(names)}, {name}, {len(chosen)} views")
        fit = fit_camera(chosen, width, height, name)
        if fit is not None:
            fits[name] = fit
    if not fits:
        raise InputError(
            f"the views: no {' or '.join(names)} lens explains them; are columns and rows of {target.name} right?"
        )
    best = _best(fits)
    fit = fits[best]
    _refuse_parallel(fit)
    if fit.total_rms_px > MISFIT_SHARE * width:
        raise InputError(
            f"the views: the points are {fit.total_rms_px:.1f} px (RMS) from where a flat board would show them; are "
            f"columns and rows of {target.name} right?"
        )
    return fit, {name: each.total_held_out_px for name, each in fits.items()}


def refuse_too_few(
    views: Sequence[View], looked_at: int, target: Target, source: str, samples: Sequence[NDArray[np.uint8]]
) -> None:
    """Raise InputError where the target was not seen often enough; in the ``samples`` another one is looked for."""
    points = sum(len(view.seen.points) for view in views)
    if len(views) >= LEAST_VIEWS and points >= LEAST_POINTS:
        return
    hint = ""
    if target.kind == "chessboard":
        sizes = Counter(size for image in samples if (size := chessboard_size(image)) is not None)
        sizes = Counter({size: number for size, number in sizes.items() if min(size) > 3})
        if sizes:
            columns, rows = (size := sizes.most_common(1)[0][0])[0], size[1]
            columns, rows = max(columns, rows), min(columns, rows)
            if {columns, rows} != {target.columns, target.rows}:
                hint = f"; a board of {columns}x{rows} inner corners seems to be in them"
    enough = max(LEAST_VIEWS, -(-LEAST_POINTS // max(len(target.points), 1)))
    raise InputError(
        f"{source}: the target {target.name} was found in {len(views)} of {looked_at} images, expected it in {enough} "
        f"at least, 15 or more are good{hint}"
    )


def implausible(fit: CameraFit) -> str | None:
    """A hint where the board would be absurdly far or near: a wrong unit of PITCH. The lens does not depend on it."""
    distance = float(np.median(fit.ts[:, 2]))
    if distance > FARTHEST_M:
        return (
            f"the board would be {distance:.0f} m away; is PITCH in m? (the lens does not depend on it, distances do)"
        )
    if distance < NEAREST_M:
        return f"the board would be {1e3 * distance:.2g} mm away; is PITCH in m? (the lens does not depend on it)"
    return None


def _best(fits: dict[str, CameraFit]) -> str:
    """The model with the least held-out error; of nearly equal ones the simplest, and one that covers the image."""
    whole = {name: fit for name, fit in fits.items() if not ends_inside(fit.camera)} or fits
    least = min(fit.total_held_out_px for fit in whole.values())
    return next(name for name in NAMES if name in whole and least >= BETTER * whole[name].total_held_out_px)


def _refuse_parallel(fit: CameraFit) -> None:
    normals = fit.rotations[:, :, 2]
    spread = float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0))))
    unsure = fit.sigmas["fx"] / fit.camera.matrix[0, 0]
    if spread < PARALLEL_DEG or unsure > UNSURE_FOCAL:
        tilt = np.abs(tilts_deg(fit)).max(axis=0)
        raise InputError(
            f"the views: the board's tilts differ by {spread:.0f} degrees and reach {tilt[0]:.0f} and {tilt[1]:.0f} "
            f"about x and y, which leaves the focal length open to {unsure:.1%}; expected views tilted by 20 to 45 "
            "degrees about both axes"
        )
