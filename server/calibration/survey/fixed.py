"""T_world_camera from constellations that stand still in the world: all their LEDs, all frames, one least squares.

Camera and constellations stand still, so that an LED's centres of all frames are one, their mean. What is left of their
noise is nothing beside what stays: LEDs that are not where the rig has them, how spots lie on the pixels. How large
that is each constellation tells for itself, by what its own pose leaves. Where they contradict each other beyond it,
their places in the rig are off; a little of that goes into the covariance, much is refused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot
from asterism.server.calibration.leds.observations import Sighting
from asterism.server.calibration.lens.lens_error import pose_by_lens
from asterism.server.calibration.lens.values import pixels_by_lens
from asterism.server.calibration.survey.world_lens import RobotError, Shares
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import lens_of, undistort
from asterism.server.pose.place import Pinned, PlaceFit, apart, fit_place, linearized, moved
from asterism.server.pose.spot_shift import optics_of, spots_at

START_PX, LEAST_PX = 0.05, 0.01  # what stays of a spot: before anything tells, and at least, one sigma of a coordinate
STOOD_PX = 0.5  # RMS by which an LED of what stands still may wander from frame to frame
POSE = 6
CONTRADICTS, CONTRADICTS_M = 5.0, 1e-3  # sigmas and m from which on a constellation is not where the others have it
SAME_TILT = 2.0  # times worse that the other tilt fits before this one is sure
FURTHER_STEP = 1e-6  # m and rad, of numeric derivatives


class Standing(NamedTuple):
    """A constellation that stands still as it was seen: ``centres`` (6, 2) px, the mean of its ``frames``, nan for LEDs
    not seen; ``poses``, T_camera_robot, one for each tilt that may be.
    """

    robot: Robot
    frames: int
    centres: Floats
    poses: tuple[Pose, ...]


class Row(NamedTuple):
    """How a constellation agrees: RMS of its residuals, px; how far it is from where the others have it, m and in
    sigmas, nan where there are no others.
    """

    robot: str
    frames: int
    leds: int
    rms_px: float
    off_m: float
    off_sigmas: float


@dataclass(frozen=True, slots=True, eq=False)
class FixedFit:
    """T_world_camera with its ``covariance`` (6, 6), m and rad about the world's axes, and the parts of it that are the
    lens' and the robots'; ``spot_px``: what stays of a spot, one sigma; ``other_tilt``: with one constellation alone,
    how many times worse its other tilt fits, nan where there is none.
    """

    T_world_camera: Pose
    covariance: Floats
    shares: Shares
    rows: tuple[Row, ...]
    spot_px: float
    other_tilt: float


def standing_of(rig: Rig, seen: Sequence[Sequence[Sighting]], source: str) -> list[Standing]:
    """The rig's fixed constellations that were located in frames. Raises InputError where none was, or one moved."""
    out = []
    fixed = [robot for robot in rig.robots if robot.T_world_fixed is not None]
    for robot in fixed:
        mine = [sighting for frame in seen for sighting in frame if sighting.robot == robot.id]
        if not mine:
            continue
        spots = np.array([sighting.centres.centres_px for sighting in mine])
        lit = np.isfinite(spots[..., 0]).sum(axis=0)
        centres = np.full((LEDS, 2), np.nan)
        centres[lit > 0] = np.nanmedian(spots[:, lit > 0], axis=0)
        wander = float(np.sqrt(np.nanmean((spots - centres) ** 2)))
        if wander > STOOD_PX:
            raise InputError(
                f"{source}: {robot.id}, which the rig has as fixed, moves by {wander:.2g} px (RMS) in the image, "
                f"expected it and the camera to stand still, to {STOOD_PX:g} px"
            )
        # Any frame's two tilts will do: the fit is of all.
        likeliest = max(mine, key=lambda sighting: (sighting.centres.count, sighting.alternative is not None))
        poses = (likeliest.pose,) if likeliest.alternative is None else (likeliest.pose, likeliest.alternative)
        out.append(Standing(robot, len(mine), centres, poses))
    if not out:
        names = ", ".join(robot.id for robot in fixed)
        raise InputError(f"{source}: none of the rig's fixed constellations ({names}) is located in its frames")
    return out


