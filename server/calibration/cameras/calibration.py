"""Where cameras stand, how their clocks go and how sure that is, from what all of them saw of robots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.constellation import LEDS
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Robot
from asterism.server.calibration.cameras.bundle import Before, Bundle, inverse, solved, with_moments
from asterism.server.calibration.cameras.misfit import misfit2_of
from asterism.server.calibration.cameras.moments import Bools, Moments, moments_of
from asterism.server.calibration.cameras.predicted import Belief, Layout
from asterism.server.calibration.cameras.start import Start, start_of
from asterism.server.calibration.cameras.views import Seen
from asterism.server.calibration.lens.values import values_of
from asterism.server.fusing.clocks import DRIFT_SIGMA, OFFSET_SIGMA_S

MISFIT_M = 1e-4  # how far off LEDs may be, before anything tells
ROUNDS = 3  # of fits, each with the misfit that the one before found
FAR_OFF = 4.5  # sigmas: spots farther off are left out of the last fits
FEWEST_MOMENTS = 12
FOLDS = 5
WAYS = np.array([0, 0, 1])  # of an LED's error: within its robot's plate, and out of it, which are seldom alike
TELLS_S = 1.0  # of a clock's standard deviation: above it robots do not move


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """A camera's clock against the first's: ahead by ``offset_s``, gaining ``drift`` s/s, with standard deviations;
    ``told``: whether robots moved enough to tell.
    """

    offset_s: float
    offset_sigma_s: float
    drift: float
    drift_sigma: float
    told: bool


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """One camera: T_first_camera, with its covariance (6, 6), m and rad about the first camera's axes, about the
    camera; ``lens_share`` what the lenses' errors add to that where they are not fitted; ``lens`` as fitted, with the
    covariance of its values, both None where it was not asked for. Residuals are RMS of a coordinate, px.
    """

    camera: str
    T_first_camera: Pose
    covariance: Floats
    lens_share: Floats
    clock: Clock
    rms_px: float
    held_out_px: float
    frames: int
    robots: tuple[str, ...]
    lens: Camera | None
    lens_covariance: Floats | None


@dataclass(frozen=True, slots=True, eq=False)
class CamerasFit:
    """All cameras in the first's frame; ``misfits_m`` how far off the rigs have robots' LEDs, one sigma
    within the plate; ``moments``
    that were used, ``left_out`` spots; ``noise`` what residuals are in those that the spots' covariances say.
    ``robot_poses``: T_first_robot of every moment by the robot's id, in its middle.
    """

    cameras: tuple[Placed, ...]
    misfits_m: Mapping[str, float]
    moments: int
    left_out: int
    noise: float
    robot_poses: Mapping[str, tuple[Pose, ...]]


def calibrate_cameras(
    seen: Sequence[Seen], robots: Sequence[Robot], lens_errors: Sequence[Floats], lens: bool = False
) -> CamerasFit:
    """Fit all cameras; ``robots`` in the order of their numbers in ``seen``; ``lens_errors`` (p, p) covariances of
    every camera's fx, fy, cx, cy and coefficients; ``lens``: they are fitted too, with these as what is known before.

    Raises InputError where a camera shares no robot with the others, or poses do not agree.
    """
    start = start_of(seen, np.array([robot.leds for robot in robots]))
    moments, motion = moments_of(seen, start)
    if len(moments) < FEWEST_MOMENTS:
        raise InputError(
            f"robots are seen by two cameras at once in {len(moments)} moments of three frames, expected "
            f"{FEWEST_MOMENTS} at least: drive them through the views that the cameras share"
        )
    widths = tuple(4 + len(each.rig.camera.distortion) for each in seen)
    layout = Layout(len(seen), len(robots), widths if lens else ())
    task = _Task(robots, lens_errors, layout, _held_clocks(seen, start, layout))
    belief = Belief(
        rotations=np.array([pose.rotation for pose in start.poses]),
        places=np.array([pose.position for pose in start.poses]),
        clocks=np.column_stack([start.offsets_s, np.zeros(len(seen))]),
        at_s=float(np.median(moments.times_s)),
        leds=np.zeros((len(robots), LEDS, 3)),
        lenses=tuple(each.rig.camera for each in seen),
        motion=motion,
    )
    task.given = belief
    misfits2 = np.full((len(robots), 2), MISFIT_M**2)
    bundle = task.bundle(moments)
    for _ in range(ROUNDS):
        belief, scale2 = bundle.fitted(belief, task.before(belief, misfits2), robust=True)
        misfits2 = task.misfits2(bundle, belief, misfits2, scale2)
    bad = bundle.squared(belief) > FAR_OFF**2 * scale2
    left_out = int(bad.sum())
    moments, belief = _good(moments.without(bad), belief)
    bundle = task.bundle(moments)
    for _ in range(ROUNDS - 1):
        scale2 = _chi2_per_dof(bundle, belief)
        belief, _ = bundle.fitted(belief, task.before(belief, misfits2), robust=False, scale2=scale2)
        misfits2 = task.misfits2(bundle, belief, misfits2, scale2)
    scale2 = _chi2_per_dof(bundle, belief)
    held_out = _held_out(task, moments, belief, misfits2, scale2)
    return _told(task, seen, bundle, belief, misfits2, scale2, held_out, left_out)


class _Task:
    """What stays the same from fit to fit."""

    given: Belief

    def __init__(self, robots: Sequence[Robot], lens_errors: Sequence[Floats], layout: Layout, held: Bools) -> None:
        self.robots, self.lens_errors, self.layout, self.held = robots, lens_errors, layout, held

    def bundle(self, moments: Moments, held: Bools | None = None) -> Bundle:
        return Bundle(self.robots, moments, self.layout, self.held if held is None else held)

    def before(self, belief: Belief, misfits2: Floats) -> Before:
        """What is known of clocks, LEDs and lenses, relative to a belief."""
        layout = self.layout
        information, mean = np.zeros((layout.width, layout.width)), np.zeros(layout.width)
        diagonal = np.zeros(layout.width)
        diagonal[layout.of_clocks] = np.tile([OFFSET_SIGMA_S**-2, DRIFT_SIGMA**-2], layout.cameras - 1)
        mean[layout.of_clocks] = -belief.clocks[1:].ravel()
        mean[layout.of_leds] = -belief.leds.ravel()
        information[np.arange(layout.width), np.arange(layout.width)] = diagonal
        for k, (robot, misfit2) in enumerate(zip(self.robots, misfits2, strict=True)):
            plane, rows = robot.T_robot_plane.rotation, layout.of_robot(k)
            information[rows, rows] = np.kron(np.eye(LEDS), plane @ np.diag(1.0 / misfit2[WAYS]) @ plane.T)
        if layout.lens_widths:
            first = layout.of_lenses.start
            for error, now, given in zip(self.lens_errors, belief.lenses, self.given.lenses, strict=True):
                rows = slice(first, first + len(error))
                information[rows, rows] = _information(error)
                mean[rows] = values_of(given) - values_of(now)
                first = rows.stop
        return Before(information, mean)

    def misfits2(self, bundle: Bundle, belief: Belief, misfits2: Floats, scale2: float) -> Floats:
        """The variances of robots' LEDs anew: (r, 2) m^2, within the plate and out of it."""
        squared = bundle.squared(belief)
        weights = 1.0 / (1.0 + squared / (scale2 * 9.0)) / scale2
        matrix, right, _, _ = bundle.equations(belief, weights).reduced()
        before = self.before(belief, misfits2)
        new = misfits2.copy()
        joined, wanted = matrix + before.information, right + before.information @ before.mean
        for k, robot in enumerate(self.robots):
            plane = np.kron(np.eye(LEDS), robot.T_robot_plane.rotation)
            led_rows = self.layout.of_robot(k)
            to_plane = np.eye(self.layout.width)
            to_plane[led_rows, led_rows] = plane
            theirs, target = to_plane.T @ joined @ to_plane, to_plane.T @ wanted
            for way in (0, 1):
                mine = np.zeros(self.layout.width, bool)
                mine[led_rows] = np.tile(way == WAYS, LEDS)
                rest = ~mine & bundle.free
                across = theirs[np.ix_(rest, mine)]
                answers = solved(theirs[np.ix_(rest, rest)], np.column_stack([across, target[rest]]))
                # By the spots alone: without what was known of these before.
                alone = theirs[np.ix_(mine, mine)] - np.eye(mine.sum()) / misfits2[k, way]
                known = (belief.leds[k] @ robot.T_robot_plane.rotation)[:, way == WAYS].ravel()
                pull = target[mine] + known / misfits2[k, way]
                information = alone - across.T @ answers[:, :-1]
                told = pull - across.T @ answers[:, -1] + information @ known
                new[k, way] = misfit2_of(information, told, np.delete(misfits2[:, way], k))
        return new


