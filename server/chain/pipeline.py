"""The chain: Frame -> Blobs -> Matches -> PoseEstimate | Lost -> FrameResult. Read this first."""

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import check_image_size
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.centres.blobs import Blobs, Ints, find_blobs
from asterism.server.centres.common_light import find_common_light
from asterism.server.centres.compression import is_compressed
from asterism.server.centres.leaning_spots import refine_leaning
from asterism.server.centres.streaks import streak_moments
from asterism.server.centres.weighted import weigh_spots
from asterism.server.chain.answers import answers_of
from asterism.server.chain.forgetting import forgetful, learned_at
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.standing import Seen, of_place, stand
from asterism.server.chain.world import Following, carried_over, place_before, place_now
from asterism.server.identity.identify import identify
from asterism.server.identity.plan import Plan, plan_for
from asterism.server.identity.rays import Rays, rays_of
from asterism.server.pose.choose import Choices, choose
from asterism.server.pose.common_noise import common_noise
from asterism.server.pose.common_shift import add_common_shifts
from asterism.server.pose.led_doubt import own_scatter
from asterism.server.pose.lens import FX, undistort, undistort_again
from asterism.server.pose.matched import Matched, Measured
from asterism.server.pose.rolling import Setup, at_own_rows, solve_rolling
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.streaks import straighten
from asterism.server.pose.track import Tracks
from asterism.server.segmentation.spot_table import NOISE, SHOULDER

QUIET = 0.5  # grey levels: few sensors have less noise


def localize(frame: Frame, rig: Rig, tracks: Tracks) -> tuple[FrameResult, Tracks]:
    """Find every robot of the rig in one frame; the same three arguments give the same two results.

    Raises InputError for an image that is not (h, w) uint8 of the camera's size.
    """
    image = _image_of(frame, rig)
    plan = plan_for(rig)
    known = tracks.copy_for(len(rig.robots))
    before = place_before(tracks, rig, frame.exposed_ns) if rig.follows_world else None
    if before is not None:
        plan = plan.at(before.T_world_camera)
    learned = learned_at(known, frame.exposed_ns)
    blobs = _blobs(image, plan)
    seen = rays_of(blobs, plan)
    matches = identify(seen, plan, _at_own_rows(known, frame, plan), frame.exposed_ns)
    claimed = _claimed(seen, matches.found)
    # What compression leaves beside a spot is no light.
    leaning = bool(np.any(blobs.table[:, SHOULDER]))
    rounded = (leaning or bool(np.any(blobs.table[:, NOISE] < QUIET))) and is_compressed(image)
    if leaning and not rounded:
        _part_leaning(image, blobs, seen, matches.found, claimed, plan)
    commons = _other_light(image, blobs, seen, matches.found, claimed, plan, rounded)
    if rounded and plan.shutter is None:
        _take_common_noise(blobs, seen, matches.found, claimed, plan, learned)
    if plan.some_scatter:
        _take_known_light(image, blobs, seen, matches.found, claimed, plan)
    if plan.shutter is None:
        solutions, shown = _solve(image, blobs, seen, matches.found, claimed, plan, learned, commons)
        choices = _choose(frame, seen, matches.found, solutions, plan, known)
    else:
        solutions, choices, known, at_rest = _solve_rolling(frame, blobs, seen, matches.found, plan, known, commons)
        shown = Seen(at_rest[0], commons, at_rest[1])
    if before is None:
        stood = stand(plan, matches.found, shown, solutions, choices, frame.exposed_ns, tracks, known)
        answers = answers_of(plan, blobs, seen, matches, solutions, choices, stood)
        return FrameResult(frame.index, frame.exposed_ns, blobs, answers, learned), forgetful(known)
    place = place_now(before, plan, blobs, seen, matches.found, solutions)
    carried_over(choices, before.T_world_camera, place)
    plan = plan.at(place.T_world_camera)
    if plan.underfoot is not None:
        shown = shown._replace(terms=shown.terms + of_place(place, solutions, choices))
    stood = stand(plan, matches.found, shown, solutions, choices, frame.exposed_ns, tracks, known)
    answers = answers_of(plan, blobs, seen, matches, solutions, choices, stood)
    result = FrameResult(frame.index, frame.exposed_ns, blobs, answers, learned, place)
    return result, forgetful(Following.of(known, place))


