"""A camera's lens model from views of a flat target: robust least squares over lens and all poses at once.

Source: Zhang, "A flexible new technique for camera calibration", 2000 (start); Triggs et al., "Bundle adjustment - a
modern synthesis", 2000 (poses eliminated by the Schur complement).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import DISTORTION_MODELS, Camera
from asterism.protocol.geometry import Floats, exp_rotation
from asterism.server.board_points import Seen
from asterism.server.lens import lens_of, undistort

NAMES = {
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
ITERATIONS = 60
CONVERGED = 1e-9  # relative, of the cost
HUBER = 2.5  # sigmas
ODD = 6.0  # sigmas, from which on a point is left out
ODD_VIEW = 3.0  # times the median of all views' RMS, from which on a view is left out
LEAST_ODD_PX = 0.1  # far views have more noise than near ones, and are not odd for that
MOST_ODD_VIEWS = 1 / 3
FOLDS = 10  # of views that are held out together, where there are more than twice as many
STARTS = (1.0, 0.6, 1.6)  # of the focal length: where the closed form is misled by a strong lens
CIRCLE = 24  # points of a dot's outline
CORRECTIONS = 3


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The target in one frame."""

    frame: str
    seen: Seen


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


def fit_camera(views: Sequence[View], width: int, height: int, model: str, name: str = "camera") -> CameraFit | None:
    """Lens and poses; bad points and bad views are left out. None where nothing fits."""
    size = _Size(name, width, height)
    kept, odd_points = list(views), 0
    odd_views: list[tuple[str, float]] = []
    state = _start(kept, size, model)
    if state is None:
        return None
    while True:
        state, kept, odd = _fit_without_odd(kept, state)
        odd_points += odd
        rms = np.array([_rms(off) for off in _residuals(state.camera, kept, state)])
        worst = int(np.argmax(rms))
        few = len(odd_views) + 1 > MOST_ODD_VIEWS * len(views) or len(kept) <= 4
        if few or rms[worst] <= max(ODD_VIEW * np.median(rms), LEAST_ODD_PX):
            break
        odd_views.append((kept[worst].frame, float(rms[worst])))
        del kept[worst]
        state = state.without(worst)
    held_out = _held_out(kept, state)
    residuals = _residuals(state.camera, kept, state)
    covariance = _covariance(kept, state)
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


@dataclass(frozen=True, slots=True)
class _Size:
    name: str
    width: int
    height: int


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    camera: Camera
    rotations: Floats  # (v, 3, 3)
    ts: Floats  # (v, 3)
    dot_radius: float = 0.0  # m

    def without(self, view: int) -> "_State":
        return replace(self, rotations=np.delete(self.rotations, view, 0), ts=np.delete(self.ts, view, 0))


def _rms(off: Floats) -> float:
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _rays(camera: Camera, pixels: Floats) -> Floats:
    rays, spread = np.empty((len(pixels), 2)), np.empty((len(pixels), 3))
    undistort(lens_of(camera), np.ascontiguousarray(pixels), np.zeros((len(pixels), 3)), rays, spread)
    return rays


def _camera(size: _Size | Camera, model: str, values: Floats) -> Camera:
    fx, fy, cx, cy = values[:4]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return Camera(size.name, size.width, size.height, matrix, model, np.array(values[4:]))


def _values(camera: Camera) -> Floats:
    m = camera.matrix
    return np.concatenate([[m[0, 0], m[1, 1], m[0, 2], m[1, 2]], camera.distortion])


