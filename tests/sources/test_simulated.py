"""The simulated camera as a source that is served: several processes show one world at the same times."""

from dataclasses import replace

import numpy as np

from asterism.protocol.messages import Clock
from asterism.protocol.rig import Rig
from asterism.server.simulation.simulate import Scene
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.simulated import Simulated
from tests.rigs import make_camera
from tests.several import facing_pair, rigs_at

LEFT, RIGHT = (
    replace(rig, camera=make_camera(320, 256, 350.0, rig.camera.name)) for rig in rigs_at(facing_pair(), robots=3)
)
PERIOD_NS = 16_666_667
NOON_NS = 1_800_000_000_123_456_789


class Host:
    """A host's clocks, which go on by a step with every look at them; ``set_by`` ns its wall clock was set."""

    def __init__(self, started_ns: int, step_ns: int) -> None:
        self.now_ns, self.step_ns, self.started_ns, self.set_by = 0, step_ns, started_ns, 0
        self.clock = SessionClock(lambda: self.started_ns + self.set_by + self.now_ns, self.monotonic)

    def monotonic(self) -> int:
        self.now_ns += self.step_ns
        return self.now_ns


def never() -> bool:
    return False


def test_cameras_of_two_hosts_expose_at_once_what_is_there_then() -> None:
    times = []
    for rig, started_ns in ((LEFT, NOON_NS), (RIGHT, NOON_NS + 5_000_000)):
        source, scene, host = Simulated(rig, seed=2, count=4), Scene(rig, 2), Host(started_ns, 5_000_000)
        frames = list(source.by_the_clock(None, never, host.clock))
        assert [frame.index for frame in frames] == [0, 1, 2, 3]
        for frame in frames:
            number, rest = divmod(frame.exposed_ns, PERIOD_NS)
            assert rest == 0
            assert frame.arrived_ns >= frame.exposed_ns
            assert (frame.clock, frame.session) == (Clock.PLAYED, host.clock.session)
            truth = scene.truth(number, frame.exposed_ns * 1e-9)
            np.testing.assert_array_equal(frame.image, scene.render(number, truth))
        times.append([frame.exposed_ns for frame in frames])
    assert len(set(times[0]) & set(times[1])) >= 3
    assert np.ptp(np.diff(times)) == 0


def spacings(rig: Rig, host: Host, rate_hz: float | None = None) -> list[int]:
    frames = Simulated(rig, count=5).by_the_clock(rate_hz, never, host.clock)
    stamps = [frame.exposed_ns for frame in frames]
    return [int(step) for step in np.diff(stamps)]


def test_what_cannot_be_rendered_in_time_is_not_exposed() -> None:
    assert spacings(LEFT, Host(NOON_NS, 5_000_000)) == [PERIOD_NS] * 4
    assert spacings(LEFT, Host(NOON_NS, 5_000_000), 20.0) == [50_000_000] * 4
    slow = spacings(LEFT, Host(NOON_NS, 20_000_000))
    assert all(step % PERIOD_NS == 0 for step in slow)
    assert min(slow) > PERIOD_NS


def test_where_the_clock_was_set_back_it_goes_on_at_once() -> None:
    host, stamps = Host(NOON_NS, 5_000_000), []
    for frame in Simulated(LEFT, count=4).by_the_clock(None, never, host.clock):
        stamps.append((frame.exposed_ns, frame.session))
        if len(stamps) == 2:
            host.set_by = -3_600_000_000_000
            assert host.clock.look() is not None
    assert stamps[2][0] - stamps[1][0] < -3_599_000_000_000
    assert stamps[3][0] - stamps[2][0] == PERIOD_NS
    assert stamps[2][1] == stamps[3][1] != stamps[1][1]


def test_it_ends_when_it_is_told_to() -> None:
    host, told = Host(NOON_NS, 5_000_000), list[int]()
    for frame in Simulated(LEFT).by_the_clock(None, lambda: len(told) == 2, host.clock):
        told.append(frame.index)
    assert told == [0, 1]
