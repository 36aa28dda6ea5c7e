"""The status' last second is one of the monotonic clock, whatever happens to the wall clock."""

import numpy as np
import pytest

from asterism.protocol.codec import decode_status
from asterism.protocol.messages import Fate
from asterism.server.centres.blobs import Blobs
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.pose.solve import Lost
from asterism.server.service.health import Health

EPOCH_NS = 1_795_398_896_000_000_000
IMAGE = np.zeros((4, 4), np.uint8)


def spots(*fates: int) -> Blobs:
    n = len(fates)
    whose = np.full(n, -1)
    return Blobs(
        np.zeros((n, 2)), np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.array(fates, int), whose, whose, IMAGE
    )


class Host:
    """A machine whose clocks a test sets; frames are taken at 50 Hz, and take 2 ms."""

    def __init__(self) -> None:
        self.monotonic_ns = 7_000_000_000
        self.offset_ns = EPOCH_NS
        self.health = Health("cam", "sim", ["alpha"], lambda: self.monotonic_ns)

    def frame(self) -> None:
        now = self.monotonic_ns + self.offset_ns
        result = FrameResult(0, now, spots(), {"alpha": Lost("hidden")}, np.zeros(1))
        self.health.add(Frame(IMAGE, now, 0, arrived_ns=now), result, now + 1_000_000, now + 2_000_000)
        self.monotonic_ns += 20_000_000


@pytest.mark.parametrize("step_s", [-3600, 3600, -1, 0.5])
def test_a_step_of_the_clock_leaves_rate_and_list_as_they_are(step_s: float) -> None:
    host = Host()
    for frame in range(500):
        if frame == 200:
            host.offset_ns += round(step_s * 1e9)
        host.frame()
        status = decode_status(host.health.message(host.monotonic_ns + host.offset_ns).payload)
        assert status.rate_hz == min(frame + 1, 50)
        assert status.latency_p50_s == pytest.approx(2e-3)
        assert status.solve_p99_s == pytest.approx(1e-3)
    assert len(host.health._recent) <= 51


def test_the_list_is_bounded_where_nobody_asks_for_the_status() -> None:
    host = Host()
    for _ in range(1000):
        host.frame()
    assert len(host.health._recent) <= 51


def test_rejected_spots_are_counted_since_the_start_too() -> None:
    health = Health("cam", "sim", ["alpha"])
    seen = spots(Fate.TOO_SMALL, Fate.TOO_SMALL, Fate.LED, Fate.AT_EDGE)
    result = FrameResult(0, 0, seen, {"alpha": Lost("hidden")}, np.zeros(1))
    for _ in range(3):
        health.add(Frame(IMAGE, 0, 0), result, 0, 0)
    assert health.rejected() == {"TOO_SMALL": 6, "AT_EDGE": 3}