def _information(error: Floats) -> Floats:
    """The inverse of a lens' covariance; what is known exactly is known nearly so, to be invertible."""
    sizes = np.sqrt(np.diag(error)) + np.concatenate([np.full(4, 1e-6), np.full(len(error) - 4, 1e-9)])
    values, vectors = np.linalg.eigh(error / np.outer(sizes, sizes))
    return np.asarray(vectors @ np.diag(1.0 / np.maximum(values, 1e-6)) @ vectors.T / np.outer(sizes, sizes))


def _held_clocks(seen: Sequence[Seen], start: Start, layout: Layout) -> Bools:
    """Clocks of cameras with which nobody saw a robot move."""
    held = np.zeros(layout.width, bool)
    clocks = np.ones((len(seen), 2), bool)
    for link in start.links:
        if link.clock is not None and link.clock.offset_sigma_s < TELLS_S:
            clocks[[link.first, link.second]] = False
    held[layout.of_clocks] = clocks[1:].ravel()
    return held


def _good(moments: Moments, belief: Belief) -> tuple[Moments, Belief]:
    """The moments in which two cameras are left, and more numbers than unknowns."""
    lit = moments.lit
    two = np.array([len(set(cameras[seen].tolist())) > 1 for cameras, seen in zip(moments.cameras, lit, strict=True)])
    rows = two & (2 * lit.sum(axis=1) > belief.motion.used().sum(axis=1) + 2)
    if rows.sum() < FEWEST_MOMENTS:
        raise InputError(
            "the cameras' views do not agree with one another, expected rigid robots whose LEDs are where the rigs "
            "have them, and cameras that stood still"
        )
    return moments[rows], with_moments(belief, rows)


