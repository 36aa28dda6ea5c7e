"""Poses at mid-frame from a rolling shutter, which sees every LED at its own row's time.

What an LED's spot lacks or has too much of, against the middle row's time, is what its robot's motion does in between:
rays are brought to mid-frame by the robot's rates (velocity and turn, from the frames before and, once its pose is
known, from this one), solved, and solved once more with the rates that follow.

The covariance. Rates that are off by e shift LED i by T_i A_i e, with T_i its row's time and A_i (2, 6) the derivatives
of its ray by the pose; the pose, A's least squares, by G e, with the skew G = N^-1 sum T_i A_i' W_i A_i and
N = sum A_i' W_i A_i. So a pose's error is its noise n and G e, which are not independent, since the rates rest on n as
well: C + G P G' - C K' G' - G K C, with C of the noise, P of the rates and K their gain from the pose.

The affine part of what unknown rates do to a constellation looks like another tilt. So that neither tilt is sure where
it is not, the spots' covariances are widened by their own share of it before the solution, (T_i - T)^2 A_i P A_i', T
the robot's mean; of the solution's covariance that share is taken off again.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.pose.choose import Choices, Mounts, choose
from asterism.server.pose.common_shift import add_common_shifts
from asterism.server.pose.lens import FX, FY, project_point
from asterism.server.pose.matched import LEAST_SIGMA_PX, Constellations, Matched, Measured
from asterism.server.pose.motion import (
    Expected,
    Moving,
    Rates,
    Seen,
    begin,
    density,
    expect,
    follow_course,
    is_green,
    share_turning,
    turned,
)
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.track import KNOWN, Tracks


class Shutter(NamedTuple):
    """A rolling shutter: ``line_s`` from one row to the next; ``middle`` is the row whose time is the frame's."""

    line_s: float
    middle: float

    def times(self, rows: Floats) -> Floats:
        """When rows are seen, s after mid-frame."""
        return (rows - self.middle) * self.line_s


class Setup(NamedTuple):
    """What solving takes of a rig: ``lens`` as in `lens`, its constellations, mounts and shutter."""

    lens: Floats
    constellations: Constellations
    mounts: Mounts
    shutter: Shutter


class _Lit(NamedTuple):
    """The LEDs of m robots: ``layouts`` (m, 6, 3) m, ``spots`` (m, 6) rows of the `Measured`, whether they are ``lit``
    (m, 6), and the ``times`` (m, 6) s after mid-frame at which they were seen.
    """

    layouts: Floats
    spots: NDArray[np.int64]
    lit: NDArray[np.bool_]
    times: Floats

    def mean(self) -> Floats:
        """The robots' own times (m,), s."""
        mean: Floats = self.times.sum(axis=1) / np.maximum(self.lit.sum(axis=1), 1)
        return mean


def at_own_rows(tracks: Tracks, exposed_ns: int, lens: Floats, shutter: Shutter) -> Tracks:
    """The tracks with every robot moved on to the time at which the rows are seen that it should be in at mid-frame."""
    dt = np.where(tracks.seen_ns > 0, exposed_ns - tracks.seen_ns, 0) * 1e-9
    x, y, z = (tracks.ts + tracks.velocities * dt[:, None]).T
    ahead = (tracks.seen_ns > 0) & (z > 0.0)
    row = np.zeros(len(z))
    for robot in np.flatnonzero(ahead):
        row[robot] = project_point(lens, x[robot], y[robot], z[robot])[1]
    # Who is out of view is seen at the frame's end.
    time = np.where(ahead, shutter.times(np.clip(row, 0.0, 2.0 * shutter.middle)), 0.0)[:, None]
    return tracks._replace(
        ts=tracks.ts + tracks.velocities * time, rotations=turned(tracks.turns * time) @ tracks.rotations
    )


class _Frame(NamedTuple):
    """What one frame's looks at it have in common."""

    setup: Setup
    measured: Measured
    heights: Floats
    commons: Floats
    exposed_ns: int
    tracks: Tracks
    expected: Expected
    solutions: Solutions
    choices: Choices


