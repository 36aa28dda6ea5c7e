"""From a rough place of a drawing to the best: least squares of the contacts' distances along the normal, robust.

Contacts that are far off for their own noise and for what most are off count less (Geman and McClure, 1985; as
iteratively reweighted least squares, Holland and Welsch, 1977): robots that were lifted, and places where the mould is
not as drawn.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.surface import Heights
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.register_left import Left, between, left_of, moved

ROUNDS = 60
FARTHEST = 3.0  # sigma: from there on a contact counts a quarter and less
MEDIAN = 1.4826  # of a normal error's absolute median, for one sigma
SETTLED_M = 1e-7  # of a step, and rad times the drawing's radius
LONGEST = 0.2  # of a step: the drawing's size, rad
DAMPED = 1e-3


class Prior(NamedTuple):
    """Where the drawing is known to lie: ``T_world_drawing``, and the ``information`` (6, 6) of its centre and turn
    about that, 1/m^2 and 1/rad^2 of the world; ``told`` by the rig, or only that the contacts are on it.
    """

    T_world_drawing: Pose
    information: Floats
    told: bool

    def at(self, drawing: Heights, pose: Pose) -> Floats:
        """How far (6,) it is from a pose."""
        return between(drawing, pose, self.T_world_drawing)


class Fit(NamedTuple):
    """A drawing's pose, what it leaves, how far most contacts are off beside their noise, ``misfit_m``, and the robust
    ``cost`` per contact: 0 where all fit, 1 where none does.
    """

    T_world_drawing: Pose
    left: Left
    misfit_m: float
    cost: float


def fitted(drawing: Heights, contacts: Contacts, start: Pose, prior: Prior | None, rounds: int = ROUNDS) -> Fit:
    """The pose that fits best from a start."""
    pose, radius = start, _radius(contacts)
    scale = np.array([1.0, 1.0, 1.0, *[1.0 / radius] * 3])
    for _ in range(rounds):
        left = left_of(drawing, pose, contacts, exact=False)
        misfit = misfit_of(left)
        there = np.where(left.inside, left.variances + misfit**2, np.inf)
        weights = _weights(left, misfit) / there
        by = left.by_pose * scale
        normal, gradient = (by.T * weights) @ by, -(by.T * weights) @ left.off
        if prior is not None:
            information = prior.information * np.outer(scale, scale)
            normal, gradient = normal + information, gradient + scale * (prior.information @ prior.at(drawing, pose))
        damping = DAMPED * np.trace(normal) / 6.0 * np.eye(6) + 1e-12 * np.eye(6)
        step = np.linalg.solve(normal + damping, gradient)
        step *= min(1.0, LONGEST * radius / max(float(np.abs(step).max()), 1e-12))
        pose = moved(drawing, pose, scale * step)
        if np.abs(step).max() < SETTLED_M:
            break
    left = left_of(drawing, pose, contacts, exact=False)
    misfit = misfit_of(left)
    return Fit(pose, left, misfit, cost_of(left, misfit))


def misfit_of(left: Left) -> float:
    """What most contacts are off beside their noise, one sigma, m; inf where the drawing is under none."""
    if not left.inside.any():
        return math.inf
    size = (MEDIAN * float(np.median(np.abs(left.off[left.inside])))) ** 2
    return math.sqrt(max(size - float(np.median(left.variances[left.inside])), 0.0))


def cost_of(left: Left, misfit_m: float) -> float:
    """How badly contacts fit: those where the drawing is not fit not at all."""
    return float(np.mean(np.where(left.inside, 1.0 - np.sqrt(_weights(left, misfit_m)), 1.0)))


def _weights(left: Left, misfit_m: float) -> Floats:
    """What contacts (n,) count, 1 and less."""
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = left.off**2 / (left.variances + misfit_m**2)
    weights: Floats = 1.0 / (1.0 + np.nan_to_num(squares) / FARTHEST**2) ** 2
    return weights


def _radius(contacts: Contacts) -> float:
    """How far contacts are from their middle, RMS, m."""
    return max(float(np.sqrt(((contacts.points - contacts.points.mean(axis=0)) ** 2).sum(axis=1).mean())), 1e-3)
