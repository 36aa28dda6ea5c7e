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
from asterism.server.pose.lens import lens_of, undistort

MOVED_PX = 1.0  # between two frames: board and camera stand still
MISFIT_PX = 2.0  # RMS beyond which the board is another one, or the lens is
ITERATIONS = 30


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The board in one frame: ``points`` (n, 3) m on the board, z = 0, and ``pixels`` (n, 2)."""

    frame: str
    points: Floats
    pixels: Floats


@dataclass(frozen=True, slots=True, eq=False)
class BoardFit:
    """T_world_camera, its ``covariance`` (6, 6) - m, rad, about the world's axes, from the residuals - and, for every
    frame, the RMS residual, px, and the same against the fit to the other frames (nan with one frame).
    """

    T_world_camera: Pose
    covariance: Floats
    rms_px: Floats
    held_out_px: Floats


def fit_board(views: Sequence[View], camera: Camera) -> BoardFit:
    """Fit the camera's pose to a board that lies still.

    Raises InputError where there is no board, where it moved, or where it does not fit.
    """
    if not views:
        raise InputError("the frames: the target is in none of them, expected it whole in one at least")
    views = [views[0], *(_same_way_round(view, views[0]) for view in views[1:])]
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
    return BoardFit(T_world_camera, _covariance(views, T_camera_board, T_world_camera, camera), rms, held_out)


def _same_way_round(view: View, first: View) -> View:
    """A board that looks the same turned by half may be counted from its other end: then count it back."""
    turned = View(view.frame, view.points, view.pixels[::-1])
    return turned if _shift_px(turned, first) < _shift_px(view, first) else view


def _shift_px(view: View, first: View) -> float:
    """Median distance of the points that both views have."""
    known = {tuple(point): pixel for point, pixel in zip(first.points.tolist(), first.pixels, strict=True)}
    off = [
        float(np.linalg.norm(pixel - known[tuple(point)]))
        for point, pixel in zip(view.points.tolist(), view.pixels, strict=True)
        if tuple(point) in known
    ]
    return float(np.median(off)) if off else np.inf


def _solve(views: Sequence[View], camera: Camera) -> Pose:
    """T_camera_board that all views together fit best: IPPE, then Gauss-Newton on the pixels."""
    import cv2

    points, pixels = np.concatenate([v.points for v in views]), np.concatenate([v.pixels for v in views])
    rays, spread = np.empty_like(pixels), np.empty((len(pixels), 3))
    undistort(lens_of(camera), np.ascontiguousarray(pixels), np.zeros((len(pixels), 3)), rays, spread)
    if not np.isfinite(rays).all():
        raise InputError("the target: part of it is where the camera's lens model ends, expected it farther inside")
    _, rvec, tvec = cv2.solvePnP(points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    T = Pose.from_matrix(exp_rotation(np.array(np.ravel(rvec).tolist())), np.ravel(tvec))
    for _ in range(ITERATIONS):
        by_pose = _jacobian(points, T, camera)
        off = (pixels - camera.project(T.map(points))).ravel()
        move = np.asarray(np.linalg.solve(by_pose.T @ by_pose, by_pose.T @ off), np.float64)
        T = Pose.from_matrix(exp_rotation(move[3:]) @ T.rotation, T.position + move[:3])
        if np.abs(move).max() < 1e-11:
            break
    return T


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
    off = view.pixels - camera.project(T_camera_board.map(view.points))
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _covariance(views: Sequence[View], T_camera_board: Pose, T_world_camera: Pose, camera: Camera) -> Floats:
    """Of T_world_camera. Frames of a board that stands still share its errors, so they count as one."""
    points, pixels = views[0].points, views[0].pixels
    by_pose = _jacobian(points, T_camera_board, camera)
    off = (pixels - camera.project(T_camera_board.map(points))).ravel()
    of_board = np.linalg.inv(by_pose.T @ by_pose) * float(off @ off) / max(len(off) - 6, 1)
    # The inverse's shift: -R' (dt + t x w), its rotation: -R' w.
    x, y, z = T_camera_board.position
    turn = T_world_camera.rotation
    chain = np.zeros((6, 6))
    chain[:3, :3] = chain[3:, 3:] = -turn
    chain[:3, 3:] = -turn @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    moved: Floats = chain @ of_board @ chain.T
    return moved
