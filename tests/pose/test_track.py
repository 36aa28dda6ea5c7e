"""What is remembered: predictions, their uncertainty, the evidence for a tilt."""

import math

import numpy as np
import pytest

from asterism.protocol.geometry import angle_between, exp_rotation
from asterism.server.pose.choose import OPEN, axis_cost, remembered
from asterism.server.pose.track import (
    BLOCK_NS,
    EVIDENCE,
    HAS_OTHER,
    LEAST_SIGHTINGS,
    MOST_EVIDENCE,
    TURN_SIGMA,
    UNKNOWN_SPEED,
    VELOCITY_SIGMA,
    LastSeen,
    Tracks,
    follow_track,
    predict,
    predict_room,
    tilt_cost,
)
from tests.helpers import random_rotation

STEP_NS = 16_666_667
COVARIANCE = np.diag([1e-8] * 3 + [1e-6] * 3)


def follow(
    tracks: Tracks, now_ns: int, rotation: np.ndarray, t: np.ndarray, evidence: float = 3.0, misfit: float = 0.0
) -> None:
    follow_track(tracks, 0, now_ns, LastSeen(rotation, t, COVARIANCE, 170.0, np.eye(3), True, evidence, misfit, 1.0))


def predicted(tracks: Tracks, now_ns: int) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    told = predict_room(len(tracks.seen_ns))
    return predict(tracks, now_ns, told), told.rotations[0], told.ts[0], told.sigmas[0]


def test_steady_motion_is_predicted_exactly(rng: np.random.Generator) -> None:
    tracks, start = Tracks.none(1), random_rotation(rng)
    velocity, turn = np.array([0.1, -0.05, 0.02]), np.array([0.2, 0.1, -0.3])
    for k in range(12):
        dt = k * STEP_NS * 1e-9
        follow(tracks, 1 + k * STEP_NS, exp_rotation(turn * dt) @ start, np.array([0.0, 0.0, 1.2]) + velocity * dt)
    count, rotation, t, sigmas = predicted(tracks, 1 + 12 * STEP_NS)
    dt = 12 * STEP_NS * 1e-9
    assert count == 1
    np.testing.assert_allclose(t, np.array([0.0, 0.0, 1.2]) + velocity * dt, atol=1e-6)
    assert angle_between(rotation, exp_rotation(turn * dt) @ start) < 1e-6
    assert sigmas[0] < 0.005


def test_a_robot_seen_once_may_move_at_any_speed_and_certainty_grows() -> None:
    tracks = Tracks.none(1)
    follow(tracks, 1, np.eye(3), np.array([0.0, 0.0, 1.0]))
    assert tracks.numbers[0, VELOCITY_SIGMA] == UNKNOWN_SPEED
    first = predicted(tracks, 1 + STEP_NS)[3]
    for k in range(1, 5):
        follow(tracks, 1 + k * STEP_NS, np.eye(3), np.array([0.0, 0.0, 1.0]))
    later = predicted(tracks, 1 + 5 * STEP_NS)[3]
    assert later[0] < first[0]
    # And falls with the time that has passed.
    assert predicted(tracks, 1 + 25 * STEP_NS)[3][0] > later[0]


def test_tracks_are_forgotten_and_time_does_not_run_backwards() -> None:
    tracks = Tracks.none(1)
    follow(tracks, 5_000_000_000, np.eye(3), np.array([0.0, 0.0, 1.0]))
    assert predicted(tracks, 5_900_000_000)[0] == 1
    assert predicted(tracks, 6_100_000_000)[0] == 0
    assert predicted(tracks, 5_000_000_000)[0] == 0
    assert predicted(tracks, 4_000_000_000)[0] == 0
    assert predicted(Tracks.none(1), 5_000_000_000)[0] == 0


def test_a_copy_leaves_the_original_alone_and_another_rigs_tracks_are_none() -> None:
    tracks = Tracks.none(2)
    copied = tracks.copy_for(2)
    follow(copied, 7, np.eye(3), np.zeros(3))
    assert tracks.seen_ns.tolist() == [0, 0]
    assert copied.copy_for(3).seen_ns.tolist() == [0, 0, 0]


