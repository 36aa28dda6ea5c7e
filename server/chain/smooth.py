"""Smoothing, only where somebody asks for it (`--smooth`): poses of successive frames joined by a motion model.

A filter after `localize`, which never sees it: poses that nobody asked to smooth rest on their frame alone. It takes
the published pose with its published covariance and gives back both; a robot that has no pose in a frame gets none here
either, whatever could be predicted. Its memory is a value that is passed in and handed back, like `Tracks`.

Filter: `belief`, over several manners of moving (`manners`), from a robot that all but stands still to one that starts
and stops hard; how well each foresaw the measured poses weighs them. So a still robot is smoothed much, one that starts
hardly, and the covariance, spread of the manners included, follows. It is causal: it takes a start for noise until it
is more than that.

Errors that stay the same from frame to frame do not average out (`stays`): the filter is told of the others alone, and
what stays is added to what it is sure of. Where other LEDs are seen than before, what stays is another.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import Velocity
from asterism.protocol.rig import Rig
from asterism.server.chain.belief import Belief, Sight, Step, begin, go_on, together, twists
from asterism.server.chain.frame import FrameResult
from asterism.server.chain.manners import MANNERS, changes
from asterism.server.chain.stays import Told, drifts, what_stays
from asterism.server.chain.turns import exp_rotations
from asterism.server.pose.solve import Lost, PoseEstimate
from asterism.server.pose.track import FORGET_NS

FILTER = "interacting multiple model, constant twist"
JUMP = 38.0  # chi squared (six degrees of freedom, one in a million) from which on a pose does not continue the motion

# What each manner leads to soon: clients that predict a pose must reckon with a start or a stop. A density that grows
# with time moves a robot, by then, as one that always was a quarter of what it came to: this is for 0.1 s.
AHEAD_S = 0.025
_TO_COME = changes(np.array([AHEAD_S]))[0] @ np.column_stack(
    [np.maximum(MANNERS.along, MANNERS.across), np.maximum(MANNERS.yaw, MANNERS.tilt)]
)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedPose(PoseEstimate):
    """A pose that the filter joined to those before, and how the robot moves."""

    velocity: Velocity | None = None


class Seen(NamedTuple):
    """Poses of n robots in a frame: what was seen, what of their covariances ``stays`` (n, 6, 6), and by which LEDs, -1
    among them for the surface.
    """

    sight: Sight
    stays: Floats
    leds: Sequence[tuple[int, ...]]


class Motion(NamedTuple):
    """One robot's motion, its rows of a `Belief`; when it was seen last, and by which LEDs."""

    seen_ns: int
    leds: tuple[int, ...]
    rotation: Floats
    states: Floats
    covariances: Floats
    weights: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """What smoothing remembers: the motion of every robot that had a pose, by its id."""

    robots: Mapping[str, Motion] = field(default_factory=dict)

    @staticmethod
    def none() -> "Motions":
        """No memory: the next pose of every robot is left as it is."""
        return Motions()


def smooth(result: FrameResult, before: Motions, rig: Rig) -> tuple[FrameResult, Motions]:
    """The frame's result with its poses smoothed and labelled so, and the memory for the next frame.

    Position, orientation and covariance are the filter's; residuals and the alternative of an ambiguous tilt stay what
    the frame said. A pose that does not continue the motion (after `track.FORGET_NS` out of sight, a jump, the other
    tilt) is left as measured, and the filter starts from it.
    """
    poses = {robot: answer for robot, answer in result.answers.items() if isinstance(answer, PoseEstimate)}
    if not poses:
        return result, before
    seen = seen_in(result, rig)
    known = [before.robots.get(robot) for robot in poses]
    belief, _ = follow(known, result.exposed_ns, seen)
    motions = dict(before.robots)
    for k, robot in enumerate(poses):
        motions[robot] = Motion(result.exposed_ns, seen.leds[k], *(part[k] for part in belief))
    told = estimates(belief, seen.stays)
    answers: dict[str, PoseEstimate | Lost] = dict(result.answers)
    for robot, (pose, covariance, velocity) in zip(poses, told, strict=True):
        answers[robot] = smoothed(poses[robot], pose, covariance, velocity, FILTER)
    return replace(result, answers=answers), Motions(motions)


