"""From a frame in memory to a callback in another process, with and without recording, side by side:
`python -m tests.measure.latency [PAIRS] [SECONDS]`.

`asterism serve` of the demo rig (five robots, 60 Hz) before a camera that shows a film (`looped_camera`) runs for
SECONDS (default 10), by turns without a recording, with all frames and with the windows around spots. Another process,
with a PoseClient, tells when its callback was called with each of one robot's poses; the frame report tells when that
frame was in memory. Printed: median and 99 % of all runs, the median over PAIRS (default 10) of the ratio of the 99 %
with a recording to that without one, poses lost, and the server's processor time a frame.
"""

import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.measure.looped_camera import serve_film
from tests.servers import free_endpoint

KINDS: dict[str, tuple[str, ...]] = {
    "none": (),
    "all": ("--record-frames", "all"),
    "spots": ("--record-frames", "spots"),
}
CLIENT = """
import json, sys, threading, time
import zenoh
from asterism.clients import PoseClient
from asterism.protocol.codec import decode_frame_report
from asterism.protocol.network import client_config

arrived, called = {}, {}
def frame(sample):
    report = decode_frame_report(sample.payload.to_bytes())
    arrived[report.sequence] = report.arrived_ns
with PoseClient(sys.argv[1]) as robots, zenoh.open(client_config(sys.argv[1])) as session:
    subscriber = session.declare_subscriber("asterism/*/frame", frame)
    robots["alpha"].on_pose(lambda pose: called.setdefault(pose.sequence, time.time_ns()))
    while not called:
        time.sleep(0.01)
    time.sleep(1.0)  # what starts is not what is measured
    first = max(called)
    time.sleep(float(sys.argv[2]))
    last = max(arrived)
    subscriber.undeclare()
    numbers = range(first + 1, last)
    took = [(called[k] - arrived[k]) * 1e-6 for k in numbers if k in called and k in arrived]
    print(json.dumps({"ms": took, "lost": len(numbers) - len(took), "frames": len(numbers)}), flush=True)
"""
RATE_HZ = 60
TICKS = os.sysconf("SC_CLK_TCK")


class Run(NamedTuple):
    """What one run of a server showed."""

    ms: list[float]
    lost: int
    cpu_ms: float  # of the server, a frame


def cpu_s(pid: int) -> float:
    """Processor time of a process and its threads up to now."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def run(kind: str, seconds: float) -> Run:
    """Serve, and listen from another process."""
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as folder:
        record = ("--record", folder, *KINDS[kind]) if KINDS[kind] else ()
        server = serve_film(DEMO_RIG, Path(folder), RATE_HZ, "--listen", endpoint, *record)
        try:
            return heard(server.pid, endpoint, seconds)
        finally:
            server.send_signal(signal.SIGINT)
            server.wait(timeout=60)


def heard(server: int, endpoint: str, seconds: float) -> Run:
    """Listen from another process to a server that runs."""
    before = cpu_s(server)
    done = subprocess.run(
        [sys.executable, "-c", CLIENT, endpoint, str(seconds)], capture_output=True, text=True, check=True
    )
    used = cpu_s(server) - before
    told = json.loads(done.stdout)
    # The second before counts its frames too.
    return Run(told["ms"], told["lost"], 1e3 * used / (told["frames"] + RATE_HZ))


def main(pairs: int = 10, seconds: float = 10.0) -> None:
    """Run by turns, and print a table."""
    runs: dict[str, list[Run]] = {kind: [] for kind in KINDS}
    for _ in range(pairs):
        for kind, told in runs.items():
            told.append(run(kind, seconds))
    table = Table(box=None)
    for heading in ("recorded", "poses", "lost", "p50 ms", "p99 ms", "p99 / p99 of none", "processor ms a frame"):
        table.add_column(heading, justify="left" if heading == "recorded" else "right")
    for kind, told in runs.items():
        table.add_row(kind, *figures(told, runs["none"], (99,)))
    Console(width=120).print(table)


def figures(told: list[Run], none: list[Run], percents: tuple[int, ...]) -> list[str]:
    """Poses, lost, median and 99 % of all runs, the medians over the turns of percentiles over those of ``none``, and
    the server's processor time a frame.
    """
    all_ms = np.concatenate([one.ms for one in told])
    return [
        str(len(all_ms)),
        str(sum(one.lost for one in told)),
        f"{np.median(all_ms):.2f}",
        f"{np.percentile(all_ms, 99):.1f}",
        *(f"{_ratio(told, none, percent):.2f}" for percent in percents),
        f"{statistics.median(one.cpu_ms for one in told):.2f}",
    ]


def _ratio(told: list[Run], none: list[Run], percent: int) -> float:
    return statistics.median(
        float(np.percentile(one.ms, percent) / np.percentile(other.ms, percent))
        for one, other in zip(told, none, strict=True)
    )


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, float), sys.argv[1:], strict=False)))
