"""The clock that stamps: steps of the wall clock, small corrections, frames on their way."""

import pytest

from asterism.server.service.play_clock import PlayClock
from asterism.server.sources.session_clock import STEP_NS, SessionClock

EPOCH_NS = 1_795_398_896_000_000_000


class Host:
    """A machine whose clocks a test sets."""

    def __init__(self) -> None:
        self.monotonic_ns = 5_000_000_000
        self.wall_ns = EPOCH_NS

    def wall(self) -> int:
        return self.wall_ns

    def monotonic(self) -> int:
        return self.monotonic_ns

    def run(self, ns: int) -> None:
        self.monotonic_ns += ns
        self.wall_ns += ns


@pytest.fixture
def host() -> Host:
    return Host()


@pytest.mark.parametrize("step_ns", [3_600_000_000_000, -3_600_000_000_000, STEP_NS + 1, -STEP_NS - 1])
def test_a_step_of_the_wall_clock_begins_a_session(host: Host, step_ns: int) -> None:
    clock = SessionClock(host.wall, host.monotonic)
    before = clock.session
    host.run(1_000_000_000)
    assert clock.look() is None
    host.wall_ns += step_ns
    assert clock.now_ns() == EPOCH_NS + 1_000_000_000  # nobody has looked yet
    assert clock.look() == step_ns
    assert clock.session != before
    assert clock.now_ns() == EPOCH_NS + 1_000_000_000 + step_ns
    # A frame that was stamped before the step is told by the clock that stamped it.
    assert clock.now_ns(before) == EPOCH_NS + 1_000_000_000


def test_small_corrections_of_the_wall_clock_are_not_followed(host: Host) -> None:
    clock = SessionClock(host.wall, host.monotonic)
    session = clock.session
    host.wall_ns += STEP_NS // 2
    assert clock.look() is None
    assert (clock.session, clock.now_ns()) == (session, EPOCH_NS)


def test_sessions_long_over_are_refused(host: Host) -> None:
    clock = SessionClock(host.wall, host.monotonic)
    first = clock.session
    for _ in range(2):
        host.wall_ns += 2 * STEP_NS
        clock.look()
    with pytest.raises(KeyError):
        clock.now_ns(first)


def test_every_play_runs_through_the_recordings_time_in_a_session_of_its_own(host: Host) -> None:
    clock = PlayClock(2.0, host.monotonic)
    sessions = set()
    for _ in range(2):
        clock.begin(EPOCH_NS)
        host.run(500_000_000)
        assert clock.now_ns() == EPOCH_NS + 1_000_000_000
        sessions.add(clock.session)
    assert len(sessions) == 2
