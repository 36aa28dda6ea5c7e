"""What is remembered is rounded, so that it forgets: tracks that began apart become the same, bit for bit.

A robot's pose is that of its frame's spots, whatever was expected; but where the solver began leaves its mark in the
last digits of it, and these begin the solver in the next frame, without end. Rounded far above that mark, and far
below all that a track is used for, tracks of the same frames agree soon after they began, some blocks of what is
learned (`track.BLOCK_NS`) later. So a film can be cut, its pieces be localized side by side, and give the very bits of
the whole (`asterism batch`).

Where the camera is, if it is followed (`world`), is left as it is: its filter forgets too slowly for that.
"""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.chain.world import Following
from asterism.server.pose.courses import Courses
from asterism.server.pose.remembered import DISTANCE
from asterism.server.pose.track import EVIDENCE, KNOWN, LOG_SUM, NEWEST, Tracks

# Steps are powers of two, which floating-point numbers hold exactly.
TURN = 2.0**22  # a step of a rotation matrix: 2.4e-7
WAY = 2.0**24  # and of a position: 6e-8 m
PACE = 2.0**16  # of velocities and turns: 1.5e-5 m/s and rad/s
SUM = 2.0**16  # of sums of logarithms
LIKELY = 2.0**8  # of the weights of manners of moving
SHARE = 2.0**17  # of a number of any size: 8e-6 of it
SIGMA = 2.0**7  # of what is learned of a robot's LEDs, which is one sigma: 1 %
ODDS = 2.0**6  # of the evidence for a tilt, nats
HALF = 2.0**11  # of a factor of a covariance of motion: 5e-4 of it


def learned_at(tracks: Tracks, exposed_ns: int) -> Floats:
    """As `Tracks.learned_at`, what a block has told rounded."""
    before = tracks.misfits[:, KNOWN].copy()
    learned = tracks.learned_at(exposed_ns)
    new = learned != before
    if new.any():
        learned[new] = tracks.misfits[new, KNOWN] = _shares(learned[new], SIGMA)
    return learned


def forgetful(tracks: Tracks) -> Tracks:
    """The same tracks, rounded. Writes into their ``misfits``: they must be a copy."""
    misfits = tracks.misfits
    misfits[:, NEWEST] = _shares(misfits[:, NEWEST])
    misfits[:, LOG_SUM] = _steps(misfits[:, LOG_SUM], SUM)
    numbers = _shares(tracks.numbers)
    numbers[:, EVIDENCE] = _steps(numbers[:, EVIDENCE], ODDS)
    rotations = _rotations(np.concatenate([tracks.rotations, tracks.other_rotations]))
    robots = len(tracks.seen_ns)
    offs = _shares(tracks.offs)
    offs[..., DISTANCE] = _steps(tracks.offs[..., DISTANCE], WAY)
    told = tracks._replace(
        rotations=rotations[:robots],
        ts=_steps(tracks.ts, WAY),
        velocities=_steps(tracks.velocities, PACE),
        turns=_steps(tracks.turns, PACE),
        other_rotations=rotations[robots:],
        numbers=numbers,
        courses=_courses(tracks.courses),
        offs=offs,
    )
    return Following.of(told, tracks.place) if isinstance(tracks, Following) else told


def _steps(values: Floats, per_one: float) -> Floats:
    out: Floats = np.rint(values * per_one) / per_one
    return out


def _shares(values: Floats, per_one: float = SHARE) -> Floats:
    """Rounded to a share of each."""
    mantissas, exponents = np.frexp(values)
    out: Floats = np.ldexp(np.rint(mantissas * per_one) / per_one, exponents)
    return out


def _rotations(rotations: Floats) -> Floats:
    """Rounded, and rotations again, to 1e-13: Newton's step to the nearest one. Zeros stay zeros."""
    near = _steps(rotations, TURN)
    out: Floats = near @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(near, -1, -2) @ near)
    return out


def _covariances(covariances: Floats) -> Floats:
    """Rounded as their factors are, so that they stay positive; what has no factor is left as it is."""
    try:
        halves = _shares(np.asarray(np.linalg.cholesky(covariances), np.float64), HALF)
    except np.linalg.LinAlgError:
        return covariances
    return np.asarray(halves @ np.swapaxes(halves, -1, -2), np.float64)


def _courses(courses: Courses) -> Courses:
    known = np.flatnonzero(courses.seen_ns)
    if not len(known):
        return courses
    covariances = courses.covariances.copy()
    covariances[known] = _covariances(covariances[known])
    weights = _steps(courses.weights, LIKELY)
    weights[known] /= weights[known].sum(axis=1, keepdims=True)
    return Courses(
        courses.seen_ns,
        _rotations(courses.rotations),
        _steps(courses.ts, WAY),
        _steps(courses.rates, PACE),
        covariances,
        weights,
    )
