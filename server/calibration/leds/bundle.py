"""Bundle adjustment: a robot's six LED positions and its pose in every view, fitted together to the labelled centres.

Two of the unknowns no film can tell, and they are fixed by convention (`gauge`): where the robot's frame lies and the
scale.

Method: Levenberg-Marquardt on the normal equations with the poses eliminated (Schur complement; Triggs, McLauchlan,
Hartley, Fitzgibbon: "Bundle adjustment - a modern synthesis", 2000, sections 6 and 9 for the gauge). First with
Cauchy weights; then what lies far off is left out and the rest is fitted by plain weighted least squares, so that the
covariance means what it says.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, null_space

from asterism.protocol.constellation import LEDS
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, exp_rotation
from asterism.protocol.led_offset import LedOffset
from asterism.protocol.rig import Robot
from asterism.server.calibration.leds.gauge import Gauge, unseen_changes

ITERATIONS = 60
CONVERGED = 1e-10  # of the cost, relative
CAUCHY = 3.0  # sigmas: the residual that the robust loss gives half its weight
FAR_OFF = 4.5  # sigmas: centres farther off are left out of the last fit
FEWEST_LEDS = 5  # of a view: with four there is hardly a residual left
GAUGED = 2  # fits in the gauge's scale: the second moves next to nothing
FACING_STEP = 1e-4  # of a cosine, for numeric derivatives
BETTER = 0.99  # of a pose's cost: what another tilt must come down to
MEDIAN_CHI2 = 1.386  # of two degrees of freedom

Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """A robot in v views: ``rays`` (v, 6, 2) = x / z, y / z of its LEDs' centres; ``information`` (v, 6, 2, 2) the
    inverse of their covariances, zero where an LED is not seen; ``rotations`` (v, 3, 3), ``ts`` (v, 3) T_camera_robot.
    """

    rays: Floats
    information: Floats
    rotations: Floats
    ts: Floats

    def __len__(self) -> int:
        return len(self.rays)

    def __getitem__(self, rows: Bools) -> "Views":
        return Views(self.rays[rows], self.information[rows], self.rotations[rows], self.ts[rows])

    @property
    def seen(self) -> Bools:
        """(v, 6): which LEDs are."""
        visible: Bools = self.information[:, :, 0, 0] > 0.0
        return visible


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """What a bundle adjustment found.

    ``leds`` (6, 3) m in the robot's frame, ``covariance`` (18, 18) m^2 of them row by row, scaled by
    ``chi2_per_dof``, given frame and scale (`gauge`); ``views`` with the poses found and only the centres that agree;
    ``left_out`` counts the others.
    """

    leds: Floats
    covariance: Floats
    chi2_per_dof: float
    views: Views
    left_out: int

    @property
    def sigmas(self) -> Floats:
        """Standard deviations (6, 3), m."""
        deviations: Floats = np.sqrt(np.diag(self.covariance)).reshape(LEDS, 3)
        return deviations


@dataclass(frozen=True, slots=True, eq=False)
class Disc:
    """What an LED's image depends on beside its centre: the plate's unit ``normal`` (3,) in the robot's frame and the
    ``radius``, m, of its disc, with 0 the perspective eccentricity is left out; its own optics, if the rig has them,
    and their unit ``axis`` (3,).
    """

    normal: Floats
    radius: float
    axis: Floats
    offset: LedOffset | None = None

    @staticmethod
    def of(robot: Robot) -> "Disc":
        """Of a rig's robot."""
        normal = robot.T_robot_plane.rotation[:, 2]
        return Disc(normal, robot.led_radius or 0.0, robot.axis, robot.led_offset)


