"""T_world_camera from a board on the floor: the world is the board, with z up.

The world's origin is the board's first point, x runs along its first row; y and z are the board's where its z points to
the camera, and both the other way where it points into the floor.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.server.calibration.lens.bundle import State, View, dot_radius, dot_shift
from asterism.server.calibration.lens.lens_error import pose_by_lens
from asterism.server.calibration.lens.values import pixels_by_lens
from asterism.server.pose.lens import lens_of, undistort

CORRECTIONS = 3  # of what perspective does to dots
MOVED_PX = 1.0  # between two frames: board and camera stand still
MISFIT_PX = 2.0  # RMS beyond which the board is another one, or the lens is
ITERATIONS = 30


@dataclass(frozen=True, slots=True, eq=False)
class BoardFit:
    """T_world_camera, its ``covariance`` (6, 6) - m, rad, about the world's axes, from the residuals and the lens' own
    error, of which ``of_lens`` (6, 6) is the part - and, for every frame, the RMS residual, px, and the same against
    the fit to the other frames (nan with one frame).
    """

    T_world_camera: Pose
    covariance: Floats
    of_lens: Floats
    rms_px: Floats
    held_out_px: Floats


def fit_board(views: Sequence[View], camera: Camera, lens: Floats) -> BoardFit:
    """Fit the camera's pose to a board that lies still, its points counted alike in all views; ``lens`` (p, p) is the
    covariance of the camera's fx, fy, cx, cy and coefficients.

    Raises InputError where there is no board, where it moved, or where it does not fit.
    """
    if not views:
        raise InputError("the frames: the target is in none of them, expected it whole in one at least")
    for view in views[1:]:
        moved = _shift_px(view, views[0])
        if moved > MOVED_PX:
            raise InputError(
                f"frame {view.frame}: the target lies {moved:.1f} px from where it was in frame {views[0].frame}, "
                "expected board and camera to stand still"
            )
    T_camera_board = _solve(views, camera)
    flip = T_camera_board.rotation[:, 2] @ T_camera_board.position > 0.0
    T_board_world = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]) if flip else np.array([0.0, 0.0, 0.0, 1.0]))
    rms = np.array([_rms_px(view, T_camera_board, camera) for view in views])
    if np.median(rms) > MISFIT_PX:
        raise InputError(
            f"the target: its points are {np.median(rms):.2g} px (RMS) from where a flat board of that size would show "
            f"them, expected at most {MISFIT_PX:g}; are columns, rows and the camera's calibration right?"
        )
    held_out = np.full(len(views), np.nan)
    if len(views) > 1:
        for k, view in enumerate(views):
            held_out[k] = _rms_px(view, _solve([*views[:k], *views[k + 1 :]], camera), camera)
    T_world_camera = (T_camera_board @ T_board_world).inverse()
    own, of_lens = _covariances(views, T_camera_board, T_world_camera, camera, lens)
    return BoardFit(T_world_camera, own + of_lens, of_lens, rms, held_out)


def _shift_px(view: View, first: View) -> float:
    """Median distance of the points that both views have."""
    there, here = first.seen, view.seen
    known = {tuple(point): pixel for point, pixel in zip(there.points.tolist(), there.pixels, strict=True)}
    off = [
        float(np.linalg.norm(pixel - known[tuple(point)]))
        for point, pixel in zip(here.points.tolist(), here.pixels, strict=True)
        if tuple(point) in known
    ]
    return float(np.median(off)) if off else np.inf


def _solve(views: Sequence[View], camera: Camera) -> Pose:
    """T_camera_board that all views together fit best; of dots the images' centres are corrected for perspective."""
    points = np.concatenate([view.seen.points for view in views])
    pixels = np.concatenate([view.seen.pixels for view in views])
    T = _refined(_start(points, pixels, camera), points, pixels, camera)
    for _ in range(CORRECTIONS if views[0].seen.areas is not None else 0):
        T = _refined(T, points, pixels - _dot_shift(views, T, camera), camera)
    return T


