"""Where a point of a robot is that rests at one place in all frames: one least squares over all spots of all frames.

Unknown are the point in the robot's frame, its place in the camera's, the robot's rotation in every frame, and what all
frames have in common: LEDs that are not where the rig has them, a lens that is a little off. The latter are numbers
with one sigma of 1, so that what they leave open is in the result's covariance, however many frames there are. In every
frame the point may be beside its place by its play, which is a sigma as well. Rotation and play of a frame are
eliminated from the normal equations before these are solved (Schur complement; Triggs et al., "Bundle adjustment - a
modern synthesis", 2000, section 6.1).

Fitting spots and not poses matters: of a plate that is seen from the front the tilt is so poorly known that its error
has no covariance, but with the point's place known it can be told.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig, Robot
from asterism.server.calibration.point.views import Views, information_of, spots_of

STEPS = (1e-5, 1e-4)  # m, rad: of numeric derivatives
ROUNDS = 15
SMALL = (1e-9, 1e-8)  # m, rad: a step that is none
LARGEST_TURN = 0.2  # rad of one step
LEAST_PLAY_M = 1e-6

# How the spots of n poses T_camera_robot, (n, 3, 3) and (n, 3) m, move by what all frames have in common beside the
# LEDs' places (n, 12, k): px for one sigma of each of k causes.
Causes = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """What a fit goes by: ``shapes`` (18, m), how the LEDs' places may be off, m for one sigma each of m causes;
    ``causes`` (n, 12, k), what else all frames have in common, px for one sigma each.

    ``led_factor``: how many times larger the former are than told; ``beyond`` px^2, variance of every spot beyond its
    noise; ``play_m``: one sigma, along each axis, of where the point rests.
    """

    rig: Rig
    robot: Robot
    shapes: Floats
    causes: Floats
    led_factor: float = 1.0
    beyond: float = 0.0
    play_m: float = 0.0

    @property
    def sigmas(self) -> Floats:
        """Of all causes (m + k,), in units of what is told."""
        m, k = self.shapes.shape[1], self.causes.shape[2]
        return np.repeat([self.led_factor, 1.0], [m, k])


class Pivot(NamedTuple):
    """``point`` (3,) m in the robot's frame, its ``place`` (3,) m in the camera's, ``causes`` (m + k,), those of
    the LEDs first; ``rotations`` (n, 3, 3) of the robot, ``plays`` (n, 3) m: how far the point is beside its place.
    ``covariance`` (6 + m + k, 6 + m + k) of point, place and causes.
    """

    point: Floats
    place: Floats
    causes: Floats
    rotations: Floats
    plays: Floats
    covariance: Floats

    @property
    def ts(self) -> Floats:
        """Where the robot's origin is, (n, 3) m."""
        return self.place + self.plays - self.rotations @ self.point


def fit_pivot(model: Model, views: Views, start: Pivot) -> Pivot:
    """The fit near ``start``, whose rotations and plays are those of the views."""
    fit, information = start, information_of(views.noise, views.seen, model.beyond)
    prior = np.concatenate([np.zeros(6), model.sigmas**-2.0])
    for _ in range(ROUNDS):
        off, by_pose = linearized(model, views, fit)
        across, inverse = _frames(model, information, by_pose)
        by_point = -by_pose[..., :3] @ fit.rotations
        by_leds = _by_leds(by_pose, fit.rotations) @ model.shapes
        by_all = np.concatenate([by_point, by_pose[..., :3], by_leds, model.causes], axis=-1)
        # A frame's play pulls towards none, which its elimination has to carry along.
        pull = np.concatenate([-fit.plays * play_weight(model), np.zeros_like(fit.plays)], axis=-1)
        own = np.einsum("nij,nj->ni", inverse, np.einsum("nij,nj->ni", across, off) + pull)
        to_all = np.swapaxes(by_all, 1, 2) @ information  # (n, 6 + m + k, 12)
        reduced = to_all - (to_all @ by_pose) @ inverse @ across
        normal = np.tensordot(reduced, by_all, ([0, 2], [0, 1])) + np.diag(prior)
        right = np.einsum("nij,nj->i", to_all, off - np.einsum("nij,nj->ni", by_pose, own))
        right -= prior * np.concatenate([np.zeros(6), fit.causes])
        scale = 1.0 / np.sqrt(np.diag(normal))
        covariance = scale[:, None] * np.linalg.inv(scale[:, None] * normal * scale) * scale
        step = covariance @ right
        move = own - np.einsum("nij,njk,k->ni", inverse, across @ by_all, step)
        fit = Pivot(
            fit.point + step[:3],
            fit.place + step[3:6],
            fit.causes + step[6:],
            turned(fit.rotations, move[:, 3:]),
            fit.plays + move[:, :3],
            covariance,
        )
        if np.abs(step[:6]).max() < SMALL[0] and np.abs(move[:, 3:]).max() < SMALL[1]:
            break
    return fit


def linearized(model: Model, views: Views, fit: Pivot) -> tuple[Floats, Floats]:
    """What the spots are off (n, 12) px, 0 where not seen, and their derivatives (n, 12, 6) by a shift of the robot, m,
    and by its turn about the point's place, rad about the camera's axes.
    """
    arms, m = fit.rotations @ fit.point, model.shapes.shape[1]
    leds = model.robot.leds + (model.shapes @ fit.causes[:m]).reshape(-1, 3)

    def spots(move: Floats) -> Floats:
        turn = Rotation.from_rotvec(move[3:]).as_matrix()
        origins = fit.place + fit.plays + move[:3] - arms @ turn.T
        return spots_of(model.rig, model.robot, leds, turn @ fit.rotations, origins)

    steps = np.diag(np.repeat(STEPS, 3))
    columns = [(spots(step) - spots(-step)) / (2.0 * step.sum()) for step in steps]
    seen = np.repeat(views.seen, 2, axis=1)
    off = np.where(seen, views.spots - spots(np.zeros(6)) - model.causes @ fit.causes[m:], 0.0)
    return off, np.stack(columns, axis=-1)


