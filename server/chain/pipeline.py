"""The chain: Frame -> Blobs -> Matches -> PoseEstimate | Lost -> FrameResult. Read this first."""

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import check_image_size
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.centres.blobs import Blobs, find_blobs
from asterism.server.centres.centre import refine_leaning
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.identity.identify import Matches, Rays, identify, rays_of
from asterism.server.identity.plan import Plan, plan_for
from asterism.server.pose.choose import choose
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import undistort, undistort_kept
from asterism.server.pose.solve import Alternative, Lost, PoseEstimate, solve_robots
from asterism.server.pose.track import Tracks
from asterism.server.segmentation.segment import tell_whose

ALL_LEDS = tuple(range(LEDS))
SURE = 100.0  # odds beyond which the other tilt is not worth telling


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
    if not image.flags.writeable:
        # Kernels are compiled anew for read-only arrays, and might then round differently.
        image = image.copy()
    plan = plan_for(rig)
    scratch = plan.borrow_scratch()
    blobs = find_blobs(image, plan.largest_radius_px, plan.masks, rig.centre, scratch)
    plan.return_scratch(scratch)
    seen = _rays(blobs, plan)
    known = tracks.copy_for(len(rig.robots))
    matches = identify(seen, plan, known, frame.exposed_ns)
    claimed = seen.rows[matches.assignment[matches.assignment >= 0]]
    if refine_leaning(image, blobs.table, claimed, blobs.centres_px, blobs.covariances_px2):
        undistort(plan.lens, blobs.centres_px[seen.rows], blobs.covariances_px2[seen.rows], seen.rays, seen.covariances)
    answers = _answers(frame, plan, blobs, seen, matches, known)
    return FrameResult(frame.index, frame.exposed_ns, blobs, answers), known


def _rays(blobs: Blobs, plan: Plan) -> Rays:
    """The kept spots, undistorted; what no ray of the lens model reaches is left out."""
    n = len(blobs)
    rows, rays, covariances = np.empty(n, np.int64), np.empty((n, 2)), np.empty((n, 3))
    count = undistort_kept(plan.lens, blobs.fates, blobs.centres_px, blobs.covariances_px2, rows, rays, covariances)
    rows, rays, covariances = rows[:count], rays[:count], covariances[:count]
    return rays_of(blobs, rows, rays, covariances, plan.focal)


def _answers(
    frame: Frame, plan: Plan, blobs: Blobs, seen: Rays, matches: Matches, known: Tracks
) -> dict[str, PoseEstimate | Lost]:
    """Both minima of every matched robot, the likelier one chosen. Writes the tracks and the blobs' fates."""
    m = len(matches.robots)
    rotations, ts = np.empty((m, 2, 3, 3)), np.empty((m, 2, 3))
    costs, covariances, residuals = np.empty((m, 2)), np.empty((m, 2, 6, 6)), np.empty((m, 2, 6, 2))
    solve_robots(
        plan.layouts[matches.robots], matches.assignment, seen.rays, seen.covariances, blobs.centres_px[seen.rows],
        matches.rotations, matches.ts, plan.lens, plan.optics[matches.robots],
        rotations, ts, costs, covariances, residuals,
    )  # fmt: skip
    best, odds = np.empty(m, np.int64), np.empty(m)
    positions, quaternions, parent_covariances = np.empty((m, 2, 3)), np.empty((m, 2, 4)), np.empty((m, 6, 6))
    choose(
        matches.robots, frame.exposed_ns, rotations, ts, costs, covariances, matches.assignment, seen.heights,
        plan.view, plan.eye, plan.plane_rotations, plan.plane_origins, plan.axes, plan.normals, plan.within,
        known.seen_ns, known.rotations, known.ts, known.velocities, known.turns, known.other_rotations,
        known.numbers, best, odds, positions, quaternions, parent_covariances,
    )  # fmt: skip
    extrapolated = _correct_z(plan, positions, parent_covariances)
    # What can be done for all robots at once is; Python is slow at small arrays.
    spots, left, rms = np.empty((m, LEDS), np.int64), np.empty((m, LEDS, 2)), np.empty(m)
    tell_whose(
        matches.robots, matches.assignment, seen.rows, best, residuals, blobs.fates, blobs.robots, blobs.leds,
        spots, left, rms,
    )  # fmt: skip
    found: dict[int, PoseEstimate | Lost] = {}
    for k, (index, chosen, odd, rms_k, spots_k) in enumerate(
        zip(matches.robots.tolist(), best.tolist(), odds.tolist(), rms.tolist(), spots.tolist(), strict=True)
    ):
        if chosen < 0:
            found[index] = Lost("no pose that faces the camera explains its spots")
            continue
        lit = ALL_LEDS if -1 not in spots_k else tuple(led for led in ALL_LEDS if spots_k[led] >= 0)
        found[index] = PoseEstimate(
            position=positions[k, 0],
            orientation=quaternions[k, 0],
            covariance=parent_covariances[k],
            leds=lit,
            spots=tuple(spots_k) if lit is ALL_LEDS else tuple(spots_k[led] for led in lit),
            residuals_px=left[k] if lit is ALL_LEDS else left[k, list(lit)],
            rms_px=rms_k,
            alternative=Alternative(positions[k, 1], quaternions[k, 1], odd) if odd < SURE else None,
            extrapolated=extrapolated is not None and bool(extrapolated[k]),
        )
    return {
        robot.id: found[index] if index in found else _lost(matches.doubts.get(index), len(seen.rows))
        for index, robot in enumerate(plan.rig.robots)
    }


def _correct_z(plan: Plan, positions: Floats, covariances: Floats) -> NDArray[np.bool_] | None:
    """Add the rig's correction of the camera's Z to both candidates' positions (m, 2, 3) in the parent frame, and its
    variance to the chosen one's covariances (m, 6, 6); returns whose was extrapolated.
    """
    correction = plan.rig.z_correction
    if correction is None:
        return None
    m = len(positions)
    found = correction.at((positions.reshape(-1, 3) - plan.eye) @ plan.view)
    along = plan.view[:, 2]
    positions += found.dz.reshape(m, 2, 1) * along
    covariances[:, :3, :3] += found.variances[::2, None, None] * np.outer(along, along)
    return found.extrapolated[::2]


def _lost(doubt: str | None, spots: int) -> Lost:
    if doubt is not None:
        return Lost(doubt, "IDENTITY_AMBIGUOUS")
    return Lost("none of its LEDs is visible" if spots == 0 else "its constellation is not among the spots")
