"""Robots as wide as half their distance, tilted, anywhere in the image of a wide lens; and LEDs of any size."""

import numpy as np
import pytest

from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.identity.identify import identify
from asterism.server.identity.plan import Plan
from asterism.server.simulation.simulate import Scene, Truth
from tests.identity.near_poses import near_poses, near_rig, plan_of, spots_at
from tests.identity.test_identification import check

OFF_AXIS = {"wide": 0.0, "fisheye": 50.0}


def found(
    plan: Plan, rng: np.random.Generator, away_m: float, tilt_deg: tuple[float, float], off_axis_deg: float,
    trials: int, hidden: int = 0,
) -> int:  # fmt: skip
    """How many robots of as many are found, one in each frame with some clutter; none may be wrong."""
    right = 0
    for _, one in zip(range(trials), near_poses(plan, rng, away_m, tilt_deg, off_axis_deg), strict=False):
        seen, where = spots_at(plan, rng, [one], hidden, clutter=4)
        good, wrong = check(identify(seen, plan, Tracks.none(len(plan.layouts)), 0), where)
        assert wrong == 0
        right += good
    return right


@pytest.mark.parametrize("range_m", [(0.2, 0.6), None])
@pytest.mark.parametrize("lens", OFF_AXIS)
def test_robots_as_wide_as_half_their_distance_are_found(
    rng: np.random.Generator, lens: str, range_m: tuple[float, float] | None
) -> None:
    plan = plan_of(6, lens, range_m)
    for away_m in (0.22, 0.26, 0.35):
        for tilt_deg in ((0.0, 60.0), (60.0, 70.0)):
            assert found(plan, rng, away_m, tilt_deg, OFF_AXIS[lens], 40) >= 39
            assert found(plan, rng, away_m, tilt_deg, OFF_AXIS[lens], 20, hidden=1) >= 19


@pytest.mark.parametrize("told", [0.25, 4.0])
def test_a_wrong_size_of_leds_costs_no_robot(rng: np.random.Generator, told: float) -> None:
    """In a rig whose `led.radius` is wrong: robots side by side, with six LEDs and with five."""
    plans = [plan_of(6, "wide", told=1.0), plan_of(6, "wide", told=told)]
    counts = np.zeros(2, np.int64)
    for _ in range(25):
        seen = []
        for one in near_poses(plans[0], rng, rng.uniform(0.4, 0.6), (0.0, 45.0)):
            if all(one[0] != other[0] and abs(one[2] - other[2].mean(axis=0)).min() > 0 for other in seen) and all(
                np.hypot(*(one[2].mean(axis=0) - other[2].mean(axis=0))) > 200 for other in seen
            ):
                seen.append(one)
            if len(seen) == 3:
                break
        spots, where = spots_at(plans[0], rng, seen, int(rng.integers(2)), clutter=3)
        for k, plan in enumerate(plans):
            right, wrong = check(identify(spots, plan, Tracks.none(6), 0), where)
            assert wrong == 0
            counts[k] += right
    assert counts[1] >= counts[0] - 1


@pytest.mark.parametrize("told", [0.25, 1.0, 4.0])
def test_whole_frames_of_a_wide_lens(rng: np.random.Generator, told: float) -> None:
    true, rig = near_rig(6, "wide"), near_rig(6, "wide", told=told)
    plan, scene = plan_of(6, "wide"), Scene(true, seed=1)
    poses = near_poses(plan, rng, 0.3, (0.0, 60.0))
    for number in range(6):
        robot, pose, _ = next(poses)
        there = pose @ true.robots[robot].T_robot_plane.inverse()
        truth = [Truth(one.id, there, (k == robot,) * 6) for k, one in enumerate(true.robots)]
        result, _ = localize(Frame(scene.render(number, truth), exposed_ns=1, index=number), rig, Tracks.none())
        answers = {name: answer for name, answer in result.answers.items() if isinstance(answer, PoseEstimate)}
        assert set(answers) == {true.robots[robot].id}
        answer = answers[true.robots[robot].id]
        other = answer.alternative.position if answer.alternative else answer.position
        assert min(np.linalg.norm(told - there.position) for told in (answer.position, other)) < 0.002