def seen_in(result: FrameResult, rig: Rig) -> Seen:
    """The poses of a frame, of all robots that have one, in their order."""
    rows = [k for k, robot in enumerate(rig.robots) if isinstance(result.answers[robot.id], PoseEstimate)]
    poses = [answer for answer in result.answers.values() if isinstance(answer, PoseEstimate)]
    positions, covariances = (np.array([getattr(pose, name) for pose in poses]) for name in ("position", "covariance"))
    spots = result.blobs.covariances_px2
    own_px2 = np.array([spots[list(pose.spots)][:, ::2].mean() for pose in poses])
    place = result.place
    camera = (place.T_world_camera, place.covariance) if place is not None else None
    by_spots = np.array([_by_spots(pose) for pose in poses])
    stays = what_stays(Told(positions, covariances, own_px2, result.learned[rows], by_spots), rig, camera)
    axes = np.array([rig.robots[k].T_robot_plane.rotation[:, 2] for k in rows])
    rotations = np.array([pose.pose.rotation for pose in poses])
    # With the surface what stays is another than without: as if other LEDs were seen.
    leds = [(*pose.leds, -1) if _rests(pose) else pose.leds for pose in poses]
    return Seen(Sight(positions, rotations, covariances - stays, axes), stays, leds)


def _rests(pose: PoseEstimate) -> bool:
    """Whether a pose rests on the surface as well as on light."""
    return pose.surface is not None and pose.surface.by_spots is not None


def _by_spots(pose: PoseEstimate) -> Floats:
    """What of its covariance the spots make, nan where it does not say."""
    if pose.surface is not None and pose.surface.by_spots is not None:
        return pose.surface.by_spots
    return np.full((6, 6), np.nan)


def smoothed(seen: PoseEstimate, pose: Pose, covariance: Floats, velocity: Velocity, smoothed_by: str) -> SmoothedPose:
    """A frame's pose as a filter has it."""
    return SmoothedPose(
        position=pose.position,
        orientation=pose.orientation,
        covariance=covariance,
        leds=seen.leds,
        spots=seen.spots,
        residuals_px=seen.residuals_px,
        rms_px=seen.rms_px,
        alternative=seen.alternative,
        smoothed_by=smoothed_by,
        extrapolated=seen.extrapolated,
        surface=seen.surface,
        velocity=velocity,
    )


def follow(known: Sequence[Motion | None], exposed_ns: int, seen: Seen) -> tuple[Belief, dict[int, Step]]:
    """What is believed of n robots after one more frame, and by which step it came there, of those that went on: by
    the robots' places.
    """
    going = [k for k, motion in enumerate(known) if motion and 0 < exposed_ns - motion.seen_ns <= FORGET_NS]
    belief, steps = begin(seen.sight), dict[int, Step]()
    if not going:
        return belief, steps
    motions = [motion for k in going if (motion := known[k]) is not None]
    before = Belief(*(np.array([motion[part] for motion in motions]) for part in range(2, 6)))
    dt = np.array([(exposed_ns - motion.seen_ns) * 1e-9 for motion in motions])
    stays = seen.stays[going]
    other = np.array([motion.leds != seen.leds[k] for motion, k in zip(motions, going, strict=True)])
    after, step = go_on(before, Sight(*(part[going] for part in seen.sight)), dt, other[:, None, None] * stays, stays)
    for row, k in enumerate(going):
        if step.chi2[row] <= JUMP:
            steps[k] = Step(*(part[row : row + 1] for part in step))
            for target, source in zip(belief, after, strict=True):
                target[k] = source[row]
    return belief, steps


def estimates(belief: Belief, stays: Floats) -> list[tuple[Pose, Floats, Velocity]]:
    """Pose, covariance (6, 6) and velocity of n robots; ``stays`` (n, 6, 6) is added to what the filter is sure of."""
    states, covariances = together(belief)
    covariances[:, :6, :6] += stays
    rotations = exp_rotations(states[:, 3:6]) @ belief.rotations
    told, spreads = twists(rotations, states, covariances)
    spreads += drifts(told, rotations, stays)
    pushes, swerves = (belief.weights @ _TO_COME).T.tolist()
    return [
        (
            Pose.from_matrix(rotations[k], states[k, :3]),
            covariances[k, :6, :6].copy(),
            Velocity(told[k, :3], told[k, 3:], spreads[k], (pushes[k], swerves[k])),
        )
        for k in range(len(states))
    ]
