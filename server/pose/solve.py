"""From labelled spots to a pose: both minima of the plane refined, the likelier chosen, both kept with their odds.

Rays are corrected for what shifts an LED's spot (`spot_shift`) at the pose they lead to, each minimum for itself.
Covariances are those of the spots carried through the refined pose; what the residuals say is missing in the spots'
own noise (calibration, LED positions) is estimated from them and added to every spot first.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.server.compiled import compiled
from asterism.server.pose.covariance import invert, move_origin, tilt_variance
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import FX, FY, project_point
from asterism.server.pose.matched import Lit, gather
from asterism.server.pose.planar import NO_SOLUTION, normal_equations, other_minimum, refine_pose
from asterism.server.pose.rotations import angle_between, mapped
from asterism.server.pose.spot_shift import correct_rays, refine_shifted, spot_shifts
from asterism.server.pose.systematic import ITERATIONS, odd_led, systematic

FEW = 3  # iterations, after which a second minimum that costs more than the first by HOPELESS is good enough
HOPELESS = 80.0  # squared sigmas: odds of e^40
NEGLIGIBLE = 0.02  # of a spot's own variance
SLIGHT = 0.5  # up to here more variance of every spot makes the pose less sure, but hardly moves it
# Seen nearly in front, both minima may be one: poses no more apart than this. Where the tilt is then no better known
# than that, its sign is open, and the copy stays as the alternative that says so.
SAME_RAD = 0.002
SURE_TILT_RAD = 0.022
MISFIT, NOISE_SHARE = range(2)  # columns of `Solutions.misfits`


@dataclass(frozen=True, slots=True, eq=False)
class Alternative:
    """The other pose that explains the spots, in the same frame, and how many times less likely it is."""

    position: Floats  # (3,) m
    orientation: Floats  # (4,) x y z w
    odds: float

    @property
    def pose(self) -> Pose:
        """The same as a transform."""
        return Pose(self.position, self.orientation)


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """A robot's pose in one frame.

    ``position`` and ``orientation`` are T_world_robot (T_camera_robot where the rig places no camera); ``covariance``
    (6, 6) in m and rad: x, y, z, rotation about x, y, z of the parent frame. ``leds`` (k,) are the LEDs it rests on,
    ``spots`` (k,) the rows of the frame's blobs they are, ``residuals_px`` (k, 2) observed minus predicted.
    ``smoothed_by`` names the filter (`smooth`) that changed pose and covariance; empty: they rest on this frame.
    ``extrapolated``: the rig corrects Z, but no surveyed pose was near: the correction is faded or cut off.
    """

    position: Floats  # (3,) m
    orientation: Floats  # (4,) x y z w
    covariance: Floats
    leds: tuple[int, ...]
    spots: tuple[int, ...]
    residuals_px: Floats
    rms_px: float
    alternative: Alternative | None
    smoothed_by: str = ""
    extrapolated: bool = False

    @property
    def pose(self) -> Pose:
        """The same as a transform."""
        return Pose(self.position, self.orientation)

    @property
    def state(self) -> str:
        """TRACKED or TILT_AMBIGUOUS."""
        return "TRACKED" if self.alternative is None else "TILT_AMBIGUOUS"


@dataclass(frozen=True, slots=True)
class Lost:
    """A robot that has no pose in this frame, and why. ``state`` is LOST or IDENTITY_AMBIGUOUS."""

    reason: str
    state: str = "LOST"


class Solutions(NamedTuple):
    """Both minima of m robots: ``rotations`` (m, 2, 3, 3) and ``ts`` (m, 2, 3) m of T_camera_plane; ``costs`` (m, 2) as
    `systematic`, NO_SOLUTION where there is none or it faces away; ``covariances`` (m, 2, 6, 6) of the plane's origin
    (m) and rotation about the camera's axes (rad); ``residuals`` (m, 2, 6, 2) px, observed minus predicted. How far
    off the rig has the robot's LEDs, one sigma, m: ``learned`` (m,) before, 0 where nothing was, which is not written;
    ``misfits`` (m, 2) by the residuals of this frame alone, and which share of the spots' variance is their own noise.
    """

    rotations: Floats
    ts: Floats
    costs: Floats
    covariances: Floats
    residuals: Floats
    learned: Floats
    misfits: Floats

    @staticmethod
    def room(robots: int, learned: Floats | None = None) -> "Solutions":
        """Room for so many robots."""
        m = robots
        return Solutions(
            np.empty((m, 2, 3, 3)),
            np.empty((m, 2, 3)),
            np.empty((m, 2)),
            np.empty((m, 2, 6, 6)),
            np.empty((m, 2, LEDS, 2)),
            np.zeros(m) if learned is None else learned,
            np.empty((m, 2)),
        )


class _Robot(NamedTuple):
    """One robot: ``layout`` (6, 3) m, ``optics`` (OPTICS,), the spots of its LEDs ``labels`` (6,)."""

    layout: Any
    optics: Any
    labels: Any


class _Work(NamedTuple):
    """Scratch of one robot's solution. Either minimum has its own shifts, and so its own rays."""

    points: Any  # (6, 3)
    seen: Any  # (2, 6, 2)
    applied: Any  # (2, 6, 2)
    information: Any  # (6, 3)
    own: Any  # (6, 3): information of the spots' own noise
    centre: Any  # (3,) of the visible LEDs
    shifts: Any  # (6, 2)
    start: Any  # (3, 3)
    start_t: Any  # (3,)
    kept: Any  # (3, 3)
    kept_t: Any  # (3,)
    arm: Any  # (3,)
    a: Any  # (6, 6)
    b: Any  # (6,)


