"""A named point of a robot from a film: guess, fit, leave out what does not rest, refuse what stays open."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.observations import Sighting
from asterism.server.calibration.point.consensus import AGREES, Guess, guess
from asterism.server.calibration.point.pivot import Causes, Model, Pivot, Resting, fit_pivot, resting
from asterism.server.calibration.point.turning import Turning, direction_text, turning_of
from asterism.server.calibration.point.views import Views, views_of

FEWEST_FRAMES = 12
LEAST_TURN_DEG = 3.0  # RMS, of every direction of the robot
OPEN_M = 0.5e-3  # one sigma of a point that is as good as unknown
LARGEST_PLAY_M = 0.5e-3
ROUNDS = 10
TRIMMED, TRIMMED_SHARE = 3, 0.6  # rounds that rest on the frames that agree best, and how many those are
SETTLED = 0.02  # relative change of what was learned of spots, LEDs and play
PARTS, FEWEST_IN_PART = 10, 3  # of a film, in which the place is looked at, and frames in each
MEDIAN, MEDIAN_SIGMA = 2.366, 2.2  # of chi squared for three numbers, and of the median of n times the root of n
WANDERS = 3.0  # standard deviations of chi squared beyond which the place wanders


class Known(NamedTuple):
    """What is known of a rig: ``shapes`` (18, m), how a robot's LEDs may be off, m for one sigma each; ``causes`` that
    all frames share beside them; ``bias_px``, what a centre is off beside its noise, anew in every frame.
    """

    shapes: Floats
    causes: Causes
    bias_px: float


@dataclass(frozen=True, slots=True, eq=False)
class PointCalibration:
    """``point`` (3,) m in the robot's frame with its ``covariance`` (3, 3), and what that would be if LEDs and lens
    were as the rig has them, ``by_noise`` (3, 3). ``used`` (n,) of the robot's sightings are those that the point rests
    in, ``other_tilt`` of them with the tilt that was less likely by itself.

    ``rms_m``: offsets from the place that single frames tell, across the line of sight and along it; ``play_m``: one
    sigma of what of that the spots' noise does not explain; ``wander_m``: RMS of the place from one tenth of the film
    to the next, noise taken off; ``wanders``: whether that is more than chance. ``leds_off``: how many times farther
    the LEDs are off than was told; ``beyond_px``: what spots are off beside their noise.
    """

    point: Floats
    covariance: Floats
    by_noise: Floats
    used: NDArray[np.bool_]
    other_tilt: int
    turning: Turning
    rms_m: tuple[float, float]
    play_m: float
    wander_m: float
    wanders: bool
    leds_off: float
    beyond_px: float

    @property
    def sigmas(self) -> Floats:
        """One standard deviation (3,) m along the robot's axes."""
        told: Floats = np.sqrt(np.diag(self.covariance))
        return told


def calibrate_point(
    rig: Rig, robot_id: str, sightings: Sequence[Sighting], known: Known, film: str
) -> PointCalibration:
    """The point of a robot that rests at one place in at least half of its ``sightings``, the frames' order kept.

    ``known`` is what is known of the rig, ``film`` what sentences call it. Raises InputError where there are too few
    frames, the robot does not turn enough, or its point does not rest.
    """
    robot = rig.robot(robot_id)
    check_count(film, robot_id, len(sightings))
    views = views_of(robot, sightings, known.bias_px)
    check_turned(film, robot_id, turning_of(views.rotations[:, 0]))
    first = guess(views)
    check_rests(film, robot_id, first.agree)
    rows = np.arange(len(sightings))
    rotations = views.rotations[rows, first.tilts]
    check_turned(film, robot_id, turning_of(rotations[first.agree]))
    model = Model(rig, robot, known.shapes, known.causes(rotations, views.ts[rows, first.tilts]))
    model, fit, rests, used = _fitted(model, known.causes, views, first, film)
    turning = turning_of(fit.rotations)
    check_turned(film, robot_id, turning)
    check_play(film, robot_id, model.play_m)
    wander_m, surprise = _wander(rests, np.flatnonzero(used), model.play_m)
    covariance = surprise * fit.covariance[:3, :3]
    exact = replace(model, shapes=0.0 * model.shapes, causes=0.0 * model.causes[used])
    alone = fit_pivot(exact, views.of(used), fit)
    by_noise = surprise * alone.covariance[:3, :3]
    check_open(film, robot_id, by_noise, turning)
    return PointCalibration(
        fit.point, covariance, by_noise, used, int(rests.other_tilt[used].sum()), turning,
        _rms(rests.offsets[used], fit.place), model.play_m, wander_m, surprise > 1.0, model.led_factor,
        math.sqrt(model.beyond),
    )  # fmt: skip


