"""What Prometheus is told, read with its own parser."""

import socket
import urllib.request

import numpy as np
import pytest

pytest.importorskip("prometheus_client", reason="prometheus-client is not installed (pip install '.[metrics]')")

from prometheus_client.parser import text_string_to_metric_families

from asterism.protocol.errors import InputError
from asterism.protocol.rig import load_rig
from asterism.server.service.metrics import metrics
from asterism.server.service.serve import Outlets, Run
from asterism.server.service.stop import Stop
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.simulated import Simulated
from tests.service.nobody import Nobody

FRAMES = 5


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def told(port: int) -> dict[str, list[tuple[dict[str, str], float]]]:
    """Labels beside the camera's, and value, of every sample by its name."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10.0) as answer:
        text = answer.read().decode()
    found: dict[str, list[tuple[dict[str, str], float]]] = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            assert sample.labels.pop("camera") == "demo"
            found.setdefault(sample.name.removeprefix("asterism_"), []).append((sample.labels, sample.value))
    return found


def test_it_is_what_the_run_counts() -> None:
    rig, port, clock = load_rig(DEMO_RIG), free_port(), SessionClock()
    run = Run(rig, Simulated(rig, count=FRAMES), Outlets(Nobody()), Stop(), clock)
    with metrics("demo", port) as collector:
        assert told(port) == {}
        collector.run = run
        run.serve(rate_hz=1000.0)
        said = told(port)
    for name in ("frames_dropped", "frames_unreadable", "frames_not_recorded", "messages_not_recorded"):
        assert said.pop(f"{name}_total") == [({}, 0.0)]
    assert said.pop("frames_total") == [({}, FRAMES)]
    assert said.pop("beats_total") == [({}, 7.0)]
    assert said.pop("problem") == [({}, 0.0)]
    assert said.pop("session_info") == [({"session": str(clock.session)}, 1.0)]
    assert said.pop("spots_rejected_total", []) == [({"fate": f}, n) for f, n in run.health.rejected().items()]
    assert 0.0 <= said.pop("frame_rate_hertz")[0][1] <= FRAMES
    for name in ("latency_seconds", "solve_seconds"):
        assert [labels["quantile"] for labels, _ in said.pop(name)] == ["0.5", "0.99"]
    assert np.sum([value for _, value in said.pop("robots", [])]) in (0, len(rig.robots))
    assert said == {}


def test_it_listens_on_loopback_only_and_a_port_in_use_is_refused() -> None:
    port = free_port()
    with metrics("demo", port):
        with socket.socket() as other:
            other.bind(("127.0.0.2", port))  # free: not all addresses are listened on
        with pytest.raises(InputError, match=rf"--metrics {port}: cannot be listened on .* expected a free port"):
            metrics("demo", port).__enter__()
