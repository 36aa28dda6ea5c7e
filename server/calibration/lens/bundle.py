"""Least squares over a lens and where a flat target was in every view.

Source: Triggs et al., "Bundle adjustment - a modern synthesis", 2000: poses are eliminated by the Schur complement.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats, exp_rotation
from asterism.server.calibration.lens.board_points import Seen
from asterism.server.calibration.lens.values import camera_of, pixels_by_lens, values_of

ITERATIONS = 60
CONVERGED = 1e-9  # relative, of the cost
HUBER = 2.5  # sigmas
CIRCLE = 24  # points of a dot's outline


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The target in one frame."""

    frame: str
    seen: Seen


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A lens, and T_camera_board of every view; the ``dot_radius`` m, 0 where points are no dots."""

    camera: Camera
    rotations: Floats  # (v, 3, 3)
    ts: Floats  # (v, 3)
    dot_radius: float = 0.0

    def without(self, view: int) -> "State":
        """Without one of the views."""
        return replace(self, rotations=np.delete(self.rotations, view, 0), ts=np.delete(self.ts, view, 0))


def residuals_of(views: Sequence[View], state: State) -> list[Floats]:
    """Observed minus predicted of every view (n, 2), px."""
    points, pixels, which = _stacked(views)
    off = pixels - _predicted(state, points, which)
    return np.split(off, np.nonzero(np.diff(which))[0] + 1)


def refine(views: Sequence[View], state: State, iterations: int = ITERATIONS, fixed_lens: bool = False) -> State:
    """Levenberg-Marquardt with Huber weights on all parameters, or with the lens as it is."""
    points, pixels, which = _stacked(views)
    off = pixels - _predicted(state, points, which)
    cost, scale = cost_of(off)
    damping = 1e-3
    for _ in range(iterations):
        weights = _weights(off, scale)
        by_lens, by_pose = _derivatives(state, points, which)
        if fixed_lens:
            by_lens = by_lens[:, :, :0]
        new = _step(state, by_lens, by_pose, off, weights, which, damping)
        new_off = pixels - _predicted(new, points, which)
        new_cost, _ = cost_of(new_off, scale)
        if np.isfinite(new_cost) and new_cost <= cost:
            gained = cost - new_cost
            state, off = new, new_off
            cost, scale = cost_of(off)
            damping = max(damping * 0.1, 1e-12)
            if gained <= CONVERGED * cost:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return state


def covariance_of(views: list[View], state: State) -> Floats:
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


def dot_radius(views: Sequence[View], state: State) -> float:
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


def _in_camera(points: Floats, rotations: Floats, ts: Floats, which: NDArray[np.int64]) -> Floats:
    return np.asarray(np.einsum("nij,nj->ni", rotations[which], points) + ts[which], np.float64)


def _stacked(views: Sequence[View]) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """All points (n, 3), pixels (n, 2) and the view (n,) of each."""
    return (
        np.concatenate([view.seen.points for view in views]),
        np.concatenate([view.seen.pixels for view in views]),
        np.repeat(np.arange(len(views)), [len(view.seen.points) for view in views]),
    )


def _predicted(state: State, points: Floats, which: NDArray[np.int64]) -> Floats:
    """Pixels (n, 2) of the points; of dots, of the centre of gravity of their image."""
    pixels = state.camera.project(_in_camera(points, state.rotations, state.ts, which))
    return pixels + dot_shift(state.camera, state.rotations, state.ts, points, which, state.dot_radius)


def cost_of(off: Floats, scale: float | None = None) -> tuple[float, float]:
    """Huber's cost of residuals, px^2, and the sigma of an axis that it rests on, px, by default their own."""
    away = np.hypot(off[:, 0], off[:, 1])
    if scale is None:
        scale = max(float(np.median(away)) / 1.1774, 1e-9)  # median of a Rayleigh distribution
    limit = HUBER * scale
    return float(np.where(away <= limit, away**2, 2.0 * limit * away - limit**2).sum()), scale


def _weights(off: Floats, scale: float) -> Floats:
    away = np.hypot(off[:, 0], off[:, 1])
    return np.asarray(np.minimum(1.0, HUBER * scale / np.maximum(away, 1e-12)), np.float64)


def _derivatives(state: State, points: Floats, which: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Of the pixels, by the lens (n, 2, p) and by the pose of the point's view (n, 2, 6): shift, rotation about the
    camera's axes. By central differences.
    """
    camera = state.camera
    in_camera = _in_camera(points, state.rotations, state.ts, which)
    by_lens = pixels_by_lens(camera, in_camera)
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
    state: State, by_lens: Floats, by_pose: Floats, off: Floats, weights: Floats, which: NDArray[np.int64],
    damping: float,
) -> State:  # fmt: skip
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
        camera = camera_of(camera, values_of(camera) + change)
    return replace(state, camera=camera, rotations=turns @ state.rotations, ts=state.ts + moves[:, :3])
