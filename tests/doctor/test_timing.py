"""Rates, lost frames, stamps; and the delay of stamps by a light that blinks."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Clock
from asterism.server.doctor.blink import check_delay, delay_of
from asterism.server.doctor.finding import Verdict
from asterism.server.doctor.gather import Gathered
from asterism.server.doctor.timing import check_jitter, check_lost, check_rate, stamps_of
from tests.doctor.drawn import PERIOD_NS, gathered, nobody, pictures, spot
from tests.rigs import make_rig

RIG = replace(make_rig(1, 0), capture=Capture(rate_hz=60.0, delay_us=100.0))
EVEN = 1_700_000_000_000_000_000 + PERIOD_NS * np.arange(120)
GOOD, LOOK, WRONG, UNTOLD = Verdict.GOOD, Verdict.LOOK, Verdict.WRONG, Verdict.UNTOLD


def stamped(times_ns: Floats) -> Gathered:
    return gathered(RIG, nobody(RIG), pictures(0, None, times_ns))


def verdicts(told: Gathered) -> tuple[Verdict, ...]:
    """On rate, lost frames and stamps."""
    found = stamps_of(told.times)
    return tuple(check(told, found).verdict for check in (check_rate, check_lost, check_jitter))


def test_an_even_beat_is_good_with_the_jitter_of_a_camera(rng: np.random.Generator) -> None:
    for jitter_ns in (0.0, 3e4, 1e5):
        assert verdicts(stamped(EVEN + jitter_ns * rng.normal(size=120))) == (GOOD, GOOD, GOOD)


def test_lost_frames_are_counted_and_change_neither_rate_nor_jitter(rng: np.random.Generator) -> None:
    for lost, verdict in ((1, LOOK), (3, LOOK), (30, WRONG)):
        inner = np.sort(rng.choice(np.arange(1, 119), 118 - lost, replace=False))
        told = stamped(EVEN[np.concatenate([[0], inner, [119]])])
        assert verdicts(told) == (GOOD, verdict, GOOD)
        found = stamps_of(told.times)
        assert found is not None
        assert found.lost == lost


def test_jitter_is_told_as_large_as_it_is(rng: np.random.Generator) -> None:
    for jitter_s, verdict in ((1e-3, LOOK), (3e-3, WRONG)):
        told = stamped(EVEN + 1e9 * jitter_s * rng.normal(size=120))
        found = stamps_of(told.times)
        assert found is not None
        assert found.jitter_s == pytest.approx(jitter_s, rel=0.25)
        assert verdicts(told)[2] == verdict


def test_a_rate_that_is_not_the_one_asked_for_is_told() -> None:
    assert verdicts(stamped(EVEN[::2])) == (WRONG, GOOD, GOOD)
    assert verdicts(stamped(EVEN[0] + (EVEN - EVEN[0]) * 1.05))[0] == LOOK


def test_time_that_runs_backwards_is_wrong() -> None:
    times = EVEN.copy()
    times[60] -= 10 * PERIOD_NS
    assert verdicts(stamped(times))[2] == WRONG


def test_of_a_film_without_times_of_its_own_nothing_is_claimed() -> None:
    told = stamped(EVEN)
    film = told.times._replace(clocks=np.full(120, int(Clock.FILE)))
    assert verdicts(told._replace(times=film)) == (UNTOLD, GOOD, UNTOLD)
    missing = film._replace(exposed_ns=film.exposed_ns[::3], indices=film.indices[::3])
    assert verdicts(told._replace(times=missing))[1] == WRONG


def lit_by(times_ns: Floats, delay_s: float) -> Floats:
    """Which frames show a light of 7.3 Hz that is on in the first half of every period, stamped so late."""
    delay_ns = round(1e9 * delay_s)
    return np.array([float((Fraction(int(time) - delay_ns, 10**9) * Fraction(73, 10)) % 1 < 0.5) for time in times_ns])


@pytest.mark.parametrize("delay_s", [0.0, 2.5e-3, -1.2e-3, 8e-3])
def test_the_delay_is_told_within_what_is_told_of_it(delay_s: float) -> None:
    found = delay_of(EVEN, lit_by(EVEN, delay_s), 7.3)
    assert found is not None
    assert abs(found[0] - delay_s) <= found[1] + 1e-9
    assert found[1] < 2e-3


def test_a_blinking_light_among_others_sets_the_delay() -> None:
    rows = [np.concatenate([spot(200, 100), *([spot(402, 300.1)] if on else [])]) for on in lit_by(EVEN, 3e-3)]
    told = gathered(RIG, nobody(RIG), pictures(0, rows, EVEN))
    finding = check_delay(told, 7.3)
    assert finding.verdict == LOOK
    assert "LED at 402, 300 px" in finding.measured
    assert float(finding.advice.split("delay_us: ")[1].split()[0]) == pytest.approx(3100.0, abs=1000.0)
    assert check_delay(told, 5.0).verdict == UNTOLD
    assert check_delay(told, None).verdict == UNTOLD
