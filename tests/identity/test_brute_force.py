"""The fast identification against trying everything: the same robots where that leaves no doubt, never another."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.rig import Rig
from asterism.server.identity.plan import plan_for
from tests.identity.brute_force import clear, explanations
from tests.identity.test_identification import apart, cold, spots_of
from tests.rigs import make_rig

TRIALS = 2
RIG = make_rig(3, seed=12)


def lookalikes() -> Rig:
    """Robots 0 and 1 differ by their sixth LED alone."""
    first, second, third = RIG.robots
    leds = first.leds.copy()
    leds[5] += [0.014, -0.009, 0.0]
    return replace(RIG, robots=(first, replace(second, leds=leds), third))


# Robots of the rig in view, LEDs hidden of each (which: -1 any), robots of another rig in view, clutter.
CASES = {
    "one robot in clutter": (RIG, [0], [], 0, 8),
    "one robot that lacks an LED, in clutter": (RIG, [1], [-1], 0, 8),
    "two robots": (RIG, [1, 2], [], 0, 2),
    "two robots that lack an LED": (RIG, [0, 2], [-1], 0, 3),
    "a robot beside a stranger": (RIG, [2], [-1], 1, 2),
    "clutter alone": (RIG, [], [], 0, 14),
    "a robot that differs from another by one LED": (lookalikes(), [0], [], 0, 6),
    "a robot that lacks what tells it from another": (lookalikes(), [0], [5], 0, 6),
}


@pytest.mark.parametrize("case", CASES)
def test_identification_is_what_trying_everything_says(rng: np.random.Generator, case: str) -> None:
    rig, robots, hide, strangers, clutter = CASES[case]
    both = replace(rig, robots=(*rig.robots, *make_rig(strangers, seed=77).robots)) if strangers else rig
    plan = plan_for(rig)
    for _ in range(TRIALS):
        places = iter(apart(rng, 3))
        poses = {robot: next(places) for robot in [*robots, *range(3, 3 + strangers)]}
        hidden = {robot: [led if led >= 0 else int(rng.integers(6)) for led in hide] for robot in robots}
        seen, where = spots_of(plan_for(both), poses, rng, hidden, clutter)
        assert len(seen.rows) <= 14
        candidates = explanations(plan.layouts, plan.focal * seen.rays, plan.focal, plan.near, plan.far)
        matches = cold(seen, rig)
        found = {
            int(k): tuple(spots.tolist())
            for k, spots in zip(matches.found.robots, matches.found.assignment, strict=True)
        }
        certain = clear(candidates)
        assert {robot: spots for robot, spots in found.items() if robot in certain} == certain
        possible = {(candidate.robot, candidate.spots) for candidate in candidates}
        assert set(found.items()) <= possible
        # The reference itself finds everybody who can be told apart.
        doubtful = case == "a robot that lacks what tells it from another"
        assert sorted(certain) == ([] if doubtful else robots)
        assert all(certain[robot] == tuple(where[robot].tolist()) for robot in certain)
        if doubtful:
            assert {0, 1} <= {candidate.robot for candidate in candidates}
            assert found == {}
            assert set(matches.doubts) == {0, 1}
