"""Cameras that contradict each other, spots that are odd, LEDs that are off."""

import math

import numpy as np

from asterism.protocol.geometry import Pose
from asterism.server.fusing.fused import FusedPose
from tests.fusing.films import Film, error_of
from tests.several import facing_pair, looking_at

OFF = np.array([1e-3] * 3 + [math.radians(0.1)] * 3) / math.sqrt(3.0)
LITTLE = 0.03 * OFF  # 0.03 mm and 0.003 degrees: less than the noise of one frame lets see


def three() -> list[Pose]:
    """Three cameras about one floor."""
    return [*facing_pair(), looking_at(1.3 * np.array([0.05, 0.37, 0.93]), np.zeros(3), 0.1)]


def test_one_of_three_that_was_moved_is_left_out_and_named(rng: np.random.Generator) -> None:
    depths = []
    for line, (fused, true, joint) in enumerate(Film(three(), moved={"third": OFF}).lines(45, rng)):
        for robot, answer in fused.answers.items():
            assert isinstance(answer, FusedPose)
            assert answer.cameras == ("left", "right")
            assert list(answer.left_out) == ["third"]
            assert "run asterism calibrate cameras" in answer.left_out["third"]
            depths.append(error_of(answer, true[robot])[0][2])
        if line == 44:
            found = joint.places.misplaced["third"]
            assert abs(found.off_m - 1e-3) < 1e-4
            assert abs(found.off_rad - math.radians(0.1)) < math.radians(0.01)
    assert np.sqrt(np.mean(np.square(depths))) < 0.03e-3


def test_what_one_frame_cannot_show_many_do(rng: np.random.Generator) -> None:
    *_, (fused, _, joint) = Film(three(), moved={"third": LITTLE}).lines(80, rng)
    assert list(joint.places.misplaced) == ["third"]
    answer = fused.answers["r00"]
    assert isinstance(answer, FusedPose)
    assert answer.cameras == ("left", "right")


def test_cameras_that_agree_are_all_used(rng: np.random.Generator) -> None:
    for fused, _, joint in Film(three()).lines(45, rng):
        assert not joint.places.misplaced
        for answer in fused.answers.values():
            assert isinstance(answer, FusedPose)
            assert answer.cameras == ("left", "right", "third")
            assert not answer.left_out


def test_of_two_that_contradict_each_other_the_covariance_says_by_how_much(rng: np.random.Generator) -> None:
    for fused, true, _ in Film(facing_pair(), moved={"right": 3.0 * OFF}).lines(3, rng):
        for robot, answer in fused.answers.items():
            assert isinstance(answer, FusedPose)
            assert len(answer.cameras) == len(answer.left_out) == 1
            assert error_of(answer, true[robot])[1] < 30.0


def test_of_two_the_covariance_is_honest_whichever_is_wrong(rng: np.random.Generator) -> None:
    nees = []
    for seed in range(6):
        for wrong in ("left", "right"):
            off = 3.0 * OFF * rng.choice([-1.0, 1.0], 6)
            film = Film(facing_pair(), moved={wrong: off}, seed=seed, own=True)
            for fused, true, _ in film.lines(1, rng):
                answers = [(robot, answer) for robot, answer in fused.answers.items() if len(answer.cameras) == 1]
                nees += [error_of(answer, true[robot])[1] for robot, answer in answers]
    assert len(nees) > 15
    assert max(nees) < 30.0
    assert np.mean(nees) < 8.0


def test_two_that_are_apart_by_less_than_a_frame_can_show_are_not_trusted_together(rng: np.random.Generator) -> None:
    nees = []
    for seed in range(3):
        film = Film(facing_pair(), moved={"right": 0.2 * OFF}, seed=seed, own=True)
        for line, (fused, true, joint) in enumerate(film.lines(40, rng)):
            if line < 15:
                continue
            assert joint.places.apart is not None
            for robot, answer in fused.answers.items():
                assert isinstance(answer, FusedPose)
                assert len(answer.cameras) == len(answer.left_out) == 1
                nees.append(error_of(answer, true[robot])[1])
    assert max(nees) < 40.0
    assert np.mean(nees) < 8.0


def test_two_that_agree_stay_joined(rng: np.random.Generator) -> None:
    for fused, _, joint in Film(facing_pair()).lines(60, rng):
        assert joint.places.apart is None
        assert all(isinstance(answer, FusedPose) and len(answer.cameras) == 2 for answer in fused.answers.values())


def test_leds_that_are_off_leave_no_camera_out_and_poses_honest(rng: np.random.Generator) -> None:
    nees = []
    for seed in range(12):
        errors = {robot: 0.4e-3 * rng.normal(size=(6, 3)) for robot in ("r00", "r01")}
        for fused, true, _ in Film(facing_pair(), led_errors=errors, seed=seed).lines(2, rng):
            for robot, answer in fused.answers.items():
                assert isinstance(answer, FusedPose)
                assert answer.cameras == ("left", "right")
                nees.append(error_of(answer, true[robot])[1])
    # 24 draws of LEDs: how far off they are is not known well, so that some poses are far out.
    assert 3.0 < np.median(nees) < 9.0