def adjust(start: Floats, views: Views, gauge: Gauge, disc: Disc) -> Adjusted:
    """Fit positions and poses to the views.

    ``start`` (6, 3) m is where the fit begins; ``gauge`` what the film cannot tell. Raises InputError where hardly any
    view is left whose centres agree.
    """
    leds = start
    leds, views = _descend(leds, views, disc, robust=True)
    for _ in range(5):
        views, flipped = _better_tilts(leds, views, disc)
        if not flipped:
            break
        leds, views = _descend(leds, views, disc, robust=True)
    good = _agreeing(leds, views, disc)
    left_out = int(views.seen.sum() - good.sum())
    views = Views(views.rays, views.information * good[:, :, None, None], views.rotations, views.ts)
    views = views[np.asarray(good.any(axis=1))]
    if 2 * views.seen.sum() - 6 * len(views) <= 3 * LEDS:
        raise InputError(
            "the robot's views do not agree with one another, expected a rigid robot, well seen, moved about"
        )
    for _ in range(GAUGED):
        # What an LED's image depends on beside its centre does not grow with the scale.
        leds, views = _in_gauge(leds, views, gauge)
        leds, views = _descend(leds, views, disc, robust=False)
    leds, views = _in_gauge(leds, views, gauge)
    residuals, by_pose, by_led = linearise(leds, views, disc)
    _, reduced, _, _ = _normal_equations(residuals, by_pose, by_led, views.information)
    cost = float(np.einsum("vli,vlij,vlj", residuals, views.information, residuals))
    free = null_space(gauge.constraints(leds))
    dof = 2 * int(views.seen.sum()) - 6 * len(views) - free.shape[1]
    chi2_per_dof = cost / max(dof, 1)
    covariance = free @ np.linalg.inv(free.T @ reduced @ free) @ free.T * chi2_per_dof
    return Adjusted(leds, covariance, chi2_per_dof, views, left_out)


def linearise(leds: Floats, views: Views, disc: Disc) -> tuple[Floats, Floats, Floats]:
    """Residuals (v, 6, 2), observed minus predicted rays, and the prediction's derivatives by the pose (v, 6, 2, 6) -
    translation, then rotation about the camera's axes - and by the LED's position (v, 6, 2, 3).

    The eccentricity of a disc's image is findings/algorithms.md, A: the centre of the conic that a circle projects to.
    """
    arms = np.einsum("vij,lj->vli", views.rotations, leds)
    by_place = by_turn = np.zeros((*arms.shape, 3))
    if disc.offset is not None:
        shifts, by_place, by_turn = _axial_shifts(arms, views.ts, views.rotations @ disc.axis, disc.offset)
        arms = arms + shifts
    points = arms + views.ts[:, None, :]
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    predicted = points[..., :2] / points[..., 2:]
    if disc.radius > 0.0:
        normal = (views.rotations @ disc.normal)[:, None, :]
        across = disc.radius**2 * normal[..., :2] * normal[..., 2:]
        predicted = (points[..., :2] * points[..., 2:] + across) / (
            points[..., 2:] ** 2 - disc.radius**2 * (1.0 - normal[..., 2:] ** 2)
        )
    zero = np.zeros_like(z)
    by_point = np.stack(
        [np.stack([1 / z, zero, -x / z**2], axis=-1), np.stack([zero, 1 / z, -y / z**2], axis=-1)], axis=-2
    )  # (v, 6, 2, 3)
    a, b, c = arms[..., 0], arms[..., 1], arms[..., 2]
    # d(w x arm)/dw = -[arm]x
    turn = np.stack(
        [np.stack([zero, c, -b], axis=-1), np.stack([-c, zero, a], axis=-1), np.stack([b, -a, zero], axis=-1)], axis=-2
    )
    by_place = by_point @ (np.eye(3) + by_place)
    by_pose = np.concatenate([by_place, by_point @ (turn + by_turn)], axis=-1)
    return views.rays - predicted, by_pose, by_place @ views.rotations[:, None]


def _axial_shifts(arms: Floats, ts: Floats, axes: Floats, offset: LedOffset) -> tuple[Floats, Floats, Floats]:
    """How far from LEDs at ``arms`` (v, 6, 3) + ``ts`` (v, 3) with ``axes`` (v, 3), camera's frame, their light seems
    to come (v, 6, 3), m, and the derivatives (v, 6, 3, 3) by the LED's place and by the robot's rotation. What the
    distance changes is too little to derive.
    """
    points, axes = arms + ts[:, None], np.broadcast_to(axes[:, None], arms.shape)
    away = np.linalg.norm(points, axis=-1, keepdims=True)
    sight = points / away
    facing = (sight * axes).sum(axis=-1, keepdims=True)
    ahead, behind = (_shift(offset, facing + step, away) for step in (FACING_STEP, -FACING_STEP))
    slope = (ahead - behind) / (2.0 * FACING_STEP) * axes
    place = (axes - facing * sight) / away  # of the cosine
    turn = np.cross(arms, place) + np.cross(axes, sight)
    by_place, by_turn = (slope[..., :, None] * each[..., None, :] for each in (place, turn))
    return _shift(offset, facing, away) * axes, by_place, by_turn