def fit_fixed(
    rig: Rig, standing: Sequence[Standing], lens: Floats, robots: Mapping[str, RobotError], source: str
) -> FixedFit:
    """Fit the camera's place; ``lens`` (p, p) is the covariance of fx, fy, cx, cy and coefficients.

    Raises InputError where the constellations contradict each other, with which.
    """
    assert rig.T_world_camera is not None
    focal = rig.camera.focal_px
    spot_px = _spot_px(rig, standing)
    parts = [_pinned(rig, one, spot_px) for one in standing]
    starts = [rig.T_world_camera, *_starts(standing)]
    fit, other_tilt = _fitted(parts, starts, rig.T_world_camera, len(standing) == 1)
    rows = []
    left = np.split(fit.residuals * focal, np.cumsum([len(part.points) for part in parts])[:-1])
    for k, (one, part, off) in enumerate(zip(standing, parts, left, strict=True)):
        rms = float(np.sqrt((off**2).mean()))
        off_m, sigmas = _off_others(parts, k, fit.T_world_camera) if len(parts) > 1 else (np.nan, np.nan)
        rows.append(Row(one.robot.id, one.frames, len(part.points), rms, off_m, sigmas))
    _refuse_contradiction(parts, rows, fit.T_world_camera, source)
    own = fit.stays * max(1.0, 1.0 + LEDS * (fit.chi2 / fit.freedom - 1.0))
    shares = _shares(rig, standing, fit.T_world_camera, lens, robots)
    return FixedFit(fit.T_world_camera, own + shares.lens + shares.robots, shares, tuple(rows), spot_px, other_tilt)


def _starts(standing: Sequence[Standing]) -> list[Pose]:
    """The places of the camera that single constellations tell."""
    return [
        one.robot.T_world_fixed @ pose.inverse()
        for one in standing
        for pose in one.poses
        if one.robot.T_world_fixed is not None
    ]


def _spot_px(rig: Rig, standing: Sequence[Standing]) -> float:
    """What stays of a spot, one sigma of a coordinate: what constellations leave that are each fitted alone."""
    squares, freedom = 0.0, 0
    for one in standing:
        part = _pinned(rig, one, START_PX)
        fit = min((fit_place(part, start) for start in _starts([one])), key=lambda fit: fit.chi2)
        squares += float((fit.residuals**2).sum()) * rig.camera.focal_px**2
        freedom += max(2 * len(part.points) - POSE, 0)
    return max(float(np.sqrt(squares / freedom)), LEAST_PX) if freedom else START_PX


def _pinned(rig: Rig, one: Standing, spot_px: float) -> Pinned:
    """The LEDs of a constellation, their rays without what shifts spots."""
    robot, pose = one.robot, one.poses[0] @ one.robot.T_robot_plane
    assert robot.T_world_fixed is not None
    lit = np.isfinite(one.centres[:, 0])
    pixels = np.empty((1, LEDS, 2))
    spots_at(
        lens_of(rig.camera), robot.leds_plane[None].copy(), optics_of(robot)[None].copy(), pose.rotation[None],
        pose.position[None].copy(), pixels,
    )  # fmt: skip
    points = pose.map(robot.leds_plane)
    shift = _rays(rig, pixels[0]) - points[:, :2] / points[:, 2:]
    stay = np.tile((spot_px / rig.camera.focal_px) ** 2 * np.eye(2), (int(lit.sum()), 1, 1))
    rays = (_rays(rig, np.where(lit[:, None], one.centres, pixels[0])) - shift)[lit]
    return Pinned(robot.T_world_fixed.map(robot.leds)[lit], rays, np.zeros_like(stay), stay)


def _rays(rig: Rig, pixels: Floats) -> Floats:
    rays = np.empty_like(pixels)
    undistort(
        lens_of(rig.camera), np.ascontiguousarray(pixels), np.zeros((len(pixels), 3)), rays, np.empty((len(pixels), 3))
    )
    return rays


