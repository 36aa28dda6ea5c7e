"""How strongly residuals follow a pattern, such as the one that a wrong lens leaves, and how sure that is.

Least squares of one number for each pattern, by itself, while every robot's LEDs may be a little off: what these can
explain counts for nothing. Spots' errors are not all independent: they stay the same as long as a robot stays where it
is. So sigma is that of the spots' noise, or of the scatter from one stretch of a robot's sightings to the next, if that
is more.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.doctor.gather import Sightings
from asterism.server.doctor.residuals import STEP, Whitened, explained_by

LED_SIGMA_M = 20e-6  # of LEDs beside where the rig has them, one sigma
BLOCKS = 8  # stretches of every robot's sightings
SIGMAS = 4.5  # of a pattern that is there: by chance once in 150 000


class Strength(NamedTuple):
    """A pattern's number, with one sigma of it."""

    value: float
    sigma: float

    @property
    def sure(self) -> bool:
        """Whether it is none by chance."""
        return abs(self.value) > SIGMAS * self.sigma


def by_leds(rig: Rig, seen: Sightings, told: Whitened) -> Floats:
    """Derivatives (m, 6, 2, 12) of the pixels of one robot's LEDs by moves in their plane, two a LED; px per m."""
    axes = rig.robots[int(seen.robots[0])].T_robot_plane.rotation[:, :2]
    turned = np.array([pose.rotation for pose in seen.poses]) @ axes
    by = np.zeros((len(turned), LEDS, 2, 2 * LEDS))
    for k in range(2):
        move = STEP * turned[:, None, :, k]
        moved = (rig.camera.project(told.points + move) - rig.camera.project(told.points - move)) / (2.0 * STEP)
        for led in range(LEDS):
            by[:, led, :, 2 * led + k] = moved[:, led]
    return by


def strengths(rig: Rig, seen: Sightings, told: Whitened, patterns: Floats) -> list[Strength] | None:
    """Of ``patterns`` (m, 6, 2, p) px; None where too few residuals tell."""
    if float(told.freedom.sum()) < 20 * LEDS:
        return None
    scores, informations = [], []
    for robot in np.unique(seen.robots).tolist():
        rows = np.flatnonzero(seen.robots == robot)
        own = Whitened(*(part[rows] for part in told))
        score, information = _of_robot(rig, seen.take(rows), own, patterns[rows])
        scores.append(score)
        informations.append(information)
    return [
        _combined(np.concatenate(scores)[:, k], np.concatenate(informations)[:, k]) for k in range(scores[0].shape[1])
    ]


def _of_robot(rig: Rig, seen: Sightings, told: Whitened, patterns: Floats) -> tuple[Floats, Floats]:
    """Scores and informations (blocks, p), with the robot's own LEDs eliminated."""
    by, leds = explained_by(told, patterns), explained_by(told, by_leds(rig, seen, told))
    matrix = np.einsum("mip,miq->pq", leds, leds) + np.eye(2 * LEDS) / LED_SIGMA_M**2
    left = by - leds @ np.linalg.solve(matrix, np.einsum("mip,miq->pq", leds, by))
    blocks = np.array_split(np.arange(len(left)), min(BLOCKS, len(left)))
    sums = [np.einsum("mip,mi->mp", left, told.residuals), np.einsum("mip,mip->mp", left, by)]
    score, information = (np.array([part[block].sum(axis=0) for block in blocks]) for part in sums)
    return score, information


def _combined(scores: Floats, informations: Floats) -> Strength:
    """Of blocks (n,): what a block's score is beside what the pattern makes of it is its error."""
    whole, n = max(float(informations.sum()), 1e-30), len(scores)
    value = float(scores.sum()) / whole
    scatter = float(((scores - value * informations) ** 2).sum()) * n / max(n - 1, 1)
    return Strength(value, math.sqrt(max(whole, scatter)) / whole)
