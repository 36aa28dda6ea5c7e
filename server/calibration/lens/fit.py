"""A camera's lens model from views of a flat target: robust least squares over lens and all poses at once.

Source: Zhang, "A flexible new technique for camera calibration", 2000 (start), and `lens_bundle`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from asterism.protocol.camera import DISTORTION_MODELS, Camera
from asterism.protocol.geometry import Floats, exp_rotation
from asterism.server.calibration.lens.board_points import Seen
from asterism.server.calibration.lens.bundle import (
    State,
    View,
    cost_of,
    covariance_of,
    dot_radius,
    refine,
    residuals_of,
)
from asterism.server.calibration.lens.values import camera_of
from asterism.server.pose.lens import lens_of, undistort

NAMES = {
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
ODD = 6.0  # sigmas, from which on a point is left out
ODD_VIEW = 3.0  # times the median of all views' RMS, from which on a view is left out
LEAST_ODD_PX = 0.1  # far views have more noise than near ones, and are not odd for that
MOST_ODD_VIEWS = 1 / 3
FOLDS = 10  # of views that are held out together, where there are more than twice as many
STARTS = (1.0, 0.6, 1.6)  # of the focal length: where the closed form is misled by a strong lens
CORRECTIONS = 3


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """A lens and where the target was: ``rotations`` (v, 3, 3) and ``ts`` (v, 3) T_camera_board of the ``views``.

    ``covariance`` (p, p) is of fx, fy, cx, cy, px, and the model's coefficients, from the residuals; ``residuals`` per
    view (n, 2) px, observed minus predicted; ``rms_px`` per view and ``held_out_px`` per view, fitted without it (RMS
    of a point's distance). ``odd_points`` were left out; ``odd_views`` as well: their names and RMS, px.
    """

    camera: Camera
    covariance: Floats
    views: tuple[View, ...]
    rotations: Floats
    ts: Floats
    residuals: tuple[Floats, ...]
    rms_px: Floats
    held_out_px: Floats
    odd_points: int
    odd_views: tuple[tuple[str, float], ...]

    @property
    def total_rms_px(self) -> float:
        """RMS distance of all points that were used from where they should be."""
        return _rms(np.concatenate(self.residuals))

    @property
    def total_held_out_px(self) -> float:
        """The same of every view with the lens fitted to the others."""
        counts = np.array([len(off) for off in self.residuals])
        return float(np.sqrt((self.held_out_px**2 * counts).sum() / counts.sum()))

    @property
    def sigmas(self) -> dict[str, float]:
        """One standard deviation of every parameter, by name."""
        names = ("fx", "fy", "cx", "cy", *NAMES[self.camera.model])
        return dict(zip(names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def fit_camera(views: Sequence[View], width: int, height: int, model: str) -> CameraFit | None:
    """Lens and poses; bad points and bad views are left out. None where nothing fits."""
    nominal = Camera(
        "camera", width, height, np.diag([width, width, 1.0]), model, np.zeros(DISTORTION_MODELS[model][-1])
    )
    kept, odd_points = list(views), 0
    odd_views: list[tuple[str, float]] = []
    state = _start(kept, nominal)
    if state is None:
        return None
    while True:
        state, kept, odd = _fit_without_odd(kept, state)
        odd_points += odd
        rms = np.array([_rms(off) for off in residuals_of(kept, state)])
        worst = int(np.argmax(rms))
        few = len(odd_views) + 1 > MOST_ODD_VIEWS * len(views) or len(kept) <= 4
        if few or rms[worst] <= max(ODD_VIEW * np.median(rms), LEAST_ODD_PX):
            break
        odd_views.append((kept[worst].frame, float(rms[worst])))
        del kept[worst]
        state = state.without(worst)
    held_out = _held_out(kept, state)
    residuals = residuals_of(kept, state)
    covariance = covariance_of(kept, state)
    return CameraFit(
        state.camera, covariance, tuple(kept), state.rotations, state.ts, tuple(residuals), rms, held_out,
        odd_points, tuple(odd_views),
    )  # fmt: skip


def ends_inside(camera: Camera) -> bool:
    """Whether the lens model ends before the image does: no ray leads to some pixel of its edge."""
    x, y = np.linspace(0, camera.width - 1, 33), np.linspace(0, camera.height - 1, 33)
    edge = np.concatenate(
        [np.column_stack([x, np.full(33, v)]) for v in (0.0, camera.height - 1.0)]
        + [np.column_stack([np.full(33, u), y]) for u in (0.0, camera.width - 1.0)]
    )
    return not bool(np.isfinite(_rays(camera, edge)).all())


def _rms(off: Floats) -> float:
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _rays(camera: Camera, pixels: Floats) -> Floats:
    rays, spread = np.empty((len(pixels), 2)), np.empty((len(pixels), 3))
    undistort(lens_of(camera), np.ascontiguousarray(pixels), np.zeros((len(pixels), 3)), rays, spread)
    return rays


def _start(views: list[View], nominal: Camera) -> State | None:
    """Focal length in closed form, no distortion, every pose for itself; the best after a few steps."""
    points = [np.asarray(view.seen.points, np.float32) for view in views]
    pixels = [np.asarray(view.seen.pixels, np.float32) for view in views]
    width, height = nominal.width, nominal.height
    focal = float(cv2.initCameraMatrix2D(points, pixels, (width, height), 1.0)[0, 0])
    if not np.isfinite(focal) or focal < 0.1 * width:
        focal = float(width)
    best: tuple[float, State] | None = None
    middle = [(width - 1) / 2.0, (height - 1) / 2.0]
    for times in STARTS:
        camera = camera_of(nominal, np.array([times * focal, times * focal, *middle, *nominal.distortion]))
        poses = [_pose(view, camera) for view in views]
        if any(pose is None for pose in poses):
            continue
        state = State(
            camera,
            np.array([pose[0] for pose in poses if pose is not None]),
            np.array([pose[1] for pose in poses if pose is not None]),
        )
        state = refine(views, state, 20)
        cost = float(np.median([_rms(off) for off in residuals_of(views, state)]))
        if np.isfinite(cost) and (best is None or cost < 0.99 * best[0]):
            best = cost, state
    return None if best is None else best[1]


def _pose(view: View, camera: Camera) -> tuple[Floats, Floats] | None:
    """Rotation and translation T_camera_board of one view with that lens, by IPPE."""
    rays = _rays(camera, view.seen.pixels)
    good = np.isfinite(rays).all(axis=1)
    if good.sum() < 4:
        return None
    points = np.ascontiguousarray(view.seen.points[good])
    try:
        found, rvec, tvec = cv2.solvePnP(
            points, np.ascontiguousarray(rays[good]), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return None
    if not found or not np.isfinite(tvec).all() or float(np.ravel(tvec)[2]) <= 0.0:
        return None
    return exp_rotation(np.ravel(rvec).astype(np.float64)), np.ravel(tvec).astype(np.float64)


def _fit_without_odd(views: list[View], state: State) -> tuple[State, list[View], int]:
    """Fit, leave out points that are far off, fit again."""
    state = refine(views, state)
    for _ in range(CORRECTIONS if views[0].seen.areas is not None else 0):
        state = refine(views, replace(state, dot_radius=dot_radius(views, state)))
    off = residuals_of(views, state)
    _, scale = cost_of(np.concatenate(off))
    kept, odd = [], 0
    for view, away in zip(views, off, strict=True):
        # Of a view that is off as a whole, no point is odd.
        limit = ODD * max(scale, float(np.median(np.hypot(*away.T))) / 1.1774)
        good = np.hypot(away[:, 0], away[:, 1]) <= limit
        if good.sum() < 6:
            good[:] = True
        odd += int((~good).sum())
        seen = view.seen
        areas = None if seen.areas is None else seen.areas[good]
        kept.append(View(view.frame, Seen(seen.points[good], seen.pixels[good], areas)))
    return (refine(kept, state) if odd else state), kept, odd


def _held_out(views: list[View], state: State) -> Floats:
    """RMS (v,) px of every view's points, the lens fitted to the other views and only the pose to this one."""
    count = len(views)
    folds = [[k] for k in range(count)] if count <= 2 * FOLDS else [list(range(k, count, FOLDS)) for k in range(FOLDS)]
    rms = np.full(count, np.nan)
    for fold in folds:
        rest = [k for k in range(count) if k not in fold]
        others = replace(state, rotations=state.rotations[rest], ts=state.ts[rest])
        lens = refine([views[k] for k in rest], others).camera
        held = [views[k] for k in fold]
        posed = refine(
            held, replace(state, camera=lens, rotations=state.rotations[fold], ts=state.ts[fold]), fixed_lens=True
        )
        for k, off in zip(fold, residuals_of(held, posed), strict=True):
            rms[k] = _rms(off)
    return rms
