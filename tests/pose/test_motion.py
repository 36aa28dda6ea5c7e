"""Motion told from successive poses: rates and their covariances are meant, whatever the pose was found with."""

import numpy as np

from asterism.protocol.geometry import exp_rotation, log_rotation
from asterism.server.pose.courses import Courses
from asterism.server.pose.motion import Rates, Seen, begin, expect, follow_course, turned
from tests.helpers import random_rotation

STEP_NS = 16_666_667
NOISE = np.diag([2e-5] * 2 + [2e-4] + [2e-3] * 3)
ONE = np.array([0])


def seen_at(rng: np.random.Generator, rotation: np.ndarray, t: np.ndarray, rates: np.ndarray, skew: float) -> Seen:
    """A robot's pose with noise, found with rates that are off."""
    used = rates + rng.normal(size=6) * [0.1, 0.1, 0.1, 0.5, 0.5, 0.5]
    off = skew * (rates - used) + NOISE @ rng.normal(size=6)
    noise = (NOISE @ NOISE)[None]
    return Seen(
        (exp_rotation(off[3:]) @ rotation)[None], (t + off[:3])[None], noise, used[None], skew * np.eye(6)[None]
    )


def follow(rng: np.random.Generator, frames: int, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Error (12,) of pose and rates after so many frames of steady motion, and the covariance told."""
    courses, start, t0 = Courses.none(1), random_rotation(rng), np.array([0.1, 0.2, 1.2])
    for k in range(frames):
        now, time = 1 + k * STEP_NS, k * STEP_NS * 1e-9
        rotation, t = exp_rotation(rates[3:] * time) @ start, t0 + rates[:3] * time
        moving = follow_course(expect(courses, ONE, now), seen_at(rng, rotation, t, rates, 0.01))
        courses.write(ONE, now, moving[:5])
    turn = log_rotation(rotation @ courses.rotations[0].T)
    return np.concatenate([t - courses.ts[0], turn, rates - courses.rates[0]]), courses.covariances[0]


def test_rates_and_pose_are_known_as_well_as_the_covariance_says(rng: np.random.Generator) -> None:
    nees = []
    for _ in range(60):
        error, covariance = follow(rng, 6, rng.normal(size=6) * [0.2, 0.2, 0.1, 0.5, 0.5, 1.0])
        nees.append(error @ np.linalg.solve(covariance, error))
    assert 7.0 < np.mean(nees) < 17.0  # twelve numbers


def test_rates_become_known_with_the_frames(rng: np.random.Generator) -> None:
    rates = np.array([0.3, -0.2, 0.1, 0.2, -0.4, 2.0])
    few, many = (np.array([np.abs(follow(rng, n, rates)[0][6:]) for _ in range(10)]).mean() for n in (2, 8))
    assert many < 0.4 * few


def test_a_robot_seen_first_owns_up_to_what_any_speed_does_to_its_pose(rng: np.random.Generator) -> None:
    seen = seen_at(rng, np.eye(3), np.array([0.0, 0.0, 1.0]), np.zeros(6), 0.012)
    sigma = np.sqrt(np.diag(begin(seen, Rates.unknown(1)).covariances[0]))
    assert np.allclose(sigma[:3], 0.012 * 0.5, rtol=0.01)
    assert np.allclose(sigma[3:6], 0.012 * 3.0, rtol=0.01)


def test_a_jump_begins_anew(rng: np.random.Generator) -> None:
    courses = Courses.none(1)
    for k in range(4):
        moving = follow_course(
            expect(courses, ONE, 1 + k * STEP_NS), seen_at(rng, np.eye(3), np.array([0.0, 0.0, 1.0]), np.zeros(6), 0.0)
        )
        courses.write(ONE, 1 + k * STEP_NS, moving[:5])
    away = seen_at(rng, np.eye(3), np.array([0.1, 0.0, 1.0]), np.zeros(6), 0.0)
    moving = follow_course(expect(courses, ONE, 1 + 4 * STEP_NS), away)
    assert np.allclose(moving.ts, away.ts)
    assert moving.covariances[0, 6, 6] == 0.25


def test_what_was_not_seen_for_long_is_not_foreseen() -> None:
    courses = Courses.none(2)
    assert not expect(courses, np.array([0, 1]), 5).known.any()
    courses.seen_ns[0] = 1
    assert expect(courses, np.array([0, 1]), 2_000_000_000).known.tolist() == [False, False]
    assert expect(courses, np.array([0, 1]), 500_000_000).known.tolist() == [True, False]


def test_turned_is_the_exponential(rng: np.random.Generator) -> None:
    vectors = rng.normal(size=(2, 3, 3))
    assert np.allclose(turned(vectors)[1, 2], exp_rotation(vectors[1, 2]))
