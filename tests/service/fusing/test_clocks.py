"""Clocks that disagree: from how long reports are on their way, and from where robots on the move are."""

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.server.service.fusing.host_clocks import HostClocks, told_apart
from asterism.server.service.fusing.ways import Ways, told_of_times
from tests.several import Drive

MS, S = 1_000_000, 1_000_000_000
PERIOD_NS = 16_666_667


def heard(rng: np.random.Generator, **ahead_ms: float) -> HostClocks:
    """Ten seconds of reports of cameras, each with a way of 1 to 20 ms, whose clocks are so much ahead."""
    clocks = HostClocks()
    for k in range(600):
        for camera, ahead in ahead_ms.items():
            out_ns = 10**18 + k * PERIOD_NS
            clocks.add(camera, out_ns + int(ahead * MS), out_ns + int(rng.uniform(1, 20) * MS))
    return clocks


def test_clocks_that_agree_say_nothing(rng: np.random.Generator) -> None:
    assert told_apart(heard(rng, left=0, right=1, third=-2), PERIOD_NS) == []
    assert told_apart(heard(rng, left=500), PERIOD_NS) == []


def test_the_two_that_are_farthest_apart_are_named(rng: np.random.Generator) -> None:
    (told,) = told_apart(heard(rng, left=-20, right=23, third=0), PERIOD_NS)
    assert told == "clocks of left and right differ by 43 ms: run chrony or PTP on both; docs/many.md"


@pytest.mark.parametrize("ahead", [5000, -5000])
def test_a_clock_that_is_far_off_is_left_out(rng: np.random.Generator, ahead: int) -> None:
    for others in ({"left": 0.0, "third": 3.0}, {"left": 40.0}):
        clocks = heard(rng, right=ahead, **others)
        assert list(clocks.astray()) == ["right"]
        assert clocks.astray()["right"] * 1e-9 == pytest.approx(ahead * 1e-3, abs=0.05)
        (told,) = told_apart(clocks, PERIOD_NS)
        assert told.startswith(f"the clock of right shows {abs(clocks.astray()['right']) * 1e-9:.3g} s ")
        assert ("more" if ahead > 0 else "less") in told


def ways(rng: np.random.Generator, offset_s: float, drive: Drive) -> Ways:
    """Eight seconds of robots as two cameras have them, 0.1 mm, the second's times so much more."""
    found = Ways()
    for k in range(480):
        for camera, later in (("left", 0.0), ("right", offset_s)):
            report = pb.FrameReport(exposed_ns=10**18 + round((k / 60 + later) * S))
            for robot, pose in drive(k / 60).items():
                entry = report.robots.add(id=robot, state=pb.TRACKED)
                elsewhere = np.array([0.001, 0.0, 0.002]) * (camera == "right")  # of a place that is not quite right
                p = entry.pose.position
                p.x, p.y, p.z = (pose.position + elsewhere + 1e-4 * rng.normal(size=3)).tolist()
                entry.covariance.extend((np.eye(6) * 1e-8).ravel().tolist())
            found.add(camera, report)
    found.look(S)
    return found


def test_robots_on_the_move_tell_how_far_times_are_apart(rng: np.random.Generator) -> None:
    found = ways(rng, 0.006, Drive(("a", "b"), speed=0.3))
    (apart,) = found.found()
    assert apart.offset_s == pytest.approx(0.006, abs=5 * apart.sigma_s)
    assert apart.sigma_s < 0.001
    (told,) = told_of_times(found, 1 / 60)
    assert "the times of left and right differ by" in told


@pytest.mark.parametrize(("offset_s", "speed"), [(0.0, 0.3), (0.005, 0.0)], ids=["agree", "stand still"])
def test_nothing_is_said_where_times_agree_or_nobody_moves(
    rng: np.random.Generator, offset_s: float, speed: float
) -> None:
    drive = Drive(("a", "b"), speed=0.3)
    found = ways(rng, offset_s, drive if speed else lambda _: drive(0.0))  # type: ignore[arg-type]
    assert told_of_times(found, 1 / 60) == []


def test_what_is_known_of_a_session_is_forgotten_with_it(rng: np.random.Generator) -> None:
    found = ways(rng, 0.006, Drive(("a", "b"), speed=0.3))
    found.forget("right")
    assert found.found() == []
    clocks = heard(rng, left=0, right=43)
    clocks.forget("left")
    assert told_apart(clocks, PERIOD_NS) == []