def _chi2_per_dof(bundle: Bundle, belief: Belief) -> float:
    unknowns = belief.motion.used().sum() + bundle.free.sum()
    return float(bundle.squared(belief).sum()) / max(float(2 * bundle.moments.lit.sum() - unknowns), 1.0)


def _held_out(task: _Task, moments: Moments, belief: Belief, misfits2: Floats, scale2: float) -> Floats:
    """Residuals px of every camera's coordinates (c,), RMS, in moments that cameras, clocks and LEDs were not fitted
    to: only how the robot moved was.
    """
    squares, counts = np.zeros(task.layout.cameras), np.zeros(task.layout.cameras)
    for fold in range(FOLDS):
        out = np.arange(len(moments)) % FOLDS == fold
        known = with_moments(belief, ~out)
        fit, _ = task.bundle(moments[~out]).fitted(known, task.before(known, misfits2), robust=False, scale2=scale2)
        rest = replace(fit, motion=with_moments(belief, out).motion)
        bundle = task.bundle(moments[out], np.ones(task.layout.width, bool))
        rest, _ = bundle.fitted(rest, task.before(rest, misfits2), robust=False, scale2=scale2)
        off2 = (bundle.off(rest) ** 2).sum(axis=-1)
        for c in range(len(squares)):
            mine = bundle.moments.lit & (bundle.moments.cameras == c)
            squares[c] += off2[mine].sum()
            counts[c] += 2 * mine.sum()
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1.0)), np.float64)


