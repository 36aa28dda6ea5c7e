"""Robots solved from all rays of all cameras that see them, each start by itself."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.server.chain.answers import SURE
from asterism.server.fusing.fused import FusedPose
from asterism.server.fusing.gather import Sight, Wanted
from asterism.server.fusing.joint_rays import Bundle, Poses
from asterism.server.fusing.joint_solve import solve_joint
from asterism.server.pose.choose import MOST_ODDS
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.solve import Alternative
from asterism.server.pose.track import TILT_SIGMA

UNLIKE = math.cos(math.radians(2.5))  # half of an angle from which on two poses are two


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A robot's pose T_world_robot by its `Wanted`: ``covariance`` (6, 6) as of a `FusedPose`, the part of it that is
    ``noise`` (6, 6); chi squared of the residuals, ``cost``; ``residuals`` (n, 2), rays, of the ``cameras`` (n,) by
    their numbers and the ``leds`` (n,), with the root mean square ``rms_px``. ``evidence`` for it over the
    ``alternative``, nats.
    """

    wanted: Wanted
    rms_px: float
    pose: Pose
    covariance: Floats
    noise: Floats
    cost: float
    residuals: Floats
    cameras: NDArray[np.int64]
    leds: NDArray[np.int64]
    alternative: Alternative | None = None
    evidence: float = math.log(MOST_ODDS)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals."""
        return 2 * len(self.leds) - 6


def solutions(wanted: Sequence[Wanted], sight: Sight) -> list[Solution | None]:
    """Each of the wanted robots by itself; none where there is no pose."""
    if not wanted:
        return []
    bundle, motion, poses = sight.bundle(wanted)
    solve_joint(sight.eyes, sight.bodies, bundle, motion, poses)
    off_px = poses.residuals * sight.focal_px[bundle.cameras, None]
    squares = np.concatenate([[0.0], np.cumsum(np.sum(off_px * off_px, axis=1))])[bundle.first]
    rms_px = np.sqrt(np.diff(squares) / np.diff(bundle.first)).tolist()
    costs, first = poses.costs.tolist(), bundle.first.tolist()
    return [
        _solution(k, one, rms_px[k], slice(first[k], first[k + 1]), bundle, poses) if costs[k] < NO_SOLUTION else None
        for k, one in enumerate(wanted)
    ]


def _solution(k: int, wanted: Wanted, rms_px: float, rows: slice, bundle: Bundle, poses: Poses) -> Solution:
    return Solution(
        wanted,
        rms_px,
        Pose.from_matrix(poses.rotations[k], poses.ts[k]),
        poses.covariances[k],
        poses.noise[k],
        float(poses.costs[k]),
        poses.residuals[rows],
        bundle.cameras[rows],
        bundle.leds[rows],
    )


def tilt_squares(foreseen: Pose, pose: Pose) -> float:
    """Squared sigmas by which a tilt is off what was foreseen."""
    turn = log_rotation(pose.rotation @ foreseen.rotation.T)
    return float(turn @ turn) / TILT_SIGMA**2


def are_unlike(one: Pose, other: Pose) -> bool:
    """Whether two poses are turned so unlike that they are two tilts."""
    return abs(float(one.orientation @ other.orientation)) < UNLIKE


def unlike_starts(starts: Sequence[Pose]) -> list[Pose]:
    """The starts without those that are turned as one before them."""
    kept: list[Pose] = []
    for start in starts:
        if all(are_unlike(start, other) for other in kept):
            kept.append(start)
    return kept


def likelier(found: Sequence[Solution | None], leaning: Sequence[float]) -> Solution | None:
    """The likeliest of one robot's solutions, with the other tilt where that is not clearly less likely; ``leaning``
    are nats that earlier exposures have for each.
    """
    some = [(0.5 * one.cost - lean, one) for one, lean in zip(found, leaning, strict=True) if one is not None]
    if not some:
        return None
    some.sort(key=lambda entry: entry[0])
    (least, best), others = some[0], some[1:]
    for cost, other in others:
        if are_unlike(best.pose, other.pose):
            evidence = min(cost - least, math.log(MOST_ODDS))
            told = Alternative(other.pose.position, other.pose.orientation, math.exp(evidence))
            return replace(best, alternative=told if told.odds < SURE else None, evidence=evidence)
    return best


def told(found: Solution, scale: float, left_out: dict[str, str]) -> FusedPose:
    """A solution as fusing tells it: its covariance times ``scale``."""
    return FusedPose(
        found.pose,
        scale * found.covariance,
        tuple(sorted(found.wanted.spots)),
        len(set(found.leds.tolist())),
        found.rms_px,
        found.alternative,
        left_out,
    )
