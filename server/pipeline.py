"""The chain: Frame -> Blobs -> Matches -> PoseEstimate | Lost -> FrameResult. Read this first."""

import math

import numpy as np

from asterism.protocol.camera import check_image_size
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.protocol.rig import Rig
from asterism.server.blobs import Blobs, find_blobs
from asterism.server.centre import refine_leaning
from asterism.server.frame import Frame, FrameResult
from asterism.server.identify import Matches, Rays, identify, rays_of
from asterism.server.lens import undistort
from asterism.server.plan import Plan, plan_for
from asterism.server.planar import NO_SOLUTION
from asterism.server.solve import (
    Alternative,
    Lost,
    PoseEstimate,
    axis_angle_cost,
    parent_pose,
    solve_robots,
)
from asterism.server.track import Prediction, Track, Tracks, follow_track, predict, tilt_cost

SURE = 100.0  # odds beyond which the other tilt is not worth telling
MOST_ODDS = 1e12
NORMAL_SIGMA = math.radians(2.0)  # how soft the edge of a robot's cone of normals is


def localize(frame: Frame, rig: Rig, tracks: Tracks) -> tuple[FrameResult, Tracks]:
    """Find every robot of the rig in one frame; the same three arguments give the same two results.

    Raises InputError for an image that is not (h, w) uint8 of the camera's size.
    """
    image = np.ascontiguousarray(frame.image)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise InputError(
            f"frame {frame.name or frame.index}: the image is {image.dtype} of shape {image.shape}, "
            "expected uint8 of shape (height, width)"
        )
    check_image_size(rig.camera, image.shape[1], image.shape[0], f"frame {frame.name or frame.index}")
    plan = plan_for(rig)
    scratch = plan.borrow_scratch()
    blobs = find_blobs(image, plan.largest_radius_px, plan.masks, rig.centre, scratch)
    plan.return_scratch(scratch)
    seen = _rays(blobs, plan)
    known = tracks.at(frame.exposed_ns)
    matches = identify(seen, plan, _predictions(known, rig, frame.exposed_ns))
    claimed = seen.rows[matches.assignment[matches.assignment >= 0]]
    if refine_leaning(image, blobs.table, claimed, blobs.centres_px, blobs.covariances_px2):
        undistort(
            plan.lens,
            blobs.centres_px[seen.rows],
            blobs.covariances_px2[seen.rows],
            seen.rays,
            seen.covariances,
        )
    return _solve(frame, plan, blobs, seen, matches, known)


def _rays(blobs: Blobs, plan: Plan) -> Rays:
    """The kept spots, undistorted; what no ray of the lens model reaches is left out."""
    rows = blobs.kept
    rays, covariances = np.empty((len(rows), 2)), np.empty((len(rows), 3))
    undistort(plan.lens, blobs.centres_px[rows], blobs.covariances_px2[rows], rays, covariances)
    good = np.isfinite(rays[:, 0])
    if not good.all():
        rows, rays, covariances = rows[good], rays[good], covariances[good]
    return rays_of(blobs, rows, rays, covariances, plan.focal)


def _predictions(tracks: Tracks, rig: Rig, exposed_ns: int) -> dict[int, tuple[Track, Prediction]]:
    return {
        index: (tracks.by_robot[robot.id], predict(tracks.by_robot[robot.id], exposed_ns))
        for index, robot in enumerate(rig.robots)
        if robot.id in tracks.by_robot
    }