def _start(views: list[View], size: _Size, model: str) -> _State | None:
    """Focal length in closed form, no distortion, every pose for itself; the best after a few steps."""
    points = [np.asarray(view.seen.points, np.float32) for view in views]
    pixels = [np.asarray(view.seen.pixels, np.float32) for view in views]
    guess = cv2.initCameraMatrix2D(points, pixels, (size.width, size.height), 1.0)
    focal = float(guess[0, 0])
    if not np.isfinite(focal) or focal < 0.1 * size.width:
        focal = float(size.width)
    best: tuple[float, _State] | None = None
    none = np.zeros(DISTORTION_MODELS[model][-1])
    for times in STARTS:
        middle = [(size.width - 1) / 2.0, (size.height - 1) / 2.0]
        camera = _camera(size, model, np.array([times * focal, times * focal, *middle, *none]))
        poses = [_pose(view, camera) for view in views]
        if any(pose is None for pose in poses):
            continue
        state = _State(
            camera,
            np.array([pose[0] for pose in poses if pose is not None]),
            np.array([pose[1] for pose in poses if pose is not None]),
        )
        state = _refine(views, state, 20)
        cost = float(np.median([_rms(off) for off in _residuals(state.camera, views, state)]))
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


def _in_camera(points: Floats, rotations: Floats, ts: Floats, which: NDArray[np.int64]) -> Floats:
    return np.asarray(np.einsum("nij,nj->ni", rotations[which], points) + ts[which], np.float64)


def _stacked(views: Sequence[View]) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """All points (n, 3), pixels (n, 2) and the view (n,) of each."""
    return (
        np.concatenate([view.seen.points for view in views]),
        np.concatenate([view.seen.pixels for view in views]),
        np.repeat(np.arange(len(views)), [len(view.seen.points) for view in views]),
    )


def _predicted(state: _State, points: Floats, which: NDArray[np.int64]) -> Floats:
    """Pixels (n, 2) of the points; of dots, of the centre of gravity of their image."""
    pixels = state.camera.project(_in_camera(points, state.rotations, state.ts, which))
    return pixels + dot_shift(state.camera, state.rotations, state.ts, points, which, state.dot_radius)


def dot_shift(
    camera: Camera, rotations: Floats, ts: Floats, points: Floats, which: NDArray[np.int64], radius: float
) -> Floats:
    """Centre of gravity of a dot's image minus the image of its centre (n, 2) px: perspective eccentricity, and the
    lens'. Source: the outline projected, the polygon's centroid (shoelace formula).
    """
    if radius == 0.0:
        return np.zeros((len(points), 2))
    turn = np.arange(CIRCLE) * 2.0 * np.pi / CIRCLE
    # A polygon of the circle's area.
    out = radius * np.sqrt(2.0 * np.pi / (CIRCLE * np.sin(2.0 * np.pi / CIRCLE)))
    outline = points[:, None] + out * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(CIRCLE)])
    flat = outline.reshape(-1, 3)
    ring = camera.project(_in_camera(flat, rotations, ts, np.repeat(which, CIRCLE))).reshape(-1, CIRCLE, 2)
    centre = camera.project(_in_camera(points, rotations, ts, which))
    ring = ring - centre[:, None]
    following = np.roll(ring, -1, axis=1)
    cross = ring[..., 0] * following[..., 1] - ring[..., 1] * following[..., 0]
    return np.asarray(((ring + following) * cross[..., None]).sum(axis=1) / (3.0 * cross.sum(axis=1))[:, None])


def _residuals(camera: Camera, views: Sequence[View], state: _State) -> list[Floats]:
    points, pixels, which = _stacked(views)
    off = pixels - _predicted(replace(state, camera=camera), points, which)
    return np.split(off, np.nonzero(np.diff(which))[0] + 1)


def _dot_radius(views: Sequence[View], state: _State) -> float:
    """Radius of the dots, m, by their areas and the scale of the view at each; 0 where points are no dots."""
    if any(view.seen.areas is None for view in views):
        return 0.0
    points, _, which = _stacked(views)
    areas = np.concatenate([view.seen.areas for view in views if view.seen.areas is not None])
    step = 1e-6
    sides = [
        state.camera.project(_in_camera(points + shift, state.rotations, state.ts, which))
        for shift in (np.zeros(3), np.array([step, 0.0, 0.0]), np.array([0.0, step, 0.0]))
    ]
    u, v = (sides[1] - sides[0]) / step, (sides[2] - sides[0]) / step
    scale = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    return float(np.sqrt(np.median(areas / scale) / np.pi))