def _shift(offset: LedOffset, cosine: Floats, distance: Floats) -> Floats:
    return offset.shift(np.arcsin(np.sqrt(np.maximum(1.0 - cosine**2, 0.0))), distance)


def _normal_equations(
    residuals: Floats, by_pose: Floats, by_led: Floats, information: Floats, damping: float = 0.0
) -> tuple[tuple[Floats, Floats, Floats], Floats, Floats, Floats]:
    """The pose blocks (their inverses, couplings to the LEDs (v, 6, 18), right sides (v, 6)), and for the LEDs with the
    poses eliminated: matrix (18, 18), right side (18,) and the diagonal it had before.
    """
    n = len(residuals)
    weighted_pose = np.einsum("vlik,vlij->vlkj", by_pose, information)
    weighted_led = np.einsum("vlik,vlij->vlkj", by_led, information)
    blocks = np.einsum("vlkj,vljm->vkm", weighted_pose, by_pose)
    blocks[:, range(6), range(6)] *= 1.0 + damping
    coupling = np.einsum("vlkj,vljm->vklm", weighted_pose, by_led).reshape(n, 6, 3 * LEDS)
    right = np.einsum("vlkj,vlj->vk", weighted_pose, residuals)
    own = block_diag(*np.einsum("vlkj,vljm->lkm", weighted_led, by_led))
    right_led = np.einsum("vlkj,vlj->lk", weighted_led, residuals).ravel()
    inverses = np.linalg.inv(blocks)
    reduced = own - np.einsum("vki,vkm,vmj->ij", coupling, inverses, coupling, optimize=True)
    right_led = right_led - np.einsum("vki,vkm,vm->i", coupling, inverses, right, optimize=True)
    return (inverses, coupling, right), reduced, right_led, np.diag(own)


def _descend(leds: Floats, views: Views, disc: Disc, robust: bool) -> tuple[Floats, Views]:
    """Levenberg-Marquardt to the minimum; robust weights follow the residuals."""
    damping, cost, scale = 1e-6, np.inf, 1.0
    for _ in range(ITERATIONS):
        residuals, by_pose, by_led = linearise(leds, views, disc)
        information = views.information
        squared = np.einsum("vli,vlij,vlj->vl", residuals, information, residuals)
        if robust:
            scale = _scale2(squared, views.seen) * CAUCHY**2
            information = information / (1.0 + squared / scale)[:, :, None, None]
        cost = _cost(squared, scale if robust else None)
        free = null_space(unseen_changes(leds).T)
        while True:
            poses, reduced, right, diagonal = _normal_equations(residuals, by_pose, by_led, information, damping)
            matrix = free.T @ (reduced + np.diag(damping * diagonal)) @ free
            step = free @ np.linalg.solve(matrix, free.T @ right)
            inverses, coupling, right_pose = poses
            moves = np.einsum("vkm,vm->vk", inverses, right_pose - coupling @ step)
            new_leds, new_views = leds + step.reshape(LEDS, 3), _moved(views, moves)
            new_squared = _squared(new_leds, new_views, disc)
            new_cost = _cost(new_squared, scale if robust else None)
            if new_cost <= cost or damping > 1e6:
                break
            damping *= 10.0
        if new_cost <= cost:
            leds, views, damping = new_leds, new_views, max(damping / 10.0, 1e-12)
        if not cost - new_cost > CONVERGED * cost:
            break
    return leds, views


def _squared(leds: Floats, views: Views, disc: Disc) -> Floats:
    """Squared residuals (v, 6), whitened; infinite behind the camera."""
    residuals, _, _ = linearise(leds, views, disc)
    squared: Floats = np.einsum("vli,vlij,vlj->vl", residuals, views.information, residuals)
    behind = (views.rotations[:, 2] @ leds.T + views.ts[:, 2:]) <= 0.0
    return np.where(behind & views.seen, np.inf, squared)


