"""The server's health for Prometheus: text over HTTP, on loopback only. Needs the extra `metrics`."""

import contextlib
from collections import Counter
from collections.abc import Iterator
from typing import Any

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
)

from asterism.protocol.errors import InputError
from asterism.server.service.serve import Run

HOST = "127.0.0.1"


class Collector:
    """What ``run`` is asked for at every scrape, from when there is one."""

    def __init__(self, camera: str) -> None:
        self.run: Run | None = None
        self._camera = camera

    def collect(self) -> Iterator[Metric]:
        """All metrics; each carries the camera's name."""
        return iter(()) if self.run is None else self._of(self.run)

    def _of(self, run: Run) -> Iterator[Metric]:
        health = run.health
        recent, tally = health.recent(), health.tally
        for name, text, value in (
            ("frames", "Frames localized", tally.frames),
            ("frames_dropped", "Frames that came while the one before was being solved", health.frames_dropped),
            ("frames_unreadable", "Images that could not be read", health.frames_unreadable),
            ("frames_not_recorded", "Frames that the recorder left out", health.frames_not_recorded),
            ("messages_not_recorded", "Poses and reports that the recorder left out", health.messages_not_recorded),
            ("beats", "Beats told", run.outlets.publisher.beats),
        ):
            yield self._with(CounterMetricFamily, name, text, {(): value})
        yield self._with(GaugeMetricFamily, "frame_rate_hertz", "Frames of the last second", {(): recent.rate_hz})
        text = "Mid-exposure to handed to the network, last second"
        yield self._quantiles("latency_seconds", text, recent.latency_p50_s, recent.latency_p99_s)
        text = "Frame in memory to poses known, last second"
        yield self._quantiles("solve_seconds", text, recent.solve_p50_s, recent.solve_p99_s)
        states = Counter(tally.newest().values()) if recent.rate_hz else Counter[str]()
        yield self._with(GaugeMetricFamily, "robots", "Robots by state in the newest frame", _keyed(states), "state")
        text = "Spots rejected before identification"
        yield self._with(CounterMetricFamily, "spots_rejected", text, _keyed(health.rejected()), "fate")
        text = "1 while something is wrong that the status tells"
        yield self._with(GaugeMetricFamily, "problem", text, {(): float(bool(health.problem))})
        # A number of 62 bits does not fit a metric's value.
        session = InfoMetricFamily("asterism_session", "Session that stamps belong to", labels=["camera"])
        session.add_metric([self._camera], {"session": str(run.clock.session)})
        yield session

    def _with(self, family: Any, name: str, text: str, values: dict[tuple[str, ...], float], *labels: str) -> Metric:
        made: Metric = family(f"asterism_{name}", text, labels=["camera", *labels])
        for of, value in values.items():
            made.add_metric([self._camera, *of], value)
        return made

    def _quantiles(self, name: str, text: str, p50: float, p99: float) -> Metric:
        return self._with(GaugeMetricFamily, name, text, {("0.5",): p50, ("0.99",): p99}, "quantile")


def _keyed(counts: Counter[str]) -> dict[tuple[str, ...], float]:
    return {(name,): count for name, count in counts.items()}


@contextlib.contextmanager
def metrics(camera: str, port: int) -> Iterator[Collector]:
    """Answer on that port of loopback until the context ends. Raises InputError for a port that cannot be had."""
    registry = CollectorRegistry(auto_describe=False)
    collector = Collector(camera)
    registry.register(collector)
    try:
        server, thread = start_http_server(port, HOST, registry)
    except OSError as error:
        raise InputError(
            f"--metrics {port}: cannot be listened on at {HOST} ({error.strerror}); expected a free port"
        ) from None
    # Who hangs up is nobody's trouble.
    server.handle_error = lambda *_: None
    try:
        yield collector
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
