"""From labelled spots to a pose: both minima of the plane refined, the likelier chosen, both kept with their odds.

Rays are corrected for what shifts an LED's spot (`spot_shift`) at the pose they lead to, each minimum for itself.
Covariances are those of the spots carried through the refined pose; what the residuals say is missing in the spots'
own noise (calibration, LED positions) is estimated from them and added to every spot first.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.server.compiled import compiled
from asterism.server.pose.covariance import move_origin
from asterism.server.pose.fit import LEDS
from asterism.server.pose.led_doubt import add_doubts
from asterism.server.pose.lens import FX, FY, project_point
from asterism.server.pose.minima import SAME_RAD, Robot, find_missed, largest, lit_of, look_wide, refine_both, work_room
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.rotations import angle_between, log_between, mapped
from asterism.server.pose.spot_shift import DOUBTS, spot_shifts
from asterism.server.pose.spread import COVERED, spread, squared
from asterism.server.pose.systematic import odd_led, systematic
from asterism.server.pose.valley import tilt_of, valley_room

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
class OnSurface:
    """How a robot that by the rig stands on the surface does so in one frame.

    ``standing``: ON_SURFACE: the surface is part of what the pose rests on. LIFTED, SUNK, TILTED, BEYOND (the edge):
    it rests on light alone, and ``reason`` says why. By light alone: ``off_m`` from the surface to the robot's point
    along the normal, positive out of the material, and ``tilt_off_rad`` between axis and normal, each with its sigma,
    light and surface together; nan where there is no surface. ``without``: what light alone says, where the surface was
    used: position, orientation, its covariance (6, 6), and the other tilt. ``by_spots`` (6, 6): the part of the
    pose's covariance that single spots' errors make; the rest is the surface's, and stays.
    """

    standing: str
    reason: str
    off_m: float
    off_sigma_m: float
    tilt_off_rad: float
    tilt_off_sigma_rad: float
    without: Pose | None = None
    without_covariance: Floats | None = None
    without_alternative: Alternative | None = None
    by_spots: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """A robot's pose in one frame.

    ``position`` and ``orientation`` are T_world_robot (T_camera_robot where the rig places no camera); ``covariance``
    (6, 6) in m and rad: x, y, z, rotation about x, y, z of the parent frame. ``leds`` (k,) are the LEDs it rests on,
    ``spots`` (k,) the rows of the frame's blobs they are, ``residuals_px`` (k, 2) observed minus predicted.
    ``smoothed_by`` names the filter (`smooth`) that changed pose and covariance; empty: they rest on this frame.
    ``extrapolated``: the rig corrects Z, but no surveyed pose was near: the correction is faded or cut off.
    ``surface``: only of a robot that by the rig stands on the surface.
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
    surface: OnSurface | None = None

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


@compiled
def _of(solutions, k):
    """One robot's rows."""
    rotations, ts, costs = solutions.rotations[k], solutions.ts[k], solutions.costs[k]
    one = slice(k, k + 1)
    covariances, residuals = solutions.covariances[k], solutions.residuals[k]
    return Solutions(rotations, ts, costs, covariances, residuals, solutions.learned[one], solutions.misfits[one])


@compiled
def _fill_arm(rotation, centre, arm):
    """Fill ``arm`` (3,): the plane's origin as seen from the visible LEDs' mean, in the camera's axes."""
    for i in range(3):
        arm[i] = 0.0
        for j in range(3):
            arm[i] -= rotation[i, j] * centre[j]


@compiled
def _spread(solution, which, alone, step, work, valley):
    """Bring a minimum's covariance to the plane's origin, and where it has a valley (`look_wide`) fill it with that's.

    ``alone``: there is no other minimum, else only what lies on its side of that.
    """
    covariance, rotation = solution.covariances[which], solution.rotations[which]
    if step == 0.0:
        _fill_arm(rotation, work.centre, work.arm)
        move_origin(covariance, work.arm)
        return
    x, y = tilt_of(rotation, valley)
    other_x, other_y = tilt_of(solution.rotations[1 - which], valley)
    spread(x, y, other_x, other_y, alone, step, valley, covariance)


@compiled
def _apart(solution, better, work, valley):
    """Squared difference of the two minima's poses, weighted by the better one's covariance."""
    rotations, ts, move = solution.rotations, solution.ts, np.empty(6)
    log_between(rotations[better], rotations[1 - better], move[3:])
    for i in range(3):
        move[i] = ts[1 - better, i] - ts[better, i]
        for j in range(3):
            move[i] -= (rotations[1 - better, i, j] - rotations[better, i, j]) * work.centre[j]
    return squared(move, solution.covariances[better], valley)


@compiled
def _faces(rotation, t):
    """Whether a pose turns its plane's +z to the camera."""
    towards = 0.0
    for i in range(3):
        towards += rotation[i, 2] * t[i]
    return towards < 0.0