def _cost(squared: Floats, scale: float | None) -> float:
    return float(np.sum(squared) if scale is None else scale * np.sum(np.log1p(squared / scale)))


def _scale2(squared: Floats, seen: Bools) -> float:
    """Squared scale of the residuals, from their median; six of the two numbers a centre gives go into each pose."""
    freedom = (2.0 * seen.sum() - 6.0 * len(seen)) / (2.0 * seen.sum())
    return max(float(np.median(squared[seen])) / MEDIAN_CHI2 / max(float(freedom), 0.1), 1e-12)


def _agreeing(leds: Floats, views: Views, disc: Disc) -> Bools:
    """(v, 6): the centres that are not far off, in views in which enough are left."""
    squared = _squared(leds, views, disc)
    limit = FAR_OFF**2 * _scale2(squared, views.seen)
    good = views.seen & (squared < limit)
    good[good.sum(axis=1) < FEWEST_LEDS] = False
    return good


def _moved(views: Views, moves: Floats) -> Views:
    """Poses moved by (v, 6): translation, rotation vector about the camera's axes."""
    turns = np.array([exp_rotation(move[3:]) for move in moves])
    return Views(views.rays, views.information, turns @ views.rotations, views.ts + moves[:, :3])


def _better_tilts(leds: Floats, views: Views, disc: Disc) -> tuple[Views, int]:
    """Every view's other tilt tried, the LEDs held; returns the better poses and how many changed.

    In weak perspective a plane whose normal is mirrored about the line of sight has the same image.
    """
    here = _poses_alone(leds, views, disc)
    middle = leds.mean(axis=0)
    centres = here.rotations @ middle + here.ts
    sight = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    mirror = np.eye(3) - 2.0 * sight[:, :, None] * sight[:, None, :]
    rotations = mirror @ here.rotations @ (np.eye(3) - 2.0 * np.outer(disc.normal, disc.normal))
    other = Views(views.rays, views.information, rotations, centres - rotations @ middle)
    other = _poses_alone(leds, other, disc)
    # Both may have come to the same minimum, but for the last digits.
    better = _squared(leds, other, disc).sum(axis=1) < BETTER * _squared(leds, here, disc).sum(axis=1)
    better &= np.einsum("vi,vi->v", other.rotations @ disc.normal, other.rotations @ middle + other.ts) < 0.0
    rotations = np.where(better[:, None, None], other.rotations, here.rotations)
    ts = np.where(better[:, None], other.ts, here.ts)
    return Views(views.rays, views.information, rotations, ts), int(better.sum())


def _poses_alone(leds: Floats, views: Views, disc: Disc) -> Views:
    """Levenberg-Marquardt on every pose by itself."""
    damping = np.full(len(views), 1e-4)
    cost = _squared(leds, views, disc).sum(axis=1)
    for _ in range(12):
        residuals, by_pose, _ = linearise(leds, views, disc)
        weighted = np.einsum("vlik,vlij->vlkj", by_pose, views.information)
        blocks = np.einsum("vlkj,vljm->vkm", weighted, by_pose)
        blocks[:, range(6), range(6)] *= 1.0 + damping[:, None]
        moves = np.linalg.solve(blocks, np.einsum("vlkj,vlj->vk", weighted, residuals)[..., None])[..., 0]
        trial = _moved(views, moves)
        new = _squared(leds, trial, disc).sum(axis=1)
        better = new <= cost
        views = Views(
            views.rays,
            views.information,
            np.where(better[:, None, None], trial.rotations, views.rotations),
            np.where(better[:, None], trial.ts, views.ts),
        )
        cost = np.where(better, new, cost)
        damping = np.where(better, damping / 10.0, damping * 10.0)
    return views


def _in_gauge(leds: Floats, views: Views, gauge: Gauge) -> tuple[Floats, Views]:
    """The same adjustment in the gauge's scale and frame."""
    scale, turn, shift = gauge.placed(leds)
    rotations = views.rotations @ turn.T
    ts = views.ts * scale - rotations @ shift
    return leds * scale @ turn.T + shift, Views(views.rays, views.information, rotations, ts)
