"""A robot's six LED positions from a film of it moved about.

Two rounds: positions learned from frames that a tolerant search has labelled, then the whole chain with the learned
positions, whose centres and covariances the result rests on.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from asterism.protocol.constellation import LEDS
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot
from asterism.server.calibration.leds.bundle import FEWEST_LEDS, Adjusted, Disc, Views, adjust
from asterism.server.calibration.leds.gauge import Gauge, rigid_fit, unseen_changes
from asterism.server.calibration.leds.observations import LedCentres, observe
from asterism.server.calibration.leds.tolerant import TolerantSearch
from asterism.server.chain.frame import Frame
from asterism.server.pose.lens import lens_of, undistort
from asterism.server.pose.matched import LEAST_SIGMA_PX

FEWEST_VIEWS = 12  # with all six LEDs
LEARNED_FROM = 150  # views of the first round
MOST_VIEWS = 1000  # of the second
# Spread (one sigma) of the tilts, along and across, below which motion is missing. Simulated with a lens that is off (f
# by 0.3 %, principal point by 3/-2 px, k1 by 5 %): plates held oblique, spread below 4 degrees, come out wrong by up to
# 0.1 mm; swung through more along one direction and 2 degrees across, by less than 0.02 mm.
NO_AXIS_DEG, ONE_AXIS_DEG = 4.0, 2.0
OPEN_M = 0.2e-3  # one sigma of a position that is as good as unknown
LENGTH_OFF = (0.003, 0.02)  # m and share: how far a measured distance may be from the rig's
SCALE_OFF = 0.05  # how far the size of the whole constellation may be

Frames = Callable[[], Iterable[Frame]]  # each call begins anew


@dataclass(frozen=True, slots=True, eq=False)
class LedCalibration:
    """What a film told: the adjustment, how many frames there were and how many show all six LEDs."""

    adjusted: Adjusted
    frames: int
    complete: int


def calibrate_leds(rig: Rig, robot_id: str, frames: Frames, film: str, gauge: Gauge) -> LedCalibration:
    """LED positions of a robot, in the ``gauge``'s frame, from the film that sentences call ``film``.

    Raises InputError where the film does not determine them, with the motion that is missing.
    """
    robot = rig.robot(robot_id)
    check_distance(robot, gauge.distance)
    search = TolerantSearch(rig, robot_id)
    count, seen = 0, []
    for frame in frames():
        count += 1
        if (found := search.find(frame)) is not None and found[0].count == LEDS:
            seen.append(found)
    _check_count(film, robot_id, len(seen), count)
    views = views_of(rig, _evenly(seen, LEARNED_FROM))
    check_motion(film, robot, views)
    disc = Disc.of(robot)
    learned = adjust(robot.leds, views, gauge, disc)
    check_motion(film, robot, learned.views)
    rough = replace(rig, robots=tuple(replace(r, leds=learned.leds) if r.id == robot_id else r for r in rig.robots))
    sightings = [s for _, found in observe(frames(), rough) for s in found if s.robot == robot_id]
    seen = [(s.centres, s.pose) for s in sightings if s.centres.count >= FEWEST_LEDS]
    complete = sum(centres.count == LEDS for centres, _ in seen)
    _check_count(film, robot_id, complete, count)
    adjusted = adjust(learned.leds, views_of(rig, _evenly(seen, MOST_VIEWS)), gauge, disc)
    check_motion(film, robot, adjusted.views)
    check_result(film, robot, adjusted, gauge.distance)
    return LedCalibration(adjusted, count, complete)


def views_of(rig: Rig, seen: list[tuple[LedCentres, Pose]]) -> Views:
    """Centres in px as rays with the inverse of their covariances, and the poses T_camera_robot as start."""
    n = len(seen)
    centres = np.array([c.centres_px for c, _ in seen]).reshape(-1, 2)
    spreads = np.array([c.covariances_px2 for c, _ in seen]).reshape(-1, 2, 2) + LEAST_SIGMA_PX**2 * np.eye(2)
    there = np.isfinite(centres[:, 0])
    rays, covariances = np.zeros((n * LEDS, 2)), np.zeros((int(there.sum()), 3))
    flat = np.column_stack([spreads[there, 0, 0], spreads[there, 0, 1], spreads[there, 1, 1]])
    found = np.empty((len(flat), 2))
    undistort(lens_of(rig.camera), np.ascontiguousarray(centres[there]), flat, found, covariances)
    rays[there] = found
    information = np.zeros((n * LEDS, 2, 2))
    information[there] = np.linalg.inv(covariances[:, [[0, 1], [1, 2]]])
    return Views(
        rays.reshape(n, LEDS, 2),
        information.reshape(n, LEDS, 2, 2),
        np.array([pose.rotation for _, pose in seen]),
        np.array([pose.position for _, pose in seen]),
    )


def tilt_spread_deg(robot: Robot, views: Views) -> tuple[float, float]:
    """How far the plate is turned about in a film: the spread (one sigma) of the camera's axis as the plate sees it,
    along the plate's direction in which it is widest and across, degrees. Moving about without turning changes
    nothing; nor does turning about the plate's normal unless the plate is tilted.
    """
    axis = views.rotations[:, 2, :] @ robot.T_robot_plane.rotation[:, :2]  # (v, 2)
    narrow, wide = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(axis.T)), 0.0))
    return math.degrees(float(wide)), math.degrees(float(narrow))


def check_motion(film: str, robot: Robot, views: Views) -> None:
    """Raise InputError with the motion that is missing where the views do not determine the LEDs."""
    if len(views) < FEWEST_VIEWS:
        raise InputError(
            f"{film}: only {len(views)} of its views of {robot.id} agree with one another, expected at least "
            f"{FEWEST_VIEWS}; is that robot in it, are the rig's positions within about 1 mm?"
        )
    wide, narrow = tilt_spread_deg(robot, views)
    if wide < NO_AXIS_DEG:
        raise InputError(
            f"{film}: {robot.id} keeps its tilt (it varies by {wide:.1f} degrees, one sigma), which leaves its LEDs "
            "undetermined; rotate it: tilt the robot by 20 degrees and more in at least two directions"
        )
    if narrow < ONE_AXIS_DEG:
        raise InputError(
            f"{film}: {robot.id} is tilted about one axis only (its tilt varies by {wide:.1f} degrees along one "
            f"direction of the plate and {narrow:.1f} across, one sigma), which leaves its LEDs undetermined; tilt the "
            "robot by 20 degrees and more in at least two directions, or turn it about its normal while it is tilted"
        )


def check_distance(robot: Robot, distance: tuple[int, int, float]) -> None:
    """Raise InputError for a distance that cannot be, given the rig."""
    first, second, metres = distance
    known = float(np.linalg.norm(robot.leds[first] - robot.leds[second]))
    if abs(metres - known) > LENGTH_OFF[0] + LENGTH_OFF[1] * known:
        mm = "; is that mm?" if abs(metres / 1e3 - known) < LENGTH_OFF[0] + LENGTH_OFF[1] * known else ""
        raise InputError(
            f"--distance {first},{second}={metres:g}: the rig has LEDs {first} and {second} of {robot.id} {known:.4f} "
            f"m apart, expected a distance within a few mm of that{mm or '; LEDs count from 0'}"
        )


def check_result(film: str, robot: Robot, adjusted: Adjusted, distance: tuple[int, int, float]) -> None:
    """Raise InputError where positions stay open or the scale cannot be."""
    sigmas = adjusted.sigmas
    worst = int(np.argmax(sigmas.max(axis=1)))
    if sigmas[worst].max() > OPEN_M:
        raise InputError(
            f"{film}: it leaves LED {worst} of {robot.id} open by {sigmas[worst].max() * 1e3:.2g} mm (one sigma), "
            f"expected at most {OPEN_M * 1e3:g} mm; more frames, nearer to the camera, tilted by 20 degrees and more "
            "in all directions"
        )
    scale = size_of(adjusted.leds) / size_of(robot.leds)
    if abs(scale - 1.0) > SCALE_OFF:
        raise InputError(
            f"--distance {distance[0]},{distance[1]}={distance[2]:g}: makes {robot.id} {scale:.3f} times as large as "
            "the rig has it; is that the distance of these two LEDs?"
        )


def size_of(leds: Floats) -> float:
    """Root mean square distance, m, of the LEDs (6, 3) from their middle."""
    return float(np.sqrt(((leds - leds.mean(axis=0)) ** 2).sum(axis=1).mean()))


def moved_by(leds: Floats, given: Floats) -> Floats:
    """How far (6,), m, the LEDs are from the given ones, after the best rigid fit."""
    turn, shift = rigid_fit(leds, given)
    away: Floats = np.linalg.norm(leds @ turn.T + shift - given, axis=1)
    return away


def given_sigmas(leds: Floats, given: Floats, normal: Floats) -> tuple[float, float]:
    """How far off the given positions seem to be, one sigma an axis, m: in the plate and out of it, along its unit
    ``normal`` (3,). Of the twelve numbers in it the rigid fit takes three, and three of the six out of it.
    """
    turn, shift = rigid_fit(leds, given)
    off = leds @ turn.T + shift - given
    across = off @ normal
    along = off - np.outer(across, normal)
    return float(np.sqrt((along**2).sum() / 9.0)), float(np.sqrt((across**2).sum() / 3.0))


def shape_sigma(adjusted: Adjusted) -> float:
    """One sigma an axis, m, of the LEDs among one another: of the seven numbers that no film tells the covariance has
    none, whatever holds them.
    """
    free = null_space(unseen_changes(adjusted.leds).T)
    return float(np.sqrt(np.trace(free.T @ adjusted.covariance @ free) / (3 * LEDS - 7)))


def _check_count(film: str, robot_id: str, complete: int, frames: int) -> None:
    if complete < FEWEST_VIEWS:
        raise InputError(
            f"{film}: {complete} of its {frames} frames show all six LEDs of {robot_id}, expected at least "
            f"{FEWEST_VIEWS} such frames; keep its LEDs in view and facing the camera"
        )


def _evenly(seen: list[tuple[LedCentres, Pose]], most: int) -> list[tuple[LedCentres, Pose]]:
    if len(seen) <= most:
        return seen
    return [seen[k] for k in np.linspace(0, len(seen) - 1, most).round().astype(int)]