def _refine(views: Sequence[View], state: _State, iterations: int = ITERATIONS, fixed_lens: bool = False) -> _State:
    """Levenberg-Marquardt with Huber weights on all parameters, or with the lens as it is."""
    points, pixels, which = _stacked(views)
    off = pixels - _predicted(state, points, which)
    cost, scale = _cost(off)
    damping = 1e-3
    for _ in range(iterations):
        weights = _weights(off, scale)
        by_lens, by_pose = _derivatives(state, points, which)
        if fixed_lens:
            by_lens = by_lens[:, :, :0]
        new = _step(state, by_lens, by_pose, off, weights, which, damping)
        new_off = pixels - _predicted(new, points, which)
        new_cost, _ = _cost(new_off, scale)
        if np.isfinite(new_cost) and new_cost <= cost:
            gained = cost - new_cost
            state, off = new, new_off
            cost, scale = _cost(off)
            damping = max(damping * 0.1, 1e-12)
            if gained <= CONVERGED * cost:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return state


def _cost(off: Floats, scale: float | None = None) -> tuple[float, float]:
    """Huber's cost of residuals, px^2, and the sigma of an axis that it rests on, px, by default their own."""
    away = np.hypot(off[:, 0], off[:, 1])
    if scale is None:
        scale = max(float(np.median(away)) / 1.1774, 1e-9)  # median of a Rayleigh distribution
    limit = HUBER * scale
    return float(np.where(away <= limit, away**2, 2.0 * limit * away - limit**2).sum()), scale


def _weights(off: Floats, scale: float) -> Floats:
    away = np.hypot(off[:, 0], off[:, 1])
    return np.asarray(np.minimum(1.0, HUBER * scale / np.maximum(away, 1e-12)), np.float64)


