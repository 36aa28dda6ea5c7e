"""What is remembered is rounded, so that it forgets: tracks that began apart become the same, bit for bit.

A robot's pose is that of its frame's spots, whatever was expected; but where the solver began leaves its mark in the
last digits of it, and these begin the solver in the next frame, without end. Rounded far above that mark, and far
below all that a track is used for, tracks of the same frames agree soon after they began, some blocks of what is
learned (`track.BLOCK_NS`) later at the latest. So a film can be cut, its pieces be localized side by side, and give
the very bits of the whole (`asterism batch`); and localizing again can begin anywhere.
"""

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.server.chain.world import Following
from asterism.server.pose.courses import Courses
from asterism.server.pose.place import Place
from asterism.server.pose.track import LOG_SUM, NEWEST, Tracks

# Steps are powers of two, so that what is rounded stays as it is.
TURN = 2.0**22  # a step of a rotation matrix: 2.4e-7
WAY = 2.0**24  # and of a position: 6e-8 m
PACE = 2.0**16  # of velocities and turns: 1.5e-5 m/s and rad/s
SUM = 2.0**16  # of sums of logarithms
LIKELY = 2.0**8  # of the weights of manners of moving
SHARE = 2.0**17  # of a number of any size: 8e-6 of it
HALF = 2.0**11  # of a factor of a covariance of motion: 5e-4 of it
PLACE = 2.0**26  # of where the camera is: 1.5e-8 m


def forgetful(tracks: Tracks) -> Tracks:
    """The same tracks, rounded; those that are rounded are left as they are."""
    misfits = tracks.misfits
    misfits[:, NEWEST] = _shares(misfits[:, NEWEST])
    misfits[:, LOG_SUM] = _steps(misfits[:, LOG_SUM], SUM)
    rotations = _rotations(np.concatenate([tracks.rotations, tracks.other_rotations]))
    robots = len(tracks.seen_ns)
    told = tracks._replace(
        rotations=rotations[:robots],
        ts=_steps(tracks.ts, WAY),
        velocities=_steps(tracks.velocities, PACE),
        turns=_steps(tracks.turns, PACE),
        other_rotations=rotations[robots:],
        numbers=_shares(tracks.numbers),
        courses=_courses(tracks.courses),
    )
    return Following.of(told, _place(tracks.place)) if isinstance(tracks, Following) else told


def _steps(values: Floats, per_one: float) -> Floats:
    out: Floats = np.rint(values * per_one) / per_one
    return out


def _shares(values: Floats, per_one: float = SHARE) -> Floats:
    """Rounded to a share of each."""
    mantissas, exponents = np.frexp(values)
    out: Floats = np.ldexp(np.rint(mantissas * per_one) / per_one, exponents)
    return out


def _rotations(rotations: Floats) -> Floats:
    """Rounded, and rotations again: two of Newton's steps to the nearest one. Zeros stay zeros."""
    near = _steps(rotations, TURN)
    for _ in range(2):
        near = near @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(near, -1, -2) @ near)
    return near


def _covariances(covariances: Floats, per_one: float) -> Floats:
    """Rounded as their factors are, so that they stay positive; what has no factor is left as it is."""
    try:
        halves = _shares(np.asarray(np.linalg.cholesky(covariances), np.float64), per_one)
    except np.linalg.LinAlgError:
        return covariances
    return np.asarray(halves @ np.swapaxes(halves, -1, -2), np.float64)


def _courses(courses: Courses) -> Courses:
    known = np.flatnonzero(courses.seen_ns)
    if not len(known):
        return courses
    covariances = courses.covariances.copy()
    covariances[known] = _covariances(covariances[known], HALF)
    return Courses(
        courses.seen_ns,
        _rotations(courses.rotations),
        _steps(courses.ts, WAY),
        _steps(courses.rates, PACE),
        covariances,
        _steps(courses.weights, LIKELY),
    )


def _place(place: Place) -> Place:
    T = place.T_world_camera
    orientation = _steps(T.orientation, PLACE)
    pose = Pose(_steps(T.position, PLACE), orientation / np.linalg.norm(orientation))
    noise = _covariances(place.noise, SHARE)
    stays = _covariances(place.covariance - place.noise, SHARE)
    return Place(pose, noise + stays, noise, place.at_ns, place.seen_ns, place.kick)
