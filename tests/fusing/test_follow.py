"""Cameras that do not expose together: rays are brought to one exposure by how robots move."""

import numpy as np

from asterism.server.fusing.fused import FusedPose
from tests.fusing.films import PERIOD_NS, START_NS, Film, error_of
from tests.several import facing_pair

HALF = {"right": PERIOD_NS // 2}


def test_half_a_frame_apart_two_cameras_are_as_good_as_together(rng: np.random.Generator) -> None:
    depths, nees = [], []
    for line, (fused, true, _) in enumerate(Film(facing_pair(), late_ns=HALF).lines(40, rng)):
        if line < 30:
            continue
        for robot, answer in fused.answers.items():
            assert isinstance(answer, FusedPose)
            assert answer.cameras == ("left", "right")
            error, weighted = error_of(answer, true[robot])
            depths.append(error[2])
            nees.append(weighted)
    assert np.sqrt(np.mean(np.square(depths))) < 0.03e-3
    assert 4.0 < np.mean(nees) < 8.0


def test_before_velocities_are_known_the_covariance_says_so(rng: np.random.Generator) -> None:
    lines = list(Film(facing_pair(), late_ns=HALF).lines(2, rng))
    fused, true, _ = lines[1]
    for robot, answer in fused.answers.items():
        assert isinstance(answer, FusedPose)
        assert error_of(answer, true[robot])[1] < 40.0
        assert np.sqrt(answer.covariance[2, 2]) > 0.05e-3  # one camera's own depth, hardly better


def test_a_camera_that_was_lost_counts_no_more(rng: np.random.Generator) -> None:
    film = Film(facing_pair(), shown={"right": range(5)})
    cameras = [fused.answers["r00"].cameras for fused, _, _ in film.lines(9, rng)]  # type: ignore[union-attr]
    assert cameras[:5] == [("left", "right")] * 5
    # Its newest frame counts for one frame period, not for two.
    assert cameras[5] == ("left", "right")
    assert cameras[6:] == [("left",)] * 3


def test_joining_and_leaving_no_pose_jumps_beyond_what_it_says(rng: np.random.Generator) -> None:
    film = Film(facing_pair(), shown={"right": range(6, 14)})
    for fused, true, _ in film.lines(20, rng):
        for robot in true:
            answer = fused.answers[robot]
            assert isinstance(answer, FusedPose)
            if len(answer.cameras) > 1:  # alone, the pose is the camera's own, which is drawn anyhow
                assert error_of(answer, true[robot])[1] < 40.0


def test_of_frames_in_another_order_of_time_nothing_is_known(rng: np.random.Generator) -> None:
    *_, (fused, _, joint) = Film(facing_pair()).lines(5, rng)
    assert fused.exposed_ns == START_NS + 4 * PERIOD_NS
    assert [at_ns for at_ns, _ in joint.history] == sorted(at_ns for at_ns, _ in joint.history)
    assert len(joint.history) < 5
