"""Robots whose pose is known already, before or from some cameras: their other spots in all cameras."""

import math

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Pose, log_rotation
from asterism.protocol.rig import Robot
from asterism.server.centres.blobs import Ints
from asterism.server.fusing.joined import Hypothesis, Joined
from asterism.server.fusing.near_spots import CLEARLY

LEAST = 6  # LEDs seen, in all cameras together, by which a robot stays known that no camera claims
LEAST_IN_ONE = 4  # or in one of them
LEAST_ODDS = 4.0  # nats against chance
MARGIN = 7.0  # nats by which one tilt must explain more than the other
SIGMAS = 5.2  # of chi squared about its mean, its own sigma the unit, beyond which a fit is none
FARTHEST = 44.0  # squared sigmas (six degrees of freedom) from where it was foreseen: one in ten millions


def holds(told: Hypothesis) -> bool:
    """Whether the spots fit together."""
    freedom = max(2.0 * told.count - 6.0, 1.0)
    return told.chi2 < freedom + SIGMAS * math.sqrt(2.0 * freedom)


def completed(
    joined: Joined, robot: Robot, labels: Ints, starts: tuple[Pose, ...], free: NDArray[np.bool_]
) -> Hypothesis | None:
    """A robot's spots ``labels`` (C, 6) that cameras claim, and what else is ``free`` (n,) near by in any camera; None
    where that changes nothing.
    """
    told = [joined.explain(robot, start, labels, free.copy()) for start in starts]
    fitting = sorted((one for one in told if one is not None and holds(one)), key=lambda one: -one.odds)
    if not fitting:
        return None
    best = fitting[0]
    new = (best.labels >= 0) & (labels < 0)
    # What only one of two tilts explains is nobody's until one of them is clearly right.
    for other in fitting[1:]:
        if other.odds > best.odds - MARGIN:
            new &= other.labels == best.labels
    return best.labelled(np.where(new, best.labels, labels)) if new.any() else None


def followed(joined: Joined, robot: Robot, free: NDArray[np.bool_]) -> Hypothesis | None:
    """What the ``free`` (n,) spots show of a robot near where it is foreseen; None where that is unknown.

    Whether it is enough to know the robot by says `is_enough`.
    """
    there = joined.foreseen(robot.id, joined.exposed_ns)
    if there is None:
        return None
    return joined.explain(robot, there.pose, joined.no_labels(), free.copy(), there.covariance)


def is_enough(joined: Joined, robot: Robot, told: Hypothesis) -> bool:
    """Whether the spots alone, without what was foreseen, are the robot there."""
    counts = (told.labels >= 0).sum(axis=1)
    if counts.sum() < LEAST and counts.max() < LEAST_IN_ONE:
        return False
    alone = joined.explain(robot, told.pose, told.labels, np.zeros(len(joined.scene.rays), np.bool_))
    if alone is None or not holds(alone) or alone.count < told.count or alone.odds < LEAST_ODDS:
        return False
    there = joined.foreseen(robot.id, joined.exposed_ns)
    assert there is not None
    off = np.concatenate([alone.pose.position - there.pose.position, _turn(there.pose, alone.pose)])
    spread = there.covariance + 1e-12 * np.eye(6)
    return bool(off @ np.linalg.solve(spread, off) < FARTHEST) or counts.sum() >= LEAST


def _turn(one: Pose, other: Pose) -> NDArray[np.float64]:
    return log_rotation(other.rotation @ one.rotation.T)


def unshared(joined: Joined, known: dict[str, Ints], told: dict[str, Hypothesis]) -> dict[str, Hypothesis]:
    """The same hypotheses without spots that another robot's LED explains nearly as well.

    ``known`` (C, 6) by robot are what cameras claim themselves, which stays.
    """
    new = {robot: (one.labels >= 0) & (known[robot] < 0) for robot, one in told.items()}
    dropped = {robot: np.zeros_like(mask) for robot, mask in new.items()}
    for robot, mask in new.items():
        for c, led in np.argwhere(mask):
            spot = told[robot].labels[c, led]
            mine = _off(joined, told[robot], c, led, spot)
            for other, rival in told.items():
                if other == robot:
                    continue
                for m in range(rival.labels.shape[1]):
                    wants = rival.labels[c, m] in (-1, spot) and not np.isnan(rival.rays[c, m, 0])
                    if wants and _off(joined, rival, c, m, spot) < mine + CLEARLY:
                        dropped[robot][c, led] = True
    return {
        robot: one.labelled(np.where(dropped[robot], -1, one.labels)) if dropped[robot].any() else one
        for robot, one in told.items()
    }


def _off(joined: Joined, told: Hypothesis, c: int, led: int, spot: int) -> float:
    """How far a spot is from where an LED should be, squared sigmas."""
    body, covariance = joined.body(told.whose), joined.scene.covariances[spot]
    x, y = joined.scene.rays[spot] - told.rays[c, led]
    more = float(body.systematic[c]) ** 2
    xx, xy, yy = covariance[0] + more, covariance[1], covariance[2] + more
    return float((yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy))