def _told(
    task: _Task, seen: Sequence[Seen], bundle: Bundle, belief: Belief, misfits2: Floats, scale2: float,
    held_out: Floats, left_out: int,
) -> CamerasFit:  # fmt: skip
    """The answer, with covariances."""
    layout, moments = task.layout, bundle.moments
    covariance, by_lens = _covariances(task, bundle, belief, misfits2, scale2)
    off2 = (bundle.off(belief) ** 2).sum(axis=-1)
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    cameras = []
    for c, each in enumerate(seen):
        mine = moments.lit & (moments.cameras == c)
        place, clock = slice(6 * (c - 1), 6 * c), layout.of_clocks.start + 2 * (c - 1)
        free = bool(c) and bool(bundle.free[clock])
        first = layout.of_lenses.start + sum(layout.lens_widths[:c])
        lens = slice(first, first + layout.lens_widths[c]) if layout.lens_widths else None
        cameras.append(
            Placed(
                camera=each.camera,
                T_first_camera=Pose.from_matrix(belief.rotations[c], belief.places[c]),
                covariance=covariance[place, place] if c else np.zeros((6, 6)),
                lens_share=by_lens[place, place] if c else np.zeros((6, 6)),
                clock=Clock(
                    *(float(belief.clocks[c, 0]), float(sigmas[clock]) if free else np.inf),
                    *(float(belief.clocks[c, 1]), float(sigmas[clock + 1]) if free else np.inf),
                    told=free,
                ),
                rms_px=float(np.sqrt(off2[mine].sum() / max(2 * mine.sum(), 1))),
                held_out_px=float(held_out[c]),
                frames=len(np.unique(moments.times_s[mine])),
                robots=tuple(task.robots[k].id for k in np.unique(moments.robots[mine.any(axis=1)])),
                lens=belief.lenses[c] if lens else None,
                lens_covariance=covariance[lens, lens] if lens else None,
            )
        )
    misfits = {robot.id: float(np.sqrt(v)) for robot, v in zip(task.robots, misfits2[:, 0], strict=True)}
    return CamerasFit(
        tuple(cameras), misfits, len(moments), left_out, float(np.sqrt(scale2)), _robot_poses(task, moments, belief)
    )


def _covariances(task: _Task, bundle: Bundle, belief: Belief, misfits2: Floats, scale2: float) -> tuple[Floats, Floats]:
    """Of what moments share (p, p), in the layout's order; and of the cameras' places what lenses, which were not
    fitted, add.
    """
    layout = task.layout
    weights = np.full(bundle.moments.lit.shape, 1.0 / scale2)
    widths = tuple(len(error) for error in task.lens_errors)
    whole = Layout(layout.cameras, layout.robots, widths)
    wide = Bundle(task.robots, bundle.moments, whole, np.zeros(whole.width, bool))
    matrix, _, _, _ = wide.equations(belief, weights).reduced()
    lens = np.zeros(whole.width, bool)
    lens[whole.of_lenses] = True
    rows = np.ones(whole.width, bool) if layout.lens_widths else ~lens
    known = matrix[np.ix_(rows, rows)] + task.before(belief, misfits2).information
    free = bundle.free
    covariance = np.zeros((layout.width, layout.width))
    covariance[np.ix_(free, free)] = inverse(known[np.ix_(free, free)])
    by_lens = np.zeros((layout.width, layout.width))
    if not layout.lens_widths:
        by = covariance @ matrix[np.ix_(rows, lens)]
        error = np.zeros((by.shape[1], by.shape[1]))
        first = 0
        for each in task.lens_errors:
            error[first : first + len(each), first : first + len(each)] = each
            first += len(each)
        by_lens = by @ error @ by.T
    return covariance, by_lens


def _robot_poses(task: _Task, moments: Moments, belief: Belief) -> dict[str, tuple[Pose, ...]]:
    _, places, turns, _ = belief.motion.at(belief.motion.middles_s[:, None])
    poses: dict[str, tuple[Pose, ...]] = {}
    for k, robot in enumerate(task.robots):
        rows = np.flatnonzero(moments.robots == k)
        poses[robot.id] = tuple(Pose.from_matrix(turns[row, 0], places[row, 0]) for row in rows)
    return poses