class _Look(NamedTuple):
    """What came of solving with certain rates: the robots ``told`` (k,) that have a pose, the minimum that is the
    ``best`` (k,), their LEDs, poses and motion.
    """

    told: NDArray[np.int64]
    best: NDArray[np.int64]
    lit: _Lit
    seen: Seen
    moving: Moving

    def shift(self) -> Floats:
        """How far (k, 6), m and rad, poses are off because the rates turned out other than they were taken for."""
        shift: Floats = np.einsum("mij,mj->mi", self.seen.skews, self.seen.used - self.moving.mean)
        return shift


def solve_rolling(
    setup: Setup,
    found: Matched,
    measured: Measured,
    heights: Floats,
    commons: Floats,
    exposed_ns: int,
    tracks: Tracks,
) -> tuple[Solutions, Choices, Tracks, tuple[Measured, Floats]]:
    """Solve and choose as `solve_robots` and `choose` do, for mid-frame. Writes the tracks, and returns them with what
    is remembered of the robots' motion; and the spots as they would have been seen at mid-frame, with what is not known
    of the poses (m, 6, 6) because of the motion.

    ``heights`` (n,) are those of the spots; ``commons`` (m, 3) as in `common_shift.add_common_shifts`.
    """
    tracks = tracks._replace(courses=tracks.courses.copy_for(len(tracks.seen_ns)))
    m = len(found.robots)
    solutions, choices = Solutions.room(m, tracks.misfits[found.robots, KNOWN]), Choices.room(m)
    expected = expect(tracks.courses, found.robots, exposed_ns)
    rates = expected.rates()
    green = is_green(rates)
    frame = _Frame(setup, measured, heights, commons, exposed_ns, tracks, expected, solutions, choices)
    first = found._replace(assignment=found.assignment.copy())
    poses = _back(found, _lit(setup, found, measured).mean(), rates)
    look = _look(frame, first, poses, rates)
    for column, new in zip(poses, look.seen[:2], strict=True):
        column[look.told] = new
    rates = _with(rates, look.told, look.moving)
    look = _look(frame, found, poses, rates)
    # A robot's first two poses were off alike; now only the second is right, and its rates are known already.
    known = Rates._make(column[look.told] for column in rates)
    look = look._replace(moving=look.moving.with_rows(green[look.told], begin(look.seen, known)))
    _tell(frame, found, look)
    return solutions, choices, tracks, _at_rest(frame, found, look, _with(rates, look.told, look.moving))


def _look(frame: _Frame, found: Matched, poses: tuple[Floats, Floats], rates: Rates) -> _Look:
    """Solve with the ``rates``, by ``poses`` of about mid-frame; fills the frame's solutions and choices."""
    setup, solutions, choices = frame.setup, frame.solutions, frame.choices
    brought, blurred = _bring(setup.lens, _lit(setup, found, frame.measured), frame.measured, poses, rates)
    solve_robots(setup.lens, setup.constellations, found, brought, solutions)
    add_common_shifts(setup.constellations, found, brought, frame.commons, setup.lens[FX], solutions)
    trial = frame.tracks.copy_for(len(frame.tracks.seen_ns))
    choose(found, frame.exposed_ns, solutions, frame.heights, setup.mounts, trial, choices)
    told = np.flatnonzero(choices.best >= 0)
    best = choices.best[told]
    lit = _Lit._make(column[told] for column in _lit(setup, found, frame.measured))
    solved = solutions.rotations[told, best], solutions.ts[told, best]
    noise, skews = _noise(setup.lens, lit, (brought, blurred), solved, solutions.covariances[told, best])
    seen = Seen(*solved, noise, rates.mean[told], skews)
    expected = Expected._make(column[told] for column in frame.expected)
    return _Look(told, best, lit, seen, follow_course(expected, seen))


def _tell(frame: _Frame, found: Matched, look: _Look) -> None:
    """Choose for good, by poses and covariances at mid-frame, and write the tracks."""
    solutions, tracks, moving = frame.solutions, frame.tracks, look.moving
    where, shift = (look.told, look.best), look.shift()
    solutions.rotations[where] = turned(shift[:, 3:]) @ look.seen.rotations
    solutions.ts[where] = look.seen.ts + shift[:, :3]
    solutions.covariances[where] = _at_mid_frame(look)
    choose(found, frame.exposed_ns, solutions, frame.heights, frame.setup.mounts, tracks, frame.choices)
    robots = found.robots[look.told]
    tracks.courses.write(robots, frame.exposed_ns, moving[:5])
    tracks.velocities[robots], tracks.turns[robots] = moving.mean[:, :3], moving.mean[:, 3:]


