"""Robots that one camera sees pass through: its own pose, in the world, at the exposure that is asked for."""

import math

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.server.chain.answers import SURE
from asterism.server.fusing.fused import FusedPose
from asterism.server.fusing.gather import Sight, Wanted, motion_of
from asterism.server.fusing.joint_rays import Motion, shared_motion
from asterism.server.fusing.memory import Foresight
from asterism.server.fusing.solution import solutions, tilt_squares
from asterism.server.pose.choose import MOST_ODDS
from asterism.server.pose.solve import Alternative

LEAST_LEDS = 4  # of one camera alone


def passed_through(wanted: Wanted, sight: Sight, before: Foresight, evidence: float) -> tuple[FusedPose, float] | None:
    """What the only camera that sees a robot says of it, and the evidence for its tilt, nats; none if it says nothing.

    The tilt is chosen by what was known before as well: ``evidence``, nats, for where the robot should be.
    """
    (camera,) = wanted.spots
    sighting = sight.sightings[camera]
    report = sighting.told[wanted.robot]
    if not report.HasField("pose"):
        return _by_its_rays(wanted, sight)
    pose, covariance = report_pose(report.pose), np.array(report.covariance[:], np.float64).reshape(6, 6)
    pose, covariance, other, told = _tilted(report, pose, covariance, wanted, sight, before, evidence)
    if not sighting.view.rig.follows_world:  # else it is in there already
        covariance = covariance + carried(sighting.place_covariance, pose.position - sighting.T_world_camera.position)
    time_s = (sighting.exposed_ns - sight.exposed_ns) * 1e-9
    if time_s != 0.0:
        motion = motion_of(sight.courses, np.array([sight.robots[wanted.robot]]), sight.exposed_ns)
        pose, covariance = _brought(pose, covariance, time_s, motion)
        other = _brought(other, covariance, time_s, motion)[0] if other is not None else None
    alternative = None
    if other is not None and told < math.log(SURE):
        alternative = Alternative(other.position, other.orientation, math.exp(told))
    return FusedPose(pose, covariance, (camera,), report.leds, report.rms_px, alternative), told


def _tilted(
    report: "pb.RobotReport", pose: Pose, covariance: Floats, wanted: Wanted, sight: Sight, before: Foresight,
    evidence: float,
) -> tuple[Pose, Floats, Pose | None, float]:  # fmt: skip
    """The camera's pose, its covariance, the other tilt and the evidence against that, nats, by what was known."""
    if not report.HasField("alternative"):
        return pose, covariance, None, math.log(MOST_ODDS)
    other, told = report_pose(report.alternative.pose), math.log(max(report.alternative.odds, 1e-300))
    foreseen = before(wanted.robot, sight.exposed_ns)
    if foreseen is None:
        return pose, covariance, other, told
    near, far = (tilt_squares(foreseen.pose, one) for one in (pose, other))
    told += min(max(0.5 * (far - near), -evidence), evidence)
    if told >= 0.0:
        return pose, covariance, other, told
    (found,) = solutions([Wanted(wanted.robot, wanted.spots, other, wanted.misfit_m)], sight)
    return other, covariance if found is None else found.covariance, pose, -told


def _by_its_rays(wanted: Wanted, sight: Sight) -> tuple[FusedPose, float] | None:
    """A robot that its camera did not find, but that was known jointly."""
    if sum(int(np.count_nonzero(spots >= 0)) for spots in wanted.spots.values()) < LEAST_LEDS:
        return None
    (found,) = solutions([wanted], sight)
    if found is None:
        return None
    told = FusedPose(found.pose, found.covariance, tuple(wanted.spots), len(found.leds), found.rms_px)
    return told, found.evidence


def carried(place_covariance: Floats, arm: Floats) -> Floats:
    """What is not known of a camera's place (6, 6), as of a robot that is ``arm`` (3,) m from it, in the world."""
    by_place = np.eye(6)
    x, y, z = arm
    by_place[0, 4], by_place[0, 5] = z, -y
    by_place[1, 3], by_place[1, 5] = -z, x
    by_place[2, 3], by_place[2, 4] = y, -x
    out: Floats = by_place @ place_covariance @ by_place.T
    return out


def _brought(pose: Pose, covariance: Floats, time_s: float, motion: Motion) -> tuple[Pose, Floats]:
    """A pose that was seen ``time_s`` after an exposure, at that exposure."""
    age = float(motion.ages[0])
    change = 0.5 * ((age + time_s) ** 2 - age * age)
    by_rates = np.hstack([time_s * np.eye(6), change * np.eye(6)])
    way = by_rates @ motion.rates[0]
    grown = covariance + by_rates @ motion.covariances[0] @ by_rates.T
    grown = grown + shared_motion(time_s, time_s, age) * np.diag(motion.densities[0])
    return Pose.from_matrix(exp_rotation(-way[3:]) @ pose.rotation, pose.position - way[:3]), grown