def _fitted(
    model: Model, causes: Causes, views: Views, first: Guess, film: str
) -> tuple[Model, Pivot, Resting, NDArray[np.bool_]]:
    """Fit, see what that leaves, learn from it, until the same frames are used."""
    used, rotations = first.agree, views.rotations[np.arange(len(views.ts)), first.tilts]
    none = np.zeros(len(model.sigmas))
    fit = Pivot(first.point, first.place, none, rotations[used], np.zeros((int(used.sum()), 3)), np.zeros((0, 0)))
    for turn in range(ROUNDS):
        fit = fit_pivot(replace(model, causes=model.causes[used]), views.of(used), fit)
        rests = resting(model, views, fit)
        learned = _learned(model, views, fit, rests, used)
        now = _closest(rests, first.agree) if turn < TRIMMED else rests.squared(learned.play_m) < AGREES
        if turn >= TRIMMED:
            check_rests(film, model.robot.id, now)
        if turn > TRIMMED and (now == used).all() and _is_settled(model, learned):
            break
        at = causes(rests.rotations, fit.place - rests.rotations @ fit.point)
        model, used = replace(learned, causes=at), now
        fit = fit._replace(rotations=rests.rotations[used], plays=np.zeros((int(used.sum()), 3)))
    return model, fit, rests, used