@compiled
def _tell_misfit(solution, which, own, told, focal, known2):
    """Fill what this frame alone says of the robot's LEDs (`Solutions.misfits`); ``told`` with what is known before."""
    if known2 > 0.0:
        told, _ = systematic(solution.rotations[which], solution.ts[which], own, focal, 0.0)
    noise = 2.0 / (largest(own.information, 0) + largest(own.information, 2))
    solution.misfits[0, MISFIT] = math.sqrt(told) * solution.ts[which, 2]
    solution.misfits[0, NOISE_SHARE] = noise / (noise + told)


@compiled
def _measure_up(robot, solution, better, count, focal, work, valley):
    """Fill costs and covariances of both minima, about the plane's origin; one that is no other pose goes.

    Of two minima of equal cost the wider, of all six numbers together, is the likelier.
    """
    rotations, ts, costs, covariances = solution.rotations, solution.ts, solution.costs, solution.covariances
    for which in range(2):
        if costs[which] < NO_SOLUTION and not _faces(rotations[which], ts[which]):
            costs[which] = NO_SOLUTION
    if costs[better] >= NO_SOLUTION:
        better = 1 - better
    if costs[better] >= NO_SOLUTION:
        return
    better, narrow, step = find_missed(robot, solution, better, count, focal, work, valley)
    other = 1 - better
    if costs[other] < NO_SOLUTION and angle_between(rotations[0], rotations[1]) < SAME_RAD:
        costs[other] = NO_SOLUTION
    known2 = (solution.learned[0] / ts[better, 2]) ** 2
    for which in range(2):
        if costs[which] < NO_SOLUTION:
            own = lit_of(work, which, count, work.own)
            if which == better and work.told[1] < NO_SOLUTION:
                told, costs[which] = work.told[0], work.told[1]
            else:
                told, costs[which] = systematic(rotations[which], ts[which], own, focal, known2)
            if which == better:
                _tell_misfit(solution, better, own, told, focal, known2)
    has_other = costs[other] < NO_SOLUTION
    _spread(solution, better, not has_other, step, work, valley)
    if has_other and step > 0.0 and _apart(solution, better, work, valley) <= COVERED:
        costs[other] = NO_SOLUTION
        _spread(solution, better, True, step, work, valley)
    elif has_other:
        lit = lit_of(work, other, count, work.information)
        other_narrow, step = look_wide(rotations[other], ts[other], lit, work, valley, covariances[other])
        costs[other] += other_narrow - narrow
        _spread(solution, other, False, step, work, valley)


@compiled
def fill_residuals(lens, robot, rotation, t, centres_px, shifts, residuals):
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
def _solve(lens, robot, measured, solution, focal, work, valley):
    """Solve one robot from the start in ``work``; ``solution`` are its rows of the `Solutions`."""
    rotations, ts, costs = solution.rotations, solution.ts, solution.costs
    spot_shifts(work.start, work.start_t, robot.layout, robot.optics, work.shifts)
    known2 = (solution.learned[0] / max(work.start_t[2], 1e-6)) ** 2
    odd = odd_led(robot.layout, robot.labels, measured, work.shifts, work.start, work.start_t, focal, known2)
    if odd >= 0:
        robot.labels[odd] = -1
    costs[:] = NO_SOLUTION
    better, count = refine_both(robot, measured, solution, focal, work)
    solution.misfits[0, MISFIT], solution.misfits[0, NOISE_SHARE] = 0.0, 1.0
    _measure_up(robot, solution, better, count, focal, work, valley)
    for which in range(2):
        if costs[which] < NO_SOLUTION:
            _fill_arm(rotations[which], work.centre, work.arm)
            if robot.optics[DOUBTS] > 0.0:
                lit = lit_of(work, which, count, work.information)
                add_doubts(rotations[which], ts[which], lit, robot.optics, work.arm, solution.covariances[which])
            ts[which] += work.arm
            fill_residuals(
                lens, robot, rotations[which], ts[which], measured.centres_px, work.shifts, solution.residuals[which]
            )


@compiled
def solve_robots(lens, constellations, matched, measured, solutions):
    """Solve every matched robot: fill the `Solutions` from `Constellations`, `Matched` and `Measured`.

    ``lens`` as in `lens`. Where one of six spots turns out to be odd, the robot's assignment is changed.
    """
    work, valley = work_room(), valley_room()
    focal = math.sqrt(lens[FX] * lens[FY])
    for k in range(matched.robots.shape[0]):
        work.start[:, :], work.start_t[:] = matched.rotations[k], matched.ts[k]
        index = matched.robots[k]
        robot = Robot(constellations.layouts[index], constellations.optics[index], matched.assignment[k])
        _solve(lens, robot, measured, _of(solutions, k), focal, work, valley)