def _start(points: Floats, pixels: Floats, camera: Camera) -> Pose:
    """By IPPE (Collins and Bartoli, 2014)."""
    import cv2

    rays, spread = np.empty_like(pixels), np.empty((len(pixels), 3))
    undistort(lens_of(camera), np.ascontiguousarray(pixels), np.zeros((len(pixels), 3)), rays, spread)
    if not np.isfinite(rays).all():
        raise InputError("the target: part of it is where the camera's lens model ends, expected it farther inside")
    _, rvec, tvec = cv2.solvePnP(points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    return Pose.from_matrix(exp_rotation(np.array(np.ravel(rvec).tolist())), np.ravel(tvec))


def _refined(T: Pose, points: Floats, pixels: Floats, camera: Camera) -> Pose:
    """Gauss-Newton on the pixels."""
    for _ in range(ITERATIONS):
        by_pose = _jacobian(points, T, camera)
        off = (pixels - camera.project(T.map(points))).ravel()
        move = np.asarray(np.linalg.solve(by_pose.T @ by_pose, by_pose.T @ off), np.float64)
        T = Pose.from_matrix(exp_rotation(move[3:]) @ T.rotation, T.position + move[:3])
        if np.abs(move).max() < 1e-11:
            break
    return T


def _dot_shift(views: Sequence[View], T_camera_board: Pose, camera: Camera) -> Floats:
    """How far the centres of the dots' images are from the images of their centres (n, 2) px; 0 for other points."""
    count = len(views)
    rotations, ts = np.tile(T_camera_board.rotation, (count, 1, 1)), np.tile(T_camera_board.position, (count, 1))
    which = np.repeat(np.arange(count), [len(view.seen.points) for view in views])
    points = np.concatenate([view.seen.points for view in views])
    return dot_shift(camera, rotations, ts, points, which, dot_radius(views, State(camera, rotations, ts)))


def _off(view: View, T_camera_board: Pose, camera: Camera) -> Floats:
    """Observed minus predicted (n, 2), px."""
    predicted = camera.project(T_camera_board.map(view.seen.points)) + _dot_shift([view], T_camera_board, camera)
    off: Floats = view.seen.pixels - predicted
    return off


def _jacobian(points: Floats, T_camera_board: Pose, camera: Camera) -> Floats:
    """Derivative (2 n, 6) of the pixels by shift and rotation about the camera's axes, by central differences."""
    columns = []
    for axis in range(6):
        pixels = []
        for step in (1e-6, -1e-6):
            move = np.zeros(6)
            move[axis] = step
            moved = Pose.from_matrix(
                exp_rotation(move[3:]) @ T_camera_board.rotation, T_camera_board.position + move[:3]
            )
            pixels.append(camera.project(moved.map(points)).ravel())
        columns.append((pixels[0] - pixels[1]) / 2e-6)
    return np.column_stack(columns)


def _rms_px(view: View, T_camera_board: Pose, camera: Camera) -> float:
    return float(np.sqrt((_off(view, T_camera_board, camera) ** 2).sum(axis=1).mean()))


def _covariances(
    views: Sequence[View], T_camera_board: Pose, T_world_camera: Pose, camera: Camera, lens: Floats
) -> tuple[Floats, Floats]:
    """Of T_world_camera, from the residuals and from the lens. Frames of a board that stands still share its errors, so
    they count as one.
    """
    points = views[0].seen.points
    by_pose = _jacobian(points, T_camera_board, camera)
    off = _off(views[0], T_camera_board, camera).ravel()
    of_board = np.linalg.inv(by_pose.T @ by_pose) * float(off @ off) / max(len(off) - 6, 1)
    by_lens = pixels_by_lens(camera, T_camera_board.map(points)).reshape(len(off), -1)
    moved = pose_by_lens(by_pose, by_lens)
    # The inverse's shift: -R' (dt + t x w), its rotation: -R' w.
    x, y, z = T_camera_board.position
    turn = T_world_camera.rotation
    chain = np.zeros((6, 6))
    chain[:3, :3] = chain[3:, 3:] = -turn
    chain[:3, 3:] = -turn @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return chain @ of_board @ chain.T, chain @ moved @ lens @ moved.T @ chain.T