def _closest(rests: Resting, agree: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Of the frames (n,) that agree roughly those that agree best: a fit to them is not drawn aside by others in which
    the point had slipped a little (least trimmed squares; Rousseeuw, 1984).
    """
    squares = np.where(agree, rests.squared(0.0), np.inf)
    closest: NDArray[np.bool_] = squares <= np.quantile(squares[agree], TRIMMED_SHARE)
    return closest


def _is_settled(model: Model, learned: Model) -> bool:
    pairs = [(getattr(each, name) for each in (model, learned)) for name in ("led_factor", "beyond", "play_m")]
    return all(abs(before - after) <= SETTLED * after for before, after in pairs)


def _learned(model: Model, views: Views, fit: Pivot, rests: Resting, used: NDArray[np.bool_]) -> Model:
    """What a fit says of how far off LEDs, spots and point are."""
    m = model.shapes.shape[1]
    leds = slice(6, 6 + m)
    told = m - np.trace(fit.covariance[leds, leds]) / model.led_factor**2  # numbers that the film tells
    off = float(fit.causes[:m] @ fit.causes[:m]) / max(float(told), 1.0)
    ratio = float(rests.misfits[used].sum() / max(rests.freedom[used].sum() - told, 1.0))
    own = float(np.trace(views.noise[used][views.seen[used]], axis1=1, axis2=2).mean() / 2.0) + model.beyond
    return replace(
        model,
        led_factor=max(1.0, math.sqrt(off)),
        beyond=max(0.0, model.beyond + (ratio - 1.0) * own),
        play_m=_play(rests, used),
    )


def _play(rests: Resting, used: NDArray[np.bool_]) -> float:
    """One sigma of the point's play, m, 0 where the spots' noise explains the offsets: by their median, which a few
    frames in which it slipped do not change.
    """

    def surprise(play_m: float) -> float:
        return float(np.median(rests.squared(play_m)[used])) - MEDIAN

    if surprise(0.0) <= 2.0 * MEDIAN_SIGMA / math.sqrt(used.sum()):
        return 0.0
    low, high = 0.0, LARGEST_PLAY_M
    while surprise(high) > 0.0:
        low, high = high, 2.0 * high
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if surprise(middle) > 0.0 else (low, middle)
    return high


def _wander(rests: Resting, rows: NDArray[np.intp], play_m: float) -> tuple[float, float]:
    """How far the place wanders from part to part, m, and how many times larger than their noise the squares of that
    are, 1 where they may be chance.
    """
    if len(rows) < PARTS * FEWEST_IN_PART:
        return 0.0, 1.0
    chi2, squares = 0.0, []
    for part in np.array_split(rows, PARTS):
        information = np.linalg.inv(rests.covariances[part] + play_m**2 * np.eye(3))
        covariance = np.linalg.inv(information.sum(axis=0))
        mean = covariance @ np.einsum("nij,nj->i", information, rests.offsets[part])
        chi2 += float(mean @ np.linalg.solve(covariance, mean))
        squares.append(float(mean @ mean - np.trace(covariance)))
    freedom = 3.0 * PARTS - 6.0
    surprise = chi2 / freedom if chi2 > freedom + WANDERS * math.sqrt(2.0 * freedom) else 1.0
    return math.sqrt(max(float(np.mean(squares)), 0.0)), surprise


def _rms(offsets: Floats, place: Floats) -> tuple[float, float]:
    sight = place / np.linalg.norm(place)
    along = offsets @ sight
    across = offsets - np.outer(along, sight)
    return float(np.sqrt((across**2).sum(axis=1).mean())), float(np.sqrt((along**2).mean()))


def check_count(film: str, robot_id: str, count: int) -> None:
    """Raise InputError for too few frames."""
    if count < FEWEST_FRAMES:
        raise InputError(
            f"{film}: {robot_id} is located in {count or 'none'} of its frames, expected {FEWEST_FRAMES} at least, "
            "better 100; keep its LEDs in view and facing the camera"
        )


def check_turned(film: str, robot_id: str, turning: Turning) -> None:
    """Raise InputError where the robot turned about one axis only, or not at all."""
    most, least = math.degrees(turning.most), math.degrees(turning.least)
    if most < LEAST_TURN_DEG:
        raise InputError(
            f"{film}: {robot_id} does not turn while its point rests (by {most:.1f} degrees, RMS), which leaves the "
            "point open; rest the point at one place and tilt the robot about it by up to 30 degrees, to all sides"
        )
    if least < LEAST_TURN_DEG:
        raise InputError(
            f"{film}: {robot_id} turns about one axis only, {direction_text(turning.still)}: by {most:.1f} degrees, "
            f"about others by {least:.1f} (RMS), expected {LEAST_TURN_DEG:g} at least; along that axis its point stays "
            "open; tilt the robot across it as well, by up to 30 degrees"
        )


def check_rests(film: str, robot_id: str, agree: NDArray[np.bool_]) -> None:
    """Raise InputError where the point rests in less than half of the frames."""
    if 2 * agree.sum() < len(agree) or agree.sum() < FEWEST_FRAMES:
        raise InputError(
            f"{film}: no point of {robot_id} rests at one place: at best in {agree.sum()} of {len(agree)} frames, "
            f"expected half of them and {FEWEST_FRAMES} at least; hold the point still in a dimple while the robot is "
            "tilted about it, and leave out the way there"
        )


def check_play(film: str, robot_id: str, play_m: float) -> None:
    """Raise InputError where the point moves about its place."""
    if play_m > LARGEST_PLAY_M:
        raise InputError(
            f"{film}: the point of {robot_id} moves by {1e3 * play_m:.2g} mm (one sigma) about its place, expected "
            f"{1e3 * LARGEST_PLAY_M:g} mm at most; rest it in a dimple that holds it"
        )


def check_open(film: str, robot_id: str, covariance: Floats, turning: Turning) -> None:
    """Raise InputError where the point stays open in some direction."""
    values, vectors = np.linalg.eigh(covariance)
    sigma = math.sqrt(values[-1])
    if sigma > OPEN_M:
        raise InputError(
            f"{film}: it leaves the point of {robot_id} open by {1e3 * sigma:.2g} mm (one sigma) along "
            f"{direction_text(vectors[:, -1])}, expected {1e3 * OPEN_M:g} mm at most; the robot turned by "
            f"{math.degrees(turning.most):.0f} and {math.degrees(turning.least):.0f} degrees (RMS) about two axes; "
            "tilt it more, in more frames, nearer to the camera"
        )