def _by_leds(by_pose: Floats, rotations: Floats) -> Floats:
    """Derivatives (n, 12, 18) px/m by the LEDs' places in the robot's frame: a shift of the robot moves every LED."""
    n = len(rotations)
    by_leds = np.zeros((n, LEDS, 2, LEDS, 3))
    shifts = (by_pose[..., :3] @ rotations).reshape(n, LEDS, 2, 3)
    for led in range(LEDS):
        by_leds[:, led, :, led] = shifts[:, led]
    return by_leds.reshape(n, 2 * LEDS, 3 * LEDS)


def play_weight(model: Model) -> float:
    """One over the variance of the point's play, m^-2."""
    return float(max(model.play_m, LEAST_PLAY_M) ** -2.0)


def turned(rotations: Floats, turns: Floats) -> Floats:
    """Rotations (n, 3, 3) turned further by ``turns`` (n, 3) rad, each by LARGEST_TURN at most."""
    sizes = np.linalg.norm(turns, axis=1, keepdims=True)
    shorter = turns * np.minimum(1.0, LARGEST_TURN / np.maximum(sizes, 1e-12))
    further: Floats = Rotation.from_rotvec(shorter).as_matrix() @ rotations
    return further


def _frames(model: Model, information: Floats, by_pose: Floats) -> tuple[Floats, Floats]:
    """Of every frame's shift and turn: J' W (n, 6, 12), and the inverse (n, 6, 6) of J' W J with the play's prior."""
    across = np.swapaxes(by_pose, 1, 2) @ information
    normal = across @ by_pose
    normal[:, range(3), range(3)] += play_weight(model)
    return across, np.asarray(np.linalg.inv(normal), np.float64)


class Resting(NamedTuple):
    """How every frame (n,) agrees with a pivot: ``offsets`` (n, 3) m from the point's place to where the frame alone
    has it, with ``covariances`` (n, 3, 3), play not counted; ``misfits`` (n,): squared residuals of the frame's own
    best pose, which has ``freedom`` (n,) degrees of freedom; ``rotations`` (n, 3, 3) as the pivot has them, and where
    they are those of the ``other_tilt`` (n,), the one that was less likely before.
    """

    offsets: Floats
    covariances: Floats
    misfits: Floats
    freedom: Floats
    rotations: Floats
    other_tilt: NDArray[np.bool_]

    def squared(self, play_m: float) -> Floats:
        """Squared offsets (n,) by their covariances and the play, 3 on average where they are meant."""
        spreads = self.covariances + play_m**2 * np.eye(3)
        squares: Floats = np.einsum("ni,ni->n", self.offsets, np.linalg.solve(spreads, self.offsets[..., None])[..., 0])
        return squares


def resting(model: Model, views: Views, fit: Pivot) -> Resting:
    """How frames agree with a fit that they need not be part of, each by that of its tilts which agrees better."""
    first = _resting_from(model, views, fit, views.rotations[:, 0])
    doubt = np.abs(views.rotations[:, 0] - views.rotations[:, 1]).max(axis=(1, 2)) > 0.0
    if not doubt.any():
        return first
    other = _resting_from(model, views, fit, views.rotations[:, 1])
    chosen = doubt & (other.squared(model.play_m) + other.misfits < first.squared(model.play_m) + first.misfits)
    columns = (np.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), b, a) for a, b in zip(first, other, strict=True))
    rests = Resting(*columns)
    away = np.linalg.norm(views.rotations - rests.rotations[:, None], axis=(2, 3))
    return rests._replace(other_tilt=doubt & (away[:, 1] < away[:, 0]))


def _resting_from(model: Model, views: Views, fit: Pivot, rotations: Floats) -> Resting:
    """How frames agree when each one's turn about the point's place is fitted, from (n, 3, 3) on."""
    information = information_of(views.noise, views.seen, model.beyond)
    here = fit._replace(rotations=rotations, plays=np.zeros((len(rotations), 3)))
    for _ in range(ROUNDS):
        off, by_pose = linearized(model, views, here)
        across = np.swapaxes(by_pose[..., 3:], 1, 2) @ information
        step = np.asarray(np.linalg.solve(across @ by_pose[..., 3:], across @ off[..., None])[..., 0], np.float64)
        here = here._replace(rotations=turned(here.rotations, step))
        if np.abs(step).max() < SMALL[1]:
            break
    off, by_pose = linearized(model, views, here)
    across = np.swapaxes(by_pose, 1, 2) @ information
    inverse = np.asarray(np.linalg.inv(across @ by_pose), np.float64)
    pull = np.einsum("nij,nj->ni", across, off)
    own = np.einsum("nij,nj->ni", inverse, pull)
    misfits = np.einsum("ni,nij,nj->n", off, information, off) - (own * pull).sum(axis=1)
    freedom = 2.0 * views.seen.sum(axis=1) - 6.0
    return Resting(own[:, :3], inverse[:, :3, :3], misfits, freedom, here.rotations, np.zeros(len(off), np.bool_))