def _joined(parts: Sequence[Pinned]) -> Pinned:
    return Pinned(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _fitted(parts: Sequence[Pinned], starts: Sequence[Pose], known: Pose, alone: bool) -> tuple[PlaceFit, float]:
    """The best fit, and how many times worse the other tilt of a single constellation is. Where both fit, the one that
    is nearer to where the rig has the camera.
    """
    fits = sorted((fit_place(_joined(parts), start) for start in starts), key=lambda fit: fit.chi2)
    best = fits[0]
    if not alone:
        return best, np.nan
    others = [fit for fit in fits if _turn(best, fit) > np.radians(0.5)]
    if not others:
        return best, np.nan
    worse = others[0].chi2 / max(best.chi2, 1e-12)
    if worse < SAME_TILT:
        best, other = sorted(
            (best, others[0]), key=lambda fit: float(np.linalg.norm(apart(known, fit.T_world_camera)[3:]))
        )
        worse = other.chi2 / best.chi2
    return best, worse


def _turn(a: PlaceFit, b: PlaceFit) -> float:
    return float(np.linalg.norm(apart(a.T_world_camera, b.T_world_camera)[3:]))


def _off_others(parts: Sequence[Pinned], k: int, start: Pose) -> tuple[float, float]:
    """How far a constellation is from where the others have it: RMS of its LEDs, m, and sigmas."""
    others = fit_place(_joined([part for j, part in enumerate(parts) if j != k]), start)
    by_move, off = linearized(parts[k], others.T_world_camera)
    flat = by_move.reshape(-1, POSE)
    inflated = max(1.0, others.chi2 / max(others.freedom, 1))
    spread = flat @ (inflated * others.stays) @ flat.T
    spread[np.arange(len(flat)), np.arange(len(flat))] += parts[k].stay[0, 0, 0]
    sigmas = float(np.sqrt(off.ravel() @ np.linalg.solve(spread, off.ravel()) / len(flat)))
    depth = float(np.mean((parts[k].points - start.position) @ start.rotation[:, 2]))
    return depth * float(np.sqrt((off**2).sum(axis=1).mean())), sigmas


def _refuse_contradiction(parts: Sequence[Pinned], rows: Sequence[Row], T: Pose, source: str) -> None:
    wrong = [k for k, row in enumerate(rows) if row.off_sigmas > CONTRADICTS and row.off_m > CONTRADICTS_M]
    if not wrong:
        return
    if len(rows) == 2:
        a, b = rows
        raise InputError(
            f"{source}: {a.robot} and {b.robot} contradict each other: {b.robot} is {1e3 * b.off_m:.1f} mm from where "
            f"{a.robot} has it; one of them has moved, or its `fixed` is wrong; measure them anew"
        )
    # Who is wrong makes all others look wrong: without it they agree best.
    rest = [fit_place(_joined([part for j, part in enumerate(parts) if j != k]), T).chi2 for k in range(len(parts))]
    row = rows[int(np.argmin(rest))]
    raise InputError(
        f"{source}: {row.robot} is {1e3 * row.off_m:.1f} mm ({row.off_sigmas:.0f} sigma) from where the other fixed "
        "constellations have it: it has moved, or its `fixed` is wrong; measure it anew, or take `fixed` from it"
    )


def _shares(rig: Rig, standing: Sequence[Standing], T: Pose, lens: Floats, robots: Mapping[str, RobotError]) -> Shares:
    """What the errors of lens and robots do to the place."""
    points, causes = [], []
    for k, one in enumerate(standing):
        assert one.robot.T_world_fixed is not None
        lit = np.isfinite(one.centres[:, 0])
        points.append(one.robot.T_world_fixed.map(one.robot.leds)[lit])
        shifts = np.zeros((7 * len(standing), int(lit.sum()), 3))
        if one.robot.id in robots:
            shifts[7 * k : 7 * k + 7] = _shifts(one.robot, robots[one.robot.id])[:, lit]
        causes.append(shifts)
    places, moves = np.concatenate(points), np.concatenate(causes, axis=1)

    def pixels(there: Pose, at: Floats) -> Floats:
        told: Floats = rig.camera.project(there.inverse().map(at))
        return told.ravel()

    steps = FURTHER_STEP * np.eye(POSE)
    by_place = np.stack(
        [(pixels(moved(T, step), places) - pixels(moved(T, -step), places)) / (2 * FURTHER_STEP) for step in steps], -1
    )
    in_camera = T.inverse().map(places)
    by_lens = pose_by_lens(by_place, pixels_by_lens(rig.camera, in_camera).reshape(len(by_place), -1))
    by_robots = np.stack([pixels(T, places + move) - pixels(T, places) for move in moves], -1)
    moved_by = pose_by_lens(by_place, by_robots)
    return Shares(by_lens @ lens @ by_lens.T, moved_by @ moved_by.T)


def _shifts(robot: Robot, error: RobotError) -> Floats:
    """How the LEDs of a constellation move in the world (7, 6, 3) m, for one sigma of each of its errors."""
    assert robot.T_world_fixed is not None
    leds, axes = robot.leds, robot.T_robot_plane.rotation
    out = [error.size_relative * (leds - leds.mean(axis=0))]
    out += [np.tile(error.frame_m * axis, (LEDS, 1)) for axis in np.eye(3)]
    tilts = (error.tilt_rad, error.tilt_rad, error.turn_rad)
    out += [np.cross(angle * axis, leds) for angle, axis in zip(tilts, axes.T, strict=True)]
    return np.array(out) @ robot.T_world_fixed.rotation.T