def _derivatives(state: _State, points: Floats, which: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Of the pixels, by the lens (n, 2, p) and by the pose of the point's view (n, 2, 6): shift, rotation about the
    camera's axes. By central differences.
    """
    camera, values = state.camera, _values(state.camera)
    in_camera = _in_camera(points, state.rotations, state.ts, which)
    by_lens = np.empty((len(points), 2, len(values)))
    for k in range(len(values)):
        step = 1e-3 if k < 4 else 1e-6
        ahead, behind = values.copy(), values.copy()
        ahead[k] += step
        behind[k] -= step
        by_lens[:, :, k] = (
            _camera(camera, camera.model, ahead).project(in_camera)
            - _camera(camera, camera.model, behind).project(in_camera)
        ) / (2.0 * step)
    arms = in_camera - state.ts[which]
    by_point = np.empty((len(points), 2, 3))
    steps = 1e-6 * np.abs(in_camera[:, 2])
    for axis in range(3):
        shift = np.zeros((len(points), 3))
        shift[:, axis] = steps
        by_point[:, :, axis] = (camera.project(in_camera + shift) - camera.project(in_camera - shift)) / (
            2.0 * steps[:, None]
        )
    turned = np.cross(np.eye(3)[None], arms[:, None])  # (n, 3, 3): row k is e_k x arm
    by_pose = np.concatenate([by_point, by_point @ np.swapaxes(turned, 1, 2)], axis=2)
    return by_lens, by_pose


def _blocks(
    by_lens: Floats, by_pose: Floats, off: Floats, weights: Floats, which: NDArray[np.int64], count: int
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Normal equations: lens (p, p), mixed (v, p, 6), poses (v, 6, 6), and their right sides (p,), (v, 6)."""
    p = by_lens.shape[2]
    lens = np.einsum("nij,nik,n->jk", by_lens, by_lens, weights)
    right = np.einsum("nij,ni,n->j", by_lens, off, weights)
    mixed, poses, pose_right = np.zeros((count, p, 6)), np.zeros((count, 6, 6)), np.zeros((count, 6))
    np.add.at(mixed, which, np.einsum("nij,nik,n->njk", by_lens, by_pose, weights))
    np.add.at(poses, which, np.einsum("nij,nik,n->njk", by_pose, by_pose, weights))
    np.add.at(pose_right, which, np.einsum("nij,ni,n->nj", by_pose, off, weights))
    return lens, mixed, poses, right, pose_right


def _step(
    state: _State, by_lens: Floats, by_pose: Floats, off: Floats, weights: Floats, which: NDArray[np.int64],
    damping: float,
) -> _State:  # fmt: skip
    lens, mixed, poses, right, pose_right = _blocks(by_lens, by_pose, off, weights, which, len(state.ts))
    lens = lens + damping * np.diag(np.diag(lens))
    poses = poses * (1.0 + damping * np.eye(6))
    back = np.linalg.pinv(poses, hermitian=True)
    change = np.zeros(len(right))
    if len(right):
        reduced = lens - np.einsum("vij,vjk,vlk->il", mixed, back, mixed)
        change = np.linalg.lstsq(reduced, right - np.einsum("vij,vjk,vk->i", mixed, back, pose_right), rcond=None)[0]
    moves = np.einsum("vij,vj->vi", back, pose_right - np.einsum("vij,i->vj", mixed, change))
    turns = np.array([exp_rotation(move[3:]) for move in moves])
    camera = state.camera
    if len(right):
        camera = _camera(camera, camera.model, _values(camera) + change)
    return replace(state, camera=camera, rotations=turns @ state.rotations, ts=state.ts + moves[:, :3])


def _fit_without_odd(views: list[View], state: _State) -> tuple[_State, list[View], int]:
    """Fit, leave out points that are far off, fit again."""
    state = _refine(views, state)
    for _ in range(CORRECTIONS if views[0].seen.areas is not None else 0):
        state = _refine(views, replace(state, dot_radius=_dot_radius(views, state)))
    off = _residuals(state.camera, views, state)
    _, scale = _cost(np.concatenate(off))
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
    return (_refine(kept, state) if odd else state), kept, odd


def _held_out(views: list[View], state: _State) -> Floats:
    """RMS (v,) px of every view's points, the lens fitted to the other views and only the pose to this one."""
    count = len(views)
    folds = [[k] for k in range(count)] if count <= 2 * FOLDS else [list(range(k, count, FOLDS)) for k in range(FOLDS)]
    rms = np.full(count, np.nan)
    for fold in folds:
        rest = [k for k in range(count) if k not in fold]
        others = replace(state, rotations=state.rotations[rest], ts=state.ts[rest])
        lens = _refine([views[k] for k in rest], others).camera
        held = [views[k] for k in fold]
        posed = _refine(
            held, replace(state, camera=lens, rotations=state.rotations[fold], ts=state.ts[fold]), fixed_lens=True
        )
        for k, off in zip(fold, _residuals(lens, held, posed), strict=True):
            rms[k] = _rms(off)
    return rms


def _covariance(views: list[View], state: _State) -> Floats:
    """Of the lens' parameters, the residuals' own variance on all points alike."""
    points, pixels, which = _stacked(views)
    off = pixels - _predicted(state, points, which)
    by_lens, by_pose = _derivatives(state, points, which)
    lens, mixed, poses, _, _ = _blocks(by_lens, by_pose, off, np.ones(len(off)), which, len(views))
    reduced = lens - np.einsum("vij,vjk,vlk->il", mixed, np.linalg.pinv(poses, hermitian=True), mixed)
    freedom = max(2 * len(off) - len(lens) - 6 * len(views), 1)
    size = np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    inverse = np.linalg.pinv(reduced / np.outer(size, size), hermitian=True) / np.outer(size, size)
    return np.asarray(inverse * float((off**2).sum()) / freedom, np.float64)
