"""The global assignment: the best set of hypotheses, margins, chance."""

import math

import numpy as np

from asterism.server.identity import assign
from asterism.server.identity.evidence import score


def hypothesis(robot: int, spots: tuple[int, ...], score: float, height: float = 100.0) -> assign.Hypothesis:
    return assign.Hypothesis(robot, spots, height, score, np.eye(3), np.zeros(3))


def test_the_best_set_is_claimed_not_the_best_hypothesis() -> None:
    # One strong explanation takes spots that two others need; together they explain more.
    chosen, doubts = assign.assign(
        [
            hypothesis(0, (0, 1, 2, 3, 4, 5), 30.0),
            hypothesis(1, (0, 1, 6, 7, 8, 9), 25.0),
            hypothesis(2, (4, 5, 10, 11, 12, 13), 25.0),
        ]
    )
    assert sorted(h.robot for h in chosen) == [1, 2]
    assert doubts == {}


def test_a_small_margin_is_a_doubt_about_everybody_concerned() -> None:
    chosen, doubts = assign.assign([hypothesis(0, (0, 1, 2, 3, 4, 5), 30.0), hypothesis(1, (5, 4, 3, 2, 1, 0), 28.0)])
    assert chosen == []
    assert doubts == {0: "its spots may be another robot's", 1: "its spots may be another robot's"}


def test_versions_of_one_explanation_are_no_rivals() -> None:
    chosen, doubts = assign.assign([hypothesis(0, (0, 1, 2, 3, 4, 5), 30.0), hypothesis(0, (0, 1, 2, 3, 4, -1), 28.0)])
    assert [h.spots for h in chosen] == [(0, 1, 2, 3, 4, 5)]
    assert doubts == {}


def test_what_may_be_chance_is_not_claimed() -> None:
    chosen, doubts = assign.assign([hypothesis(0, (0, 1, 2, 3, 4, -1), 11.0)])
    assert chosen == []
    assert doubts == {0: "its spots may be chance"}
    assert assign.assign([hypothesis(0, (0, 1, 2, 3, 4, -1), -1.0)]) == ([], {})


def test_the_score_falls_with_chance() -> None:
    def value(seen: int = 5, sigma: float = 0.05, around: int = 8, robots: int = 5, chi2: float = 4.0) -> float:
        spots = np.where(np.arange(6) < seen, np.arange(6), -1)
        return float(
            score(
                chi2, np.full(6, sigma**2), np.full(6, 100.0), np.full(6, 2.5), spots, around, math.pi * 80**2, robots
            )
        )

    assert value(6) > value(5) > value(4)
    assert value(sigma=0.02) > value(sigma=0.2)
    assert value(around=6) > value(around=20)
    assert value(robots=1) > value(robots=50)
    assert value(chi2=2.0) > value(chi2=15.0)
    # Twice the density of spots at five LEDs costs two factors of two, and the tries.
    assert assign.BEYOND_CHANCE > 9.0