def _solve(
    frame: Frame, plan: Plan, blobs: Blobs, seen: Rays, matches: Matches, known: Tracks
) -> tuple[FrameResult, Tracks]:
    """Both minima of every matched robot, the likelier one chosen; the answers and the new tracks."""
    rig = plan.rig
    m = len(matches.robots)
    rotations, ts = np.empty((m, 2, 3, 3)), np.empty((m, 2, 3))
    costs, covariances = np.empty((m, 2)), np.empty((m, 2, 6, 6))
    residuals = np.empty((m, 2, 6, 2))
    solve_robots(
        plan.layouts[matches.robots], matches.assignment, seen.rays, seen.covariances, blobs.centres_px[seen.rows],
        matches.rotations, matches.ts, matches.is_warm, plan.lens, rotations, ts, costs, covariances, residuals,
    )  # fmt: skip
    answers: dict[str, PoseEstimate | Lost] = {}
    tracked: dict[str, Track] = dict(known.by_robot)
    for k, index in enumerate(matches.robots.tolist()):
        robot = rig.robots[index]
        before = known.by_robot.get(robot.id)
        totals = [
            costs[k, which] + _prior(plan, index, before, frame.exposed_ns, rotations[k, which])
            if costs[k, which] < NO_SOLUTION
            else NO_SOLUTION
            for which in range(2)
        ]
        best = 0 if totals[0] <= totals[1] else 1
        if totals[best] >= NO_SOLUTION:
            answers[robot.id] = Lost("no pose that faces the camera explains its spots")
            continue
        other = 1 - best
        evidence = 0.5 * (min(totals[other], NO_SOLUTION) - totals[best])
        odds = math.exp(min(evidence, math.log(MOST_ODDS)))
        T_robot_plane = plan.Ts_robot_plane[index]
        pose, covariance = parent_pose(
            rig.T_world_camera, T_robot_plane, rotations[k, best], ts[k, best], covariances[k, best]
        )
        alternative = None
        if odds < SURE:
            alternative = Alternative(
                parent_pose(
                    rig.T_world_camera,
                    T_robot_plane,
                    rotations[k, other],
                    ts[k, other],
                    covariances[k, other],
                )[0],
                odds,
            )
        leds = np.flatnonzero(matches.assignment[k] >= 0)
        spots = seen.rows[matches.assignment[k, leds]]
        blobs.fates[spots] = Fate.LED
        blobs.robots[spots] = index
        blobs.leds[spots] = leds
        left = residuals[k, best, leds]
        answers[robot.id] = PoseEstimate(
            pose=pose,
            covariance=covariance,
            leds=tuple(leds.tolist()),
            spots=tuple(spots.tolist()),
            residuals_px=left,
            rms_px=math.sqrt(float((left**2).sum()) / len(leds)),
            alternative=alternative,
        )
        tracked[robot.id] = follow_track(
            before,
            frame.exposed_ns,
            rotations[k, best],
            ts[k, best],
            covariances[k, best],
            float(np.median(blobs.heights[spots])),
            rotations[k, other] if costs[k, other] < NO_SOLUTION else None,
            evidence,
        )
    for index, robot in enumerate(rig.robots):
        if robot.id not in answers:
            answers[robot.id] = _lost(matches.doubts.get(index), len(seen.rows))
    in_order = {robot.id: answers[robot.id] for robot in rig.robots}
    return FrameResult(frame.index, frame.exposed_ns, blobs, in_order), Tracks(tracked)


def _prior(plan: Plan, index: int, before: Track | None, exposed_ns: int, rotation: Floats) -> float:
    """What is known beforehand against a tilt, in units of chi squared: the track, the rig's surface normal."""
    cost = tilt_cost(before, exposed_ns, rotation) if before is not None else 0.0
    normal = plan.rig.robots[index].normal
    if normal is not None and plan.rig.T_world_camera is not None:
        robot = plan.rig.robots[index]
        axis = rotation @ plan.Ts_robot_plane[index].rotation.T @ robot.axis
        cost += axis_angle_cost(plan.rig.T_world_camera.rotation @ axis, normal.world, normal.within_rad, NORMAL_SIGMA)
    return cost


def _lost(doubt: str | None, spots: int) -> Lost:
    if doubt is not None:
        return Lost(doubt, "IDENTITY_AMBIGUOUS")
    return Lost("none of its LEDs is visible" if spots == 0 else "its constellation is not among the spots")