@compiled
def _work():
    points, seen, applied, information = np.empty((6, 3)), np.empty((2, 6, 2)), np.empty((2, 6, 2)), np.empty((6, 3))
    own, centre, shifts, start, start_t = np.empty((6, 3)), np.empty(3), np.empty((6, 2)), np.empty((3, 3)), np.empty(3)
    kept, kept_t, arm, a, b = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((6, 6)), np.empty(6)
    return _Work(points, seen, applied, information, own, centre, shifts, start, start_t, kept, kept_t, arm, a, b)


@compiled
def _of(solutions, k):
    """One robot's rows."""
    rotations, ts, costs = solutions.rotations[k], solutions.ts[k], solutions.costs[k]
    one = slice(k, k + 1)
    covariances, residuals = solutions.covariances[k], solutions.residuals[k]
    return Solutions(rotations, ts, costs, covariances, residuals, solutions.learned[one], solutions.misfits[one])


@compiled
def _lit(work, which, count, information):
    """The ``count`` visible LEDs as one of the minima sees them."""
    return Lit(work.points[:count], work.seen[which, :count], work.applied[which, :count], information[:count])


@compiled
def _other(solution, known, lit, optics, focal):
    """Fill the pose's other minimum from the ``known`` one; its cost. The rays of ``lit`` become the other's."""
    rotations, ts = solution.rotations, solution.ts
    rotation, t = rotations[1 - known], ts[1 - known]
    if not other_minimum(rotations[known], ts[known], lit.points, lit.seen, rotation, t) or t[2] <= 0.0:
        return NO_SOLUTION
    correct_rays(rotation, t, lit, optics)
    found = refine_pose(rotation, t, lit.points, lit.seen, lit.information, FEW)
    if found < solution.costs[known] + HOPELESS:
        found = refine_shifted(rotation, t, lit, optics, focal, ITERATIONS)
    return found


@compiled
def _both_minima(robot, solution, focal, work, count):
    """Fill both minima of a robot, refined from the start in ``work``."""
    rotations, ts, costs, optics = solution.rotations, solution.ts, solution.costs, robot.optics
    lit, others = _lit(work, 0, count, work.information), _lit(work, 1, count, work.information)
    start, start_t, centre = work.start, work.start_t, work.centre
    rotations[0] = start
    for i in range(3):
        ts[0, i] = start_t[i]
        for j in range(3):
            ts[0, i] += start[i, j] * centre[j]
    costs[0] = refine_shifted(rotations[0], ts[0], lit, optics, focal, ITERATIONS)
    costs[1] = _other(solution, 0, others, optics, focal)
    if costs[1] < costs[0]:
        # The start was the worse one's, perhaps too far from it to arrive: from the better it is near.
        work.kept[:, :], work.kept_t[:] = rotations[0], ts[0]
        kept_cost = costs[0]
        costs[0] = _other(solution, 1, lit, optics, focal)
        if costs[0] > kept_cost:
            rotations[0], ts[0], costs[0] = work.kept, work.kept_t, kept_cost
            correct_rays(rotations[0], ts[0], lit, optics)


@compiled
def _largest(table, column):
    """The largest number of a column of a table (n, m) of numbers that are not negative."""
    largest = 0.0
    for k in range(table.shape[0]):
        largest = max(largest, table[k, column])
    return largest


@compiled
def _refine_both(robot, measured, solution, focal, work):
    """Fill both minima of a robot, costs as of `refine_pose`, and leave ``work`` as they saw the spots.

    Residuals beyond the spots' noise, whatever causes them, count as noise of every spot: then both are refined again.
    Returns the better one and how many LEDs are visible.
    """
    rotations, ts, costs = solution.rotations, solution.ts, solution.costs
    room = Lit(work.points, work.seen[0], work.applied[0], work.information)
    extra, is_slight = 0.0, False
    better = count = 0
    for attempt in range(2):
        count = gather(robot.layout, robot.labels, measured, work.shifts, extra, focal, room, work.centre)
        work.seen[1, :, :] = work.seen[0]
        work.applied[1, :, :] = work.applied[0]
        if attempt == 0:
            _both_minima(robot, solution, focal, work, count)
        elif not is_slight:
            for which in range(2):
                if costs[which] < NO_SOLUTION:
                    lit = _lit(work, which, count, work.information)
                    costs[which] = refine_shifted(rotations[which], ts[which], lit, robot.optics, focal, ITERATIONS)
        better = 0 if costs[0] <= costs[1] else 1
        if attempt == 1 or costs[better] >= NO_SOLUTION:
            break
        work.own[:count] = work.information[:count]
        lit = _lit(work, better, count, work.information)
        known2 = (solution.learned[0] / ts[better, 2]) ** 2
        extra, _ = systematic(rotations[better], ts[better], lit, focal, known2)
        share = extra * (_largest(lit.information, 0) + _largest(lit.information, 2))
        if share < NEGLIGIBLE:
            break
        is_slight = share < SLIGHT
    return better, count