def _at_rest(frame: _Frame, found: Matched, look: _Look, rates: Rates) -> tuple[Measured, Floats]:
    """The spots brought to mid-frame by the rates as they turned out, and what these leave open of the poses."""
    solutions, terms = frame.solutions, np.zeros((len(found.robots), 6, 6))
    poses = found.rotations.copy(), found.ts.copy()
    poses[0][look.told], poses[1][look.told] = (
        solutions.rotations[look.told, look.best],
        solutions.ts[look.told, look.best],
    )
    brought, _ = _bring(frame.setup.lens, _lit(frame.setup, found, frame.measured), frame.measured, poses, rates)
    skews, moving, at = look.seen.skews, look.moving, np.arange(6)
    told = skews @ moving.covariances[:, 6:, 6:] @ skews.transpose(0, 2, 1)
    told[:, at, at] += density(moving.weights) * np.abs(look.lit.mean())[:, None] ** 3 / 3.0
    terms[look.told] = 0.5 * (told + told.transpose(0, 2, 1))
    return brought._replace(covariances=frame.measured.covariances), terms


def _with(rates: Rates, rows: NDArray[np.int64], moving: Moving) -> Rates:
    """The rates with those of some rows (k,) as they turned out."""
    changed = Rates._make(column.copy() for column in rates)
    for column, new in zip(changed, moving.rates(), strict=True):
        column[rows] = new
    return changed


def _back(found: Matched, times: Floats, rates: Rates) -> tuple[Floats, Floats]:
    """Poses (m, 3, 3), (m, 3) at mid-frame of robots that were found where they are at their own ``times`` (m,) s."""
    gone = rates.mean * times[:, None]
    return turned(-gone[:, 3:]) @ found.rotations, found.ts - gone[:, :3]


def _lit(setup: Setup, found: Matched, measured: Measured) -> _Lit:
    spots = found.assignment
    times = np.where(spots >= 0, setup.shutter.times(measured.centres_px[spots, 1]), 0.0)
    return _Lit(setup.constellations.layouts[found.robots], spots, spots >= 0, times)


def _derivatives(arms: Floats, places: Floats) -> Floats:
    """Derivatives (m, 6, 2, 6) of rays by position and rotation of their robots: LEDs at ``places`` (m, 6, 3) m in the
    camera's frame, ``arms`` (m, 6, 3) from their robots' origins.
    """
    x, y, z = np.moveaxis(places, -1, 0)
    by_place = np.zeros((*z.shape, 2, 3))
    by_place[..., 0, 0] = by_place[..., 1, 1] = 1.0 / z
    by_place[..., 0, 2], by_place[..., 1, 2] = -x / z**2, -y / z**2
    a, b, c = np.moveaxis(arms, -1, 0)
    by_turn = np.zeros((*z.shape, 3, 3))  # of turn x arm
    by_turn[..., 0, 1], by_turn[..., 0, 2] = c, -b
    by_turn[..., 1, 0], by_turn[..., 1, 2] = -c, a
    by_turn[..., 2, 0], by_turn[..., 2, 1] = b, -a
    return np.concatenate([by_place, by_place @ by_turn], axis=-1)