def _image_of(frame: Frame, rig: Rig) -> NDArray[np.uint8]:
    """The frame's image, if it is one of the rig's camera."""
    image = np.ascontiguousarray(frame.image)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise InputError(
            f"frame {frame.name or frame.index}: the image is {image.dtype} of shape {image.shape}, "
            "expected uint8 of shape (height, width)"
        )
    check_image_size(rig.camera, image.shape[1], image.shape[0], f"frame {frame.name or frame.index}")
    # Kernels are compiled anew for read-only arrays, and might then round differently.
    return image if image.flags.writeable else image.copy()


def _blobs(image: NDArray[np.uint8], plan: Plan) -> Blobs:
    """Every bright spot, with its centre."""
    scratch = plan.borrow_scratch()
    blobs = find_blobs(image, plan.largest_radius_px, plan.masks, plan.rig.centre, scratch)
    plan.return_scratch(scratch)
    return blobs


def _claimed(seen: Rays, found: Matched) -> Ints:
    """The rows (m, 6) of the spots that are the LEDs of the robots found, -1 for LEDs not seen."""
    return np.where(found.assignment >= 0, seen.rows.take(found.assignment), -1)


def _part_leaning(
    image: NDArray[np.uint8], blobs: Blobs, seen: Rays, found: Matched, claimed: Ints, plan: Plan
) -> None:
    """Centre those robots' spots anew that other light leans on: in the blobs and in the rays."""
    # What LEDs whose light is known are strange by is their own.
    leaning = claimed[~plan.has_scatter[found.robots]]
    if refine_leaning(image, blobs.table, leaning, blobs.centres_px, blobs.covariances_px2):
        undistort(plan.lens, blobs.centres_px[seen.rows], blobs.covariances_px2[seen.rows], seen.rays, seen.covariances)


def _take_known_light(
    image: NDArray[np.uint8], blobs: Blobs, seen: Rays, found: Matched, claimed: Ints, plan: Plan
) -> None:
    """Spots of LEDs whose light is known have their centres, and in the rays their scatter, as their led.yaml says."""
    weighted = claimed[plan.is_weighted[found.robots]]
    if len(weighted):
        weigh_spots(image, blobs.table, weighted, blobs.centres_px)
    for k in np.flatnonzero(plan.has_scatter[found.robots]).tolist():
        rays = found.assignment[k][found.assignment[k] >= 0]
        spots = seen.rows[rays]
        spreads = blobs.covariances_px2[spots]
        offset = plan.rig.robots[found.robots[k]].led_offset
        spreads[:, ::2] += own_scatter(offset, blobs.table[spots, SHOULDER])[:, None]
        undistorted = np.empty((len(rays), 2)), np.empty((len(rays), 3))
        undistort(plan.lens, blobs.centres_px[spots], spreads, *undistorted)
        seen.rays[rays], seen.covariances[rays] = undistorted


def _other_light(
    image: NDArray[np.uint8], blobs: Blobs, seen: Rays, found: Matched, claimed: Ints, plan: Plan, rounded: bool
) -> Floats:
    """What light beside all LEDs of a robot may have moved their spots by together: covariances (m, 3) of rays. What
    leans on single ones is in their own covariances after it, in the blobs and in the rays, unless the picture is
    ``rounded`` (`compression`).

    LEDs whose light is known (`led.yaml`) have what they spill in what is known of them.
    """
    robots = np.where(plan.has_scatter[found.robots, None], -1, claimed) if plan.some_scatter else claimed
    commons, widened = np.empty((len(robots), 3)), np.zeros(len(blobs), np.bool_)
    covariances = blobs.covariances_px2.copy() if rounded else blobs.covariances_px2
    if find_common_light(image, blobs.table, robots, blobs.centres_px, covariances, widened, commons) and not rounded:
        pixels = seen.rows, blobs.centres_px, covariances
        undistort_again(plan.lens, *pixels, widened, seen.rays, seen.covariances)
    if np.count_nonzero(commons):
        some = np.flatnonzero(commons[:, 0])
        # Where each is seen: at one of its LEDs.
        places = np.ascontiguousarray(blobs.centres_px[robots[some].max(axis=1)])
        rays = np.empty((len(some), 3))
        undistort(plan.lens, places, commons[some], np.empty_like(places), rays)
        commons[some] = rays
    return commons