@compiled
def _measure_up(rotation, t, lit, work, covariance):
    """Fill the ``covariance`` (6, 6) of a pose about the visible LEDs' mean, and move both to the plane's origin."""
    a, arm, centre = work.a, work.arm, work.centre
    normal_equations(rotation, t, lit.points, lit.seen, lit.information, a, work.b)
    invert(a, covariance)
    # t -= R centre, with the rotation's share.
    for i in range(3):
        arm[i] = 0.0
        for j in range(3):
            arm[i] -= rotation[i, j] * centre[j]
        t[i] += arm[i]
    move_origin(covariance, arm)


@compiled
def _fill_residuals(lens, robot, rotation, t, centres_px, shifts, residuals):
    """Fill ``residuals`` (6, 2) px of a pose: observed minus predicted, 0 for LEDs not seen."""
    layout, labels = robot.layout, robot.labels
    spot_shifts(rotation, t, layout, robot.optics, shifts)
    for led in range(LEDS):
        residuals[led, :] = 0.0
        spot = labels[led]
        if spot >= 0:
            x, y, z = mapped(rotation, t, layout[led])
            px, py = project_point(lens, x + shifts[led, 0] * z, y + shifts[led, 1] * z, z)
            residuals[led, 0] = centres_px[spot, 0] - px
            residuals[led, 1] = centres_px[spot, 1] - py


@compiled
def _solve(lens, robot, measured, solution, focal, work):
    """Solve one robot from the start in ``work``; ``solution`` are its rows of the `Solutions`."""
    rotations, ts, costs, covariances = solution.rotations, solution.ts, solution.costs, solution.covariances
    spot_shifts(work.start, work.start_t, robot.layout, robot.optics, work.shifts)
    known2 = (solution.learned[0] / max(work.start_t[2], 1e-6)) ** 2
    odd = odd_led(robot.layout, robot.labels, measured, work.shifts, work.start, work.start_t, focal, known2)
    if odd >= 0:
        robot.labels[odd] = -1
    costs[:] = NO_SOLUTION
    solution.misfits[0, MISFIT], solution.misfits[0, NOISE_SHARE] = 0.0, 1.0
    better, count = _refine_both(robot, measured, solution, focal, work)
    for which in range(2):
        rotation, t = rotations[which], ts[which]
        towards = 0.0
        for i in range(3):
            towards += rotation[i, 2] * t[i]
        if costs[which] >= NO_SOLUTION or towards >= 0.0:
            costs[which] = NO_SOLUTION
            continue
        own = _lit(work, which, count, work.own)
        told, costs[which] = systematic(rotation, t, own, focal, known2)
        if which == better:
            if known2 > 0.0:
                told, _ = systematic(rotation, t, own, focal, 0.0)
            noise = 2.0 / (_largest(own.information, 0) + _largest(own.information, 2))
            solution.misfits[0, MISFIT], solution.misfits[0, NOISE_SHARE] = (
                math.sqrt(told) * t[2],
                noise / (noise + told),
            )
        _measure_up(rotation, t, _lit(work, which, count, work.information), work, covariances[which])
        _fill_residuals(lens, robot, rotation, t, measured.centres_px, work.shifts, solution.residuals[which])
    if (
        costs[0] < NO_SOLUTION
        and costs[1] < NO_SOLUTION
        and angle_between(rotations[0], rotations[1]) < SAME_RAD
        and tilt_variance(rotations[better], covariances[better]) < SURE_TILT_RAD**2
    ):
        costs[1 - better] = NO_SOLUTION


@compiled
def solve_robots(lens, constellations, matched, measured, solutions):
    """Solve every matched robot: fill the `Solutions` from `Constellations`, `Matched` and `Measured`.

    ``lens`` as in `lens`. Where one of six spots turns out to be odd, the robot's assignment is changed.
    """
    work = _work()
    focal = math.sqrt(lens[FX] * lens[FY])
    for k in range(matched.robots.shape[0]):
        work.start[:, :], work.start_t[:] = matched.rotations[k], matched.ts[k]
        index = matched.robots[k]
        robot = _Robot(constellations.layouts[index], constellations.optics[index], matched.assignment[k])
        _solve(lens, robot, measured, _of(solutions, k), focal, work)
