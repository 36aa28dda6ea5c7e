"""Ages by a server's clock that is years off, drifts, and whose messages wait on their way: never too fresh."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from asterism.clients.age import SLACK_S, SessionAge

SECOND = 1_000_000_000
DAY_S = 86_400.0


@dataclass
class Clocks:
    """A server's clock against this machine's: ``ppm`` faster, ``rate`` times as fast, and anywhere at first."""

    here_ns: int
    there_ns: int
    ppm: float = 0.0
    rate: float = 1.0

    def here(self, time_s: float) -> int:
        return self.here_ns + round(time_s * 1e9)

    def there(self, time_s: float) -> int:
        return self.there_ns + round(time_s * 1e9 * self.rate * (1.0 + self.ppm * 1e-6))

    def ask(self, age: SessionAge, time_s: float, up_s: float, down_s: float) -> None:
        age.answered(self.here(time_s), self.here(time_s + up_s + down_s), self.there(time_s + up_s))

    def hear(self, age: SessionAge, time_s: float, late_s: float) -> None:
        age.heard(self.here(time_s + late_s), self.there(time_s))

    def error_s(self, age: SessionAge, time_s: float) -> float:
        """By how much something looks older than it is, s of the server's clock."""
        told = age.time_ns(self.here(time_s))
        assert told is not None
        return (told - self.there(time_s)) * 1e-9


@pytest.fixture(params=[(-100.0, 1.0), (100.0, 1.0), (0.0, 1.0), (100.0, 10.0), (-50.0, 0.25)])
def clocks(request: pytest.FixtureRequest, rng: np.random.Generator) -> Clocks:
    ppm, rate = request.param
    here_ns, there_ns = rng.integers(0, 10**18, 2).tolist()
    return Clocks(here_ns, there_ns, ppm, rate)


def days(clocks: Clocks, rng: np.random.Generator, age: SessionAge) -> Iterator[float]:
    """A question every ten seconds, and poses in between of which some waited; days later such again."""
    for start_s in (0.0, DAY_S, 5.0 * DAY_S):
        clocks.ask(age, start_s - 10.0, 0.001, 0.001)
        for time_s in start_s + np.arange(0.0, 5000.0, 10.0):
            clocks.ask(age, time_s, *rng.uniform(0.0002, 0.003, 2))
            clocks.hear(age, time_s + 1.0, 5.0 if rng.random() < 0.1 else 0.001)
            yield time_s + rng.uniform(6.0, 10.0)


def test_over_days_of_drift_ages_stay_right(clocks: Clocks, rng: np.random.Generator) -> None:
    age = SessionAge(clocks.rate)
    errors = np.array([clocks.error_s(age, time_s) for time_s in days(clocks, rng, age)]) / clocks.rate
    assert errors.min() > -SLACK_S
    assert errors.max() < 0.006  # a slow question, and ten seconds of drift


def test_first_messages_that_all_waited_do_not_look_fresh(clocks: Clocks) -> None:
    age = SessionAge(clocks.rate)
    for k in range(100):
        clocks.hear(age, 0.01 * k, 8.0 - 0.01 * k)  # all arrive at once, after 8 s
        assert age.time_ns(clocks.here(8.0)) is None
        assert age.age_s(clocks.here(8.0), clocks.there(0.01 * k)) == math.inf
    clocks.ask(age, 8.0, 0.001, 6.0)  # the answer waits behind them
    assert -SLACK_S * clocks.rate < clocks.error_s(age, 14.1) < 0.01 * clocks.rate


def test_what_waited_in_tcp_is_as_old_as_it_is(clocks: Clocks) -> None:
    age = SessionAge(clocks.rate)
    clocks.ask(age, 0.0, 0.001, 0.001)
    clocks.hear(age, 1.0, 0.0005)
    clocks.hear(age, 2.0, 5.0)
    told_s = age.age_s(clocks.here(7.0), clocks.there(2.0)) / clocks.rate
    assert told_s == pytest.approx(5.0, abs=0.01)


def test_a_slow_answer_makes_poses_look_older_at_worst(clocks: Clocks) -> None:
    age = SessionAge(clocks.rate)
    clocks.ask(age, 0.0, 0.4, 0.1)
    clocks.hear(age, 1.0, 0.0005)
    assert 0.0 < clocks.error_s(age, 1.1) < 0.41 * clocks.rate
    clocks.ask(age, 2.0, 0.001, 0.1)
    assert abs(clocks.error_s(age, 2.2)) < 0.006 * clocks.rate


def test_where_no_answer_comes_any_more_ages_only_grow(clocks: Clocks) -> None:
    age = SessionAge(clocks.rate)
    clocks.ask(age, 0.0, 0.001, 0.001)
    errors = [clocks.error_s(age, time_s) / clocks.rate for time_s in (1.0, 60.0, 3600.0, DAY_S)]
    assert min(errors) > -SLACK_S
    assert errors[-1] < 0.0003 * DAY_S


def test_without_an_answer_nothing_is_known_but_for_servers_that_tell_no_clock(clocks: Clocks) -> None:
    age = SessionAge(clocks.rate)
    clocks.hear(age, 0.0, 0.0005)
    assert not age.known
    assert age.age_s(clocks.here(0.1), clocks.there(0.0)) == math.inf
    age.alone = True
    for time_s in np.arange(1.0, 100.0):
        clocks.hear(age, time_s, 0.0005)
    # By the least delay: a stall after that is told in full.
    clocks.hear(age, 100.0, 5.0)
    told_s = age.age_s(clocks.here(105.0), clocks.there(100.0)) / clocks.rate
    assert 5.0 - 0.003 < told_s < 5.01


def test_a_rate_that_is_none_is_not_taken() -> None:
    age = SessionAge()
    age.answered(0, 1000, SECOND)
    for rate in (0.0, -1.0, math.nan, math.inf, 1e300, 1.0):
        age.runs_at(rate)
        assert age.time_ns(0) is not None
    age.runs_at(2.0)
    assert age.time_ns(0) is None, "what was learned at another rate holds no more"