def _places(lit: _Lit, poses: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """The LEDs' arms and places (m, 6, 3) m in the camera's frame."""
    rotations, ts = poses
    arms = lit.layouts @ rotations.transpose(0, 2, 1)
    return arms, arms + ts[:, None]


def _bring(
    lens: Floats, lit: _Lit, measured: Measured, poses: tuple[Floats, Floats], rates: Rates
) -> tuple[Measured, Floats]:
    """The spots as they would have been seen at mid-frame, by poses (m, 3, 3), (m, 3) of about then; and by how much
    their rays' covariances (n, 3) were widened.
    """
    arms, places = _places(lit, poses)
    velocity, turn, time = rates.mean[:, None, :3], rates.mean[:, None, 3:], lit.times[..., None]
    # An arc, as far as velocities turn with the robots, or straight on.
    arc = np.einsum("mkij,mkj->mki", turned(0.5 * turn * time), np.broadcast_to(velocity, arms.shape))
    way = (velocity + share_turning(rates.weights)[:, None, None] * (arc - velocity)) * time
    then = np.einsum("mkij,mkj->mki", turned(turn * time), arms) + places - arms + way
    moved = then[..., :2] / then[..., 2:] - places[..., :2] / places[..., 2:]
    by_pose = _derivatives(arms, places)
    apart = (lit.times - lit.mean()[:, None]) ** 2
    wider = apart[..., None, None] * (by_pose @ rates.covariance[:, None] @ by_pose.transpose(0, 1, 3, 2))
    rays, centres = measured.rays.copy(), measured.centres_px.copy()
    blurred = np.zeros_like(measured.covariances)
    spots = lit.spots[lit.lit]
    rays[spots] -= moved[lit.lit]
    wide = wider[lit.lit]
    blurred[spots] = np.stack([wide[:, 0, 0], wide[:, 0, 1], wide[:, 1, 1]], axis=1)
    for spot in spots:
        centres[spot] = project_point(lens, rays[spot, 0], rays[spot, 1], 1.0)
    return Measured(rays, measured.covariances + blurred, centres), blurred


def _square(covariances: Floats) -> Floats:
    """Matrices (..., 2, 2) of covariances (..., 3) xx, xy, yy."""
    xx, xy, yy = np.moveaxis(covariances, -1, 0)
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)


def _noise(
    lens: Floats, lit: _Lit, seen: tuple[Measured, Floats], poses: tuple[Floats, Floats], covariances: Floats
) -> tuple[Floats, Floats]:
    """Of solved poses the covariances (m, 6, 6), without what their spots' were widened by, and skews (m, 6, 6)."""
    measured, blurred = seen
    by_pose = _derivatives(*_places(lit, poses))
    own = _square(measured.covariances[lit.spots]) + (LEAST_SIGMA_PX**2 / (lens[FX] * lens[FY])) * np.eye(2)
    weights = np.linalg.inv(own) * lit.lit[..., None, None]
    weighted = weights @ by_pose
    back = by_pose.transpose(0, 1, 3, 2)
    whole = np.linalg.inv((back @ weighted).sum(axis=1))
    skews = whole @ (lit.times[..., None, None] * (back @ weighted)).sum(axis=1)
    wide = weighted.transpose(0, 1, 3, 2) @ _square(blurred[lit.spots]) @ weighted
    # Seen nearly in front a covariance is that of all tilts, more than least squares make it, or less along some axes:
    # what it has beyond them is kept, what they owe to the widening goes.
    noise = whole - whole @ wide.sum(axis=1) @ whole + _positive(covariances - whole, covariances)
    return 0.5 * (noise + noise.transpose(0, 2, 1)), skews


def _positive(excess: Floats, covariances: Floats) -> Floats:
    """The positive part of symmetric matrices (m, 6, 6), in units of the covariances' own sigmas."""
    sigmas = np.sqrt(np.einsum("mii->mi", covariances))
    scale = sigmas[:, :, None] * sigmas[:, None, :]
    unit = excess / scale
    values, vectors = np.linalg.eigh(0.5 * (unit + unit.transpose(0, 2, 1)))
    part: Floats = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1) * scale
    return part


def _at_mid_frame(look: _Look) -> Floats:
    """Covariances (k, 6, 6) of poses at mid-frame."""
    noise, skews, moving = look.seen.covariances, look.seen.skews, look.moving
    both = skews @ moving.gains @ noise
    told = noise + skews @ moving.covariances[:, 6:, 6:] @ skews.transpose(0, 2, 1) - both - both.transpose(0, 2, 1)
    # What is not known of the acceleration between the robot's own rows and the middle one.
    at = np.arange(6)
    told[:, at, at] += density(moving.weights) * np.abs(look.lit.mean())[:, None] ** 3 / 3.0
    covariances: Floats = told
    return covariances