def test_the_remembered_tilt_costs_nothing_the_other_what_speaks_against_it() -> None:
    here, there = np.eye(3), exp_rotation(np.array([math.radians(30), 0, 0]))
    tracks = Tracks.none(1)
    tracks.seen_ns[0], tracks.rotations[0], tracks.other_rotations[0] = 1, here, there
    tracks.numbers[0, [TURN_SIGMA, HAS_OTHER, EVIDENCE]] = 0.1, 1.0, 3.0

    def cost(rotation: np.ndarray) -> float:
        return float(tilt_cost(tracks, 0, 1 + STEP_NS, rotation))

    assert cost(here) == pytest.approx(0.0, abs=1e-9)
    assert cost(there) == pytest.approx(2 * 0.95 * 3.0, rel=1e-6)
    assert cost(exp_rotation(np.array([math.radians(15), 0, 0]))) > 5.0
    # However much speaks against it, new evidence can turn it.
    assert cost(exp_rotation(np.array([0, math.radians(90), 0]))) == pytest.approx(2 * MOST_EVIDENCE)


def test_evidence_is_bounded() -> None:
    tracks = Tracks.none(1)
    follow(tracks, 1, np.eye(3), np.array([0.0, 0.0, 1.0]), evidence=500.0)
    assert tracks.numbers[0, EVIDENCE] == MOST_EVIDENCE
    assert tracks.numbers[0, HAS_OTHER] == 1.0


def test_a_normal_inside_its_cone_costs_nothing() -> None:
    up, within = np.array([0.0, 0.0, 1.0]), math.radians(40)
    for degrees, cost in ((0, 0.0), (39, 0.0), (42, 1.0), (44, 4.0)):
        angle = math.radians(degrees)
        assert axis_cost(np.array([math.sin(angle), 0.0, math.cos(angle)]), up, within) == pytest.approx(cost, abs=1e-6)


def test_what_is_learned_changes_where_a_block_ends_and_is_what_that_block_told() -> None:
    tracks, others = Tracks.none(1), Tracks.knowing(np.array([7e-3]))
    place = np.array([0.0, 0.0, 1.0])
    for block, misfit in enumerate([1e-3, 4e-4]):
        for k in range(60):
            now = (10 + block) * BLOCK_NS + k * STEP_NS
            told = [memory.learned_at(now)[0] for memory in (tracks, others)]
            assert told == ([0.0, 7e-3] if block == 0 else [pytest.approx(1e-3, rel=0.07)] * 2)
            for memory in (tracks, others):
                follow(memory, now, np.eye(3), place, misfit=misfit if k else 40.0 * misfit)
    for memory in (tracks, others):
        # One odd frame hardly counts.
        assert memory.learned_at(12 * BLOCK_NS)[0] == pytest.approx(4e-4, rel=0.07)


def test_a_block_with_few_sightings_goes_on() -> None:
    tracks = Tracks.none(1)
    for k in range(2 * LEAST_SIGHTINGS):
        now = 5 * BLOCK_NS + k * BLOCK_NS // 4
        full = -(-LEAST_SIGHTINGS // 4) * 4  # of the sightings, four in a block, so many end one
        assert (tracks.learned_at(now)[0] > 0.0) == (k >= full)
        follow(tracks, now, np.eye(3), np.array([0.0, 0.0, 1.0]), misfit=1e-3)


def test_evidence_of_frames_adds_up_as_far_as_their_errors_are_new() -> None:
    assert remembered(6.0, 3.0, 1.0) == 6.0
    assert remembered(6.0, 3.0, 0.0) == 3.0  # 6 in all: what the one that told most has told
    assert remembered(2.0, 3.0, 0.0) == 0.0
    assert remembered(6.0, 3.0, 0.5) == pytest.approx(4.5)
    assert remembered(6.0, -3.0, 0.0) == 6.0  # what speaks against it counts in full
    assert remembered(30.0, 0.0, 0.0) == OPEN
