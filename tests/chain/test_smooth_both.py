"""Smoothing forwards and backwards: nearer the truth than forwards, as sure as it says, streamed, over no gap."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.rig import load_rig
from asterism.server import PoseEstimate
from asterism.server.chain import smooth_both
from asterism.server.chain.smooth import SmoothedPose
from asterism.server.chain.smooth_both import BLOCK_S, BOTH, LAG_S, Look, joined
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.chain.drives import Drives, covariances_of, drawn, drives
from tests.chain.judging_motion import both_ways, forwards, seen_of, weighted
from tests.chain.test_smooth import demo_film  # noqa: F401 (a fixture)

NONE, LEDS = np.zeros((1, 6, 6)), [(0, 1, 2, 3, 4, 5)]
RIG = load_rig(DEMO_RIG)


def looks_of(told: Drives, rng: np.random.Generator, robot: int = 0) -> list[Look]:
    """What is seen of one robot of the drives."""
    covariances = covariances_of(told.positions, told.rotations, 0.02)
    positions, rotations = drawn(rng, told.positions, told.rotations, covariances)
    one = slice(robot, robot + 1)
    return [
        Look(1 + round(k * told.dt * 1e9), ("r",), seen_of(p[one], R[one], C[one], NONE, LEDS))
        for k, (p, R, C) in enumerate(zip(positions, rotations, covariances, strict=True))
    ]


def test_both_ways_are_nearer_the_truth_than_forwards_and_as_sure_as_they_say(rng: np.random.Generator) -> None:
    told = drives(rng, 5, 4.0, 30.0)
    covariances = covariances_of(told.positions, told.rotations, 0.05)
    seen = drawn(rng, told.positions, told.rotations, covariances)
    before, both = forwards(told, *seen, covariances), both_ways(told, *seen, covariances)
    for alone, joint in ((before.poses, both.poses), (before.twists, both.twists)):
        ratios = np.median(np.abs(joint[15:]), axis=(0, 1)) / np.median(np.abs(alone[15:]), axis=(0, 1))
        assert ratios.max() < 1.0, ratios
        assert np.mean(ratios) < 0.85, ratios
    assert 4.0 < np.mean(weighted(both.poses, both.pose_covariances)) < 7.5
    assert (np.linalg.eigvalsh(both.pose_covariances) > 0.0).all()
    assert (np.linalg.eigvalsh(both.twist_covariances) > 0.0).all()


def test_frames_come_in_order_after_some_seconds_and_what_comes_later_changes_nothing_that_counts(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = looks_of(drives(rng, 1, 9.0, 30.0), rng)
    pulled = 0

    def counted() -> Iterator[Look]:
        nonlocal pulled
        for look in looks:
            pulled += 1
            yield look

    streamed = []
    for answers in joined(counted()):
        streamed.append(answers["r"])
        assert pulled - len(streamed) <= (LAG_S + BLOCK_S) * 30 + 1
    assert len(streamed) == len(looks)
    monkeypatch.setattr(smooth_both, "LAG_S", 100.0)
    for (pose, covariance, _), answers in zip(streamed, joined(looks), strict=True):
        whole, _, _ = answers["r"]
        away = (pose.position - whole.position) / np.sqrt(np.diag(covariance)[:3])
        assert np.abs(away).max() < 0.3


def test_nothing_is_carried_over_a_gap_a_jump_or_a_clock_that_was_set(rng: np.random.Generator) -> None:
    looks = looks_of(drives(rng, 1, 1.0, 30.0), rng)
    first, second = looks[:15], looks[15:]
    assert second[0].seen is not None
    alone = [answers["r"] for part in (first, second) for answers in joined(part)]
    empty = [Look(look.exposed_ns, (), None) for look in second]
    for later_s in (1.5, -20.0):
        moved = [look._replace(exposed_ns=look.exposed_ns + round(later_s * 1e9)) for look in second]
        found = [answers["r"] for answers in joined([*first, *moved])]
        for (pose, _, _), (expected, _, _) in zip(found, alone, strict=True):
            np.testing.assert_allclose(pose.position, expected.position, atol=1e-12)
    assert [len(answers) for answers in joined([*first, *empty])] == [1] * 15 + [0] * 15
    far = [
        look._replace(
            seen=look.seen._replace(sight=look.seen.sight._replace(positions=look.seen.sight.positions + 0.1))
        )
        for look in second
        if look.seen is not None
    ]
    found = [answers["r"] for answers in joined([*first, *far])]
    for (pose, _, _), (expected, _, _) in zip(found[:15], alone[:15], strict=True):
        np.testing.assert_allclose(pose.position, expected.position, atol=1e-12)


def test_results_keep_what_else_they_say(  # type: ignore[no-untyped-def]
    demo_film,  # noqa: F811
) -> None:
    told = list(smooth_both.smooth_both([(frame.index, result) for frame, result in demo_film], RIG))
    assert [index for index, _ in told] == [frame.index for frame, _ in demo_film]
    for (_, after), (_, before) in zip(told, demo_film, strict=True):
        for robot, answer in before.answers.items():
            smoothed = after.answers[robot]
            if not isinstance(answer, PoseEstimate):
                assert smoothed is answer
                continue
            assert isinstance(smoothed, SmoothedPose)
            assert (smoothed.smoothed_by, smoothed.leds, smoothed.rms_px) == (BOTH, answer.leds, answer.rms_px)
            assert smoothed.velocity is not None
        assert replace(after, answers={}).index == before.index
