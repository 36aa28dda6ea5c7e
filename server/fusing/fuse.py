"""The frames of several cameras joined, exposure by exposure: the pure function at the heart of `asterism fuse`."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Floats, Pose
from asterism.server.chain.answers import NO_POSE, SURE
from asterism.server.fusing.claims import Claim, claims_of
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.fused import Fused, FusedPose
from asterism.server.fusing.gather import Rays, bodies_of, bundle_of, eyes_of
from asterism.server.fusing.joint_solve import Bundle, Motion, Poses, solve_joint
from asterism.server.fusing.memory import Joint
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.choose import MOST_ODDS
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.solve import Alternative, Lost
from asterism.server.pose.track import ACCELERATION, TURN_ACCELERATION, UNKNOWN_SPEED, UNKNOWN_TURN

UNKNOWN_RATES = np.diag([UNKNOWN_SPEED**2] * 3 + [UNKNOWN_TURN**2] * 3)
UNLIKE = math.cos(math.radians(2.5))  # half of an angle from which on two starts are two


def fuse(sightings: Sequence[Sighting], fleet: Fleet, before: Joint) -> tuple[Fused, Joint]:
    """Every robot at one exposure, from all cameras' newest frames; the same arguments give the same results.

    ``sightings`` are those of the cameras that exposed at exactly that time, one or more. ``before`` is what fusing
    the exposures before handed back, `Joint.none()` at first.
    """
    exposed_ns = sightings[0].exposed_ns
    joint = before.hearing(sightings)
    current = joint.counting(exposed_ns)
    claims = claims_of(fleet, current, _nothing)
    by_camera = {sighting.camera: sighting for sighting in current}
    answers: dict[str, FusedPose | Lost] = {}
    shared: list[Claim] = []
    for robot, claim in claims.items():
        if isinstance(claim, Lost):
            answers[robot] = claim
        elif len(claim.spots) == 1:
            answers[robot] = _passed_through(claim, by_camera, exposed_ns)
        else:
            shared.append(claim)
    if shared:
        answers |= _joined(shared, fleet, current, exposed_ns)
    cameras = tuple(sorted(sighting.camera for sighting in sightings))
    return Fused(exposed_ns, cameras, {robot: answers[robot] for robot in fleet.robots}), joint


def _nothing(_robot: str, _at_ns: int) -> None:
    return None


def _passed_through(claim: Claim, by_camera: Mapping[str, Sighting], exposed_ns: int) -> FusedPose | Lost:
    """What the only camera that sees a robot says of it."""
    (camera,) = claim.spots
    sighting = by_camera[camera]
    told = sighting.told[claim.robot]
    if not told.HasField("pose"):
        return Lost(told.reason)
    pose, covariance = report_pose(told.pose), np.array(told.covariance[:], np.float64).reshape(6, 6)
    if not sighting.view.rig.follows_world:  # else it is in there already
        covariance = covariance + carried(sighting.place_covariance, pose.position - sighting.T_world_camera.position)
    dt = (exposed_ns - sighting.exposed_ns) * 1e-9
    covariance = covariance + UNKNOWN_RATES * dt**2
    alternative = None
    if told.HasField("alternative"):
        other = report_pose(told.alternative.pose)
        alternative = Alternative(other.position, other.orientation, told.alternative.odds)
    return FusedPose(pose, covariance, (camera,), told.leds, told.rms_px, alternative)


def carried(place_covariance: Floats, arm: Floats) -> Floats:
    """What is not known of a camera's place (6, 6), as of a robot that is ``arm`` (3,) m from it, in the world."""
    by_place = np.eye(6)
    x, y, z = arm
    by_place[0, 4], by_place[0, 5] = z, -y
    by_place[1, 3], by_place[1, 5] = -z, x
    by_place[2, 3], by_place[2, 4] = y, -x
    out: Floats = by_place @ place_covariance @ by_place.T
    return out


def _joined(
    claims: Sequence[Claim], fleet: Fleet, sightings: Sequence[Sighting], exposed_ns: int
) -> dict[str, FusedPose | Lost]:
    """Poses of robots from all rays of all cameras."""
    rays, eyes = Rays(sightings, sorted(fleet.views), exposed_ns), eyes_of(fleet, sightings)
    wanted = [
        (claim, start, misfit_of(claim.robot, sightings)) for claim in claims for start in unlike_starts(claim.starts)
    ]
    bundle, poses = bundle_of(wanted, fleet, rays)
    solve_joint(eyes, bodies_of(fleet), bundle, _unknown_motion(len(wanted)), poses)
    focal = np.array([math.sqrt(view.lens[0] * view.lens[1]) for _, view in sorted(fleet.views.items())])
    tried: dict[str, list[int]] = {}
    for k, (claim, _, _) in enumerate(wanted):
        tried.setdefault(claim.robot, []).append(k)
    return {
        claim.robot: _told(tried[claim.robot], tuple(sorted(claim.spots)), bundle, poses, focal) for claim in claims
    }


def _unknown_motion(m: int) -> Motion:
    # As much as a robot that speeds up hard comes off in a frame's time.
    densities = np.array([ACCELERATION**2] * 3 + [TURN_ACCELERATION**2] * 3) / 60.0
    return Motion(np.zeros((m, 6)), np.tile(UNKNOWN_RATES, (m, 1, 1)), np.tile(densities, (m, 1)))


def unlike_starts(starts: Sequence[Pose]) -> list[Pose]:
    """The starts without those that are turned as one before them."""
    kept: list[Pose] = []
    for start in starts:
        if all(abs(float(start.orientation @ other.orientation)) < UNLIKE for other in kept):
            kept.append(start)
    return kept


def misfit_of(robot: str, sightings: Sequence[Sighting]) -> float:
    """How far off the rig has a robot's LEDs, m, by all cameras that have learned it: their root mean square."""
    known = [misfit for sighting in sightings if (misfit := sighting.misfits_m.get(robot, 0.0)) > 0.0]
    return math.sqrt(sum(misfit**2 for misfit in known) / len(known)) if known else 0.0


def _told(tried: list[int], cameras: tuple[str, ...], bundle: Bundle, poses: Poses, focal: Floats) -> FusedPose | Lost:
    """The likeliest of a robot's solutions, and the other one where that is not clearly less likely."""
    tried = sorted((k for k in tried if poses.costs[k] < NO_SOLUTION), key=lambda k: float(poses.costs[k]))
    if not tried:
        return Lost(NO_POSE)
    best, alternative = tried[0], None
    pose = Pose.from_matrix(poses.rotations[best], poses.ts[best])
    for other in tried[1:]:
        there = Pose.from_matrix(poses.rotations[other], poses.ts[other])
        evidence = 0.5 * float(poses.costs[other] - poses.costs[best])
        if abs(float(there.orientation @ pose.orientation)) < UNLIKE and evidence < math.log(SURE):
            odds = min(math.exp(evidence), MOST_ODDS)
            alternative = Alternative(there.position, there.orientation, odds)
            break
    rows = slice(bundle.first[best], bundle.first[best + 1])
    off_px = poses.residuals[rows] * focal[bundle.cameras[rows], None]
    rms_px = math.sqrt(float(np.mean(np.sum(off_px**2, axis=1))))
    leds = len(set(bundle.leds[rows].tolist()))
    return FusedPose(pose, poses.covariances[best].copy(), cameras, leds, rms_px, alternative)
