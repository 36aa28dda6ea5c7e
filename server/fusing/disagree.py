"""Cameras that contradict each other about a robot: which of them is left out, and how far off it is."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.two_digits import two_digits
from asterism.server.fusing.fused import FusedPose
from asterism.server.fusing.gather import Sight, Wanted
from asterism.server.fusing.joint_rays import residuals_at
from asterism.server.fusing.memory import Foresight
from asterism.server.fusing.passed import passed_through
from asterism.server.fusing.places import Misplaced
from asterism.server.fusing.solution import Solution, solutions, told

SURPRISE = 5.0  # sigmas of a normal error that are as unlikely
MUCH_BETTER = 0.25  # chi squared of a degree of freedom without a camera, of that with it
MOST_SPOTS = 3  # that are tried as the odd one
LEAST_LEDS = 6  # of all rays together, before one can be odd
ADVICE = "run asterism calibrate cameras"

Spots = Mapping[str, NDArray[np.int64]]


def is_surprising(chi2: float, freedom: int) -> bool:
    """Whether chi squared is larger than noise explains.

    Source: Wilson, Hilferty, "The distribution of chi-square", PNAS 17, 1931.
    """
    if freedom <= 0:
        return False
    spread = 2.0 / (9.0 * freedom)
    return chi2 > freedom * (1.0 - spread + SURPRISE * math.sqrt(spread)) ** 3


def sorted_out(
    found: Solution, sight: Sight, scale: float, before: Foresight, are_apart: bool
) -> tuple[FusedPose, Solution | None]:
    """The pose of a robot whose rays may contradict each other, and the solution that it rests on: without the spot or
    the camera that does; of two cameras that contradict each other on the more certain one, without a solution.

    ``are_apart``: of the only two cameras frames before have told that they do, even where this one does not show it.
    """
    whole = found.wanted.spots
    are_apart = are_apart and len(whole) == 2
    if not is_surprising(found.cost / scale, found.freedom) and not are_apart:
        return told(found, scale, {}), found
    if not are_apart:
        found = _without_a_spot(found, sight, scale) or _without_cameras(found, sight, scale)
    if len(found.wanted.spots) == 2 and (are_apart or is_surprising(found.cost / scale, found.freedom)):
        rather = _rather_one(found, sight, before, whole)
        if rather is not None:
            return rather, None
    left_out = [camera for camera in whole if camera not in found.wanted.spots]
    said = off_of(left_out, whole, found, sight) if left_out else {}
    grown = max(scale, found.cost / found.freedom) if is_surprising(found.cost / scale, found.freedom) else scale
    return told(found, grown, said), found


def _without_a_spot(found: Solution, sight: Sight, scale: float) -> Solution | None:
    """The solution without the one spot that spoils it, none if it is not only one."""
    if len(found.leds) <= LEAST_LEDS:
        return None
    off = np.sum((found.residuals * sight.focal_px[found.cameras, None]) ** 2, axis=1)
    odd = np.argsort(-off, kind="stable")[:MOST_SPOTS].tolist()
    wanted = []
    for row in odd:
        camera = sight.names[found.cameras[row]]
        spots = found.wanted.spots[camera].copy()
        spots[found.leds[row]] = -1
        wanted.append(replace(found.wanted, spots={**found.wanted.spots, camera: spots}, start=found.pose))
    some = [one for one in solutions(wanted, sight) if one is not None]
    best = min(some, key=lambda one: one.cost, default=None)
    return best if best is not None and not is_surprising(best.cost / scale, best.freedom) else None


def _without_cameras(found: Solution, sight: Sight, scale: float) -> Solution:
    """The solution without cameras that contradict the others, as long as more than two are left."""
    while len(found.wanted.spots) > 2 and is_surprising(found.cost / scale, found.freedom):
        wanted = [
            replace(found.wanted, spots={name: of for name, of in found.wanted.spots.items() if name != camera})
            for camera in found.wanted.spots
        ]
        some = [one for one in solutions(wanted, sight) if one is not None and one.freedom > 0]
        best = min(some, key=lambda one: one.cost / one.freedom, default=None)
        if best is None or best.cost / best.freedom > MUCH_BETTER * found.cost / found.freedom:
            break
        found = best
    return found


def _rather_one(found: Solution, sight: Sight, before: Foresight, whole: Spots) -> FusedPose | None:
    """The pose by that of two cameras which is more certain of it; its covariance tells how far the other one's is off.

    None if neither knows a pose by itself.
    """
    alone = {camera: _alone(found.wanted, camera, sight, before) for camera in found.wanted.spots}
    known = {camera: pose for camera, pose in alone.items() if pose is not None}
    if not known:
        return None
    best = min(known, key=lambda camera: float(np.linalg.slogdet(known[camera].covariance)[1]))
    pose = known[best]
    other = next(camera for camera in alone if camera != best)
    left_out = [camera for camera in whole if camera != best]
    (rest,) = solutions([replace(found.wanted, spots={best: found.wanted.spots[best]}, start=pose.pose)], sight)
    said = off_of(left_out, whole, rest or found, sight)
    if other in known:
        there, unsure = known[other].pose, known[other].covariance
    else:
        there, unsure = found.pose, found.covariance * found.cost / found.freedom
    return replace(pose, covariance=pose.covariance + _in_between(pose.pose, there) + unsure, left_out=said)


def _in_between(one: Pose, other: Pose) -> Floats:
    """Covariance (6, 6) of a pose that may as well be the other. That one has to be added for itself: along what it
    leaves open, how far they are apart is chance.
    """
    apart = np.concatenate([other.position - one.position, log_rotation(other.rotation @ one.rotation.T)])
    return np.outer(apart, apart)


def _alone(wanted: Wanted, camera: str, sight: Sight, before: Foresight) -> FusedPose | None:
    passed = passed_through(replace(wanted, spots={camera: wanted.spots[camera]}), sight, before, 0.0)
    return None if passed is None else passed[0]


def off_of(cameras: list[str], spots: Spots, found: Solution, sight: Sight) -> dict[str, str]:
    """Sentences about cameras that are left out: how far their rays are from the robot's pose by the others."""
    said = {}
    for camera in cameras:
        rays = _residuals(replace(found.wanted, spots={camera: spots[camera]}, start=found.pose), sight)
        off = math.sqrt(float(np.mean(np.sum(rays**2, axis=1))))
        k = sight.number[camera]
        depth_m = float((sight.eyes.rotations[k] @ found.pose.position + sight.eyes.ts[k])[2])
        others = " and ".join(sorted(found.wanted.spots))
        said[camera] = (
            f"its spots are {two_digits(1e3 * off * depth_m)} mm ({two_digits(off * sight.focal_px[k])} px) from where "
            f"{others} {'has' if len(found.wanted.spots) == 1 else 'have'} the robot: {ADVICE}"
        )
    return said


def _residuals(wanted: Wanted, sight: Sight) -> Floats:
    bundle, motion, poses = sight.bundle([wanted])
    residuals_at(sight.eyes, sight.bodies, bundle, motion, poses)
    return poses.residuals


def misplaced_text(found: Misplaced) -> str:
    """A sentence about a camera that is not where its rig says."""
    return (
        f"the camera is off by {two_digits(1e3 * found.off_m)} mm and {two_digits(math.degrees(found.off_rad))} "
        f"degrees, by the robots that others see as well: {ADVICE}"
    )