def _solve(
    image: NDArray[np.uint8],
    blobs: Blobs,
    seen: Rays,
    found: Matched,
    claimed: Ints,
    plan: Plan,
    learned: Floats,
    commons: Floats,
) -> tuple[Solutions, Seen]:
    """Both minima of every matched robot. An LED whose spot turns out to be odd leaves the assignment."""
    measured = Measured(seen.rays, seen.covariances, blobs.centres_px[seen.rows])
    solutions = Solutions.room(len(found.ts), learned[found.robots])
    streaks = _straighten(image, blobs, found, claimed, plan, measured)
    solve_robots(plan.lens, plan.constellations, found, measured, solutions)
    if streaks is not None:
        solutions.covariances[...] += streaks[:, None]
    add_common_shifts(plan.constellations, found, measured, commons, plan.lens[FX], solutions)
    return solutions, Seen(measured, commons, np.zeros((len(found.ts), 6, 6)) if streaks is None else streaks)


def _take_common_noise(blobs: Blobs, seen: Rays, found: Matched, claimed: Ints, plan: Plan, learned: Floats) -> None:
    """Widen all spots by what the robots' residuals show beyond their covariances; in the blobs and in the rays."""
    tried = found._replace(assignment=found.assignment.copy())
    measured = Measured(seen.rays, seen.covariances, blobs.centres_px[seen.rows])
    solutions = Solutions.room(len(found.ts), learned[found.robots])
    solve_robots(plan.lens, plan.constellations, tried, measured, solutions)
    more = common_noise(solutions, claimed, blobs.covariances_px2)
    if more > 0.0:
        blobs.covariances_px2[seen.rows, ::2] += more
        undistort(plan.lens, blobs.centres_px[seen.rows], blobs.covariances_px2[seen.rows], seen.rays, seen.covariances)


def _straighten(
    image: NDArray[np.uint8], blobs: Blobs, found: Matched, claimed: Ints, plan: Plan, measured: Measured
) -> Floats | None:
    """Put spots that are streaks where they would be at mid-exposure; what that leaves open (m, 6, 6) of the poses."""
    moments = np.empty((*claimed.shape, 3))
    if not streak_moments(image, blobs.table, claimed, found.rotations, found.ts, moments):
        return None
    # How they turned and dimmed depends on how they are tilted: a first solution says that.
    m = len(claimed)
    first = Solutions.room(m)
    as_seen = found._replace(assignment=found.assignment.copy())
    solve_robots(plan.lens, plan.constellations, as_seen, measured, first)
    likelier = np.arange(m), first.costs.argmin(axis=1)
    tilted = found._replace(rotations=first.rotations[likelier], ts=first.ts[likelier])
    terms = np.empty((m, 6, 6))
    straighten(plan.lens, plan.constellations, tilted, measured, moments, terms)
    return terms


def _choose(frame: Frame, seen: Rays, found: Matched, solutions: Solutions, plan: Plan, known: Tracks) -> Choices:
    """The likelier minimum of every robot, in the parent frame. Writes the tracks."""
    choices = Choices.room(len(found.ts))
    choose(found, frame.exposed_ns, solutions, seen.heights, plan.mounts, known, choices)
    return choices


def _at_own_rows(known: Tracks, frame: Frame, plan: Plan) -> Tracks:
    """Where a rolling shutter will see the robots."""
    if plan.shutter is None:
        return known
    return at_own_rows(known, frame.exposed_ns, plan.lens, plan.shutter)


def _solve_rolling(
    frame: Frame, blobs: Blobs, seen: Rays, found: Matched, plan: Plan, known: Tracks, commons: Floats
) -> tuple[Solutions, Choices, Tracks, tuple[Measured, Floats]]:
    """Solutions and choices at mid-frame, of LEDs each of which was seen at its own row's time, as `solve_rolling`."""
    assert plan.shutter is not None
    measured = Measured(seen.rays, seen.covariances, blobs.centres_px[seen.rows])
    setup = Setup(plan.lens, plan.constellations, plan.mounts, plan.shutter)
    return solve_rolling(setup, found, measured, seen.heights, commons, frame.exposed_ns, known)
