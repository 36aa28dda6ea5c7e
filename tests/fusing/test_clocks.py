"""Clocks of two cameras, from the ways of robots that both see."""

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose
from asterism.server.fusing.clocks import ClockFit, Way, clock_between
from tests.several import Drive, facing_pair

RATE_HZ, FRAMES = 30.0, 240
SPREAD = np.diag([2e-5**2, 2e-5**2, 1e-3**2])  # of a position in a camera's frame: sure across, not along
PLACES = facing_pair()


def way(camera: int, robot: str, true_s: Floats, told_s: Floats, rng: np.random.Generator, moves: bool = True) -> Way:
    """A robot's way by a camera whose clock tells ``told_s``."""
    drive, back = Drive(("a", "b")), PLACES[camera].inverse()
    places = np.array([back.map(drive(at if moves else 0.0)[robot].position) for at in true_s])
    noise = rng.normal(size=places.shape) * np.sqrt(np.diag(SPREAD))
    return Way(told_s, places + noise, np.tile(SPREAD, (len(true_s), 1, 1)))


def fitted(offset_s: float, drift: float, rng: np.random.Generator, moves: bool = True) -> ClockFit:
    """Of two robots; the cameras expose at unlike times."""
    first = np.arange(FRAMES) / RATE_HZ
    second = first + 0.011
    told = second + offset_s + drift * second
    ways = [(way(0, robot, first, first, rng, moves), way(1, robot, second, told, rng, moves)) for robot in "ab"]
    fit = clock_between(ways, abs(offset_s) + 0.1)
    assert fit is not None
    return fit


@pytest.mark.parametrize(("offset_s", "drift"), [(0.0, 0.0), (0.0123, 2e-5), (-2.4, 0.0)])
def test_offset_and_drift_are_found_as_well_as_told(offset_s: float, drift: float, rng: np.random.Generator) -> None:
    fit = fitted(offset_s, drift, rng)
    assert fit.offset_sigma_s < 2e-4
    true = offset_s + drift * (fit.at_s - offset_s)
    assert abs(fit.offset_s - true) < 4 * fit.offset_sigma_s
    assert abs(fit.drift - drift) < 4 * fit.drift_sigma
    # Where the second camera stands comes with it.
    T = PLACES[0].inverse() @ PLACES[1]
    assert np.linalg.norm(fit.T_first_second.position - T.position) < 3e-3
    assert fit.rms_m < 3e-3


def test_the_standard_deviation_is_meant() -> None:
    off = []
    for seed in range(16):
        fit = fitted(0.004, 0.0, np.random.default_rng(seed))
        off.append((fit.offset_s - 0.004) / fit.offset_sigma_s)
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.5


def test_the_other_way_round_it_is_the_opposite(rng: np.random.Generator) -> None:
    times = np.arange(FRAMES) / RATE_HZ
    one, other = way(0, "a", times, times, rng), way(1, "a", times, times + 0.2, rng)
    there, back = clock_between([(one, other)], 1.0), clock_between([(other, one)], 1.0)
    assert there is not None
    assert back is not None
    assert abs(there.offset_s + back.offset_s) < 3 * there.offset_sigma_s


def test_robots_that_stand_still_tell_nothing(rng: np.random.Generator) -> None:
    fit = fitted(0.5, 0.0, rng, moves=False)
    assert fit.offset_s == 0.0
    assert fit.offset_sigma_s > 1.0


def test_an_even_pace_along_a_line_cannot_be_told_from_another_place(rng: np.random.Generator) -> None:
    times = np.arange(FRAMES) / RATE_HZ
    line = np.array([0.1, 0.02, 0.0]) * times[:, None] + [0.0, 0.0, 1.3]
    spread = np.tile(1e-5**2 * np.eye(3), (FRAMES, 1, 1))
    noisy = [line + 1e-5 * rng.normal(size=line.shape) for _ in range(2)]
    fit = clock_between([(Way(times, noisy[0], spread), Way(times + 0.05, noisy[1], spread))])
    assert fit is not None
    assert fit.offset_sigma_s > 0.05


def test_ways_that_never_meet_in_time_tell_nothing(rng: np.random.Generator) -> None:
    times = np.arange(FRAMES) / RATE_HZ
    one, other = way(0, "a", times, times, rng), way(1, "a", times, times + 100.0, rng)
    assert clock_between([(one, other)], 5.0) is None
    assert clock_between([]) is None


def test_the_cameras_frames_do_not_matter(rng: np.random.Generator) -> None:
    times = np.arange(FRAMES) / RATE_HZ
    one, other = way(0, "a", times, times, rng), way(1, "a", times, times + 0.05, rng)
    T = Pose.from_matrix(PLACES[0].rotation, np.array([3.0, -1.0, 0.5]))
    turned = Way(other.times_s, T.map(other.places), T.rotation @ other.covariances @ T.rotation.T)
    here, there = clock_between([(one, other)], 1.0), clock_between([(one, turned)], 1.0)
    assert here is not None
    assert there is not None
    assert abs(here.offset_s - there.offset_s) < 1e-7
