"""Where the time goes between a frame in memory and a callback in another process, stage by stage:
`python -m tests.measure.stages [SECONDS] [KIND]`.

`asterism serve` of the demo rig (five robots, 60 Hz) before a camera that shows a film (`looped_camera`) for SECONDS
(default 10), recording KIND (none, all, spots; default none); another process listens with a PoseClient to all robots.
Times of the server are those that its messages tell: arrived, solved, published. Printed: median, 90 and 99 % of every
stage, ms, of all poses; of the whole way also those of the first robot, which is published first, and of the last.
"""

import json
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.rig import load_rig
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.measure.latency import KINDS
from tests.measure.looped_camera import serve_film
from tests.servers import free_endpoint

CLIENT = """
import json, sys, time
import zenoh
from asterism.clients import PoseClient
from asterism.clients.received_pose import clock_ns
from asterism.protocol.codec import decode_frame_report
from asterism.protocol.network import client_config

reports, poses = {}, []
def frame(sample):
    report = decode_frame_report(sample.payload.to_bytes())
    reports[report.sequence] = (report.arrived_ns, report.solved_ns)
def called(pose):
    now = clock_ns()
    poses.append((pose.sequence, pose.robot, pose.published_ns, pose.received_ns + epoch, now + epoch))
epoch = time.time_ns() - clock_ns()
with PoseClient(sys.argv[1]) as robots, zenoh.open(client_config(sys.argv[1])) as session:
    subscriber = session.declare_subscriber("asterism/*/frame", frame)
    robots.all().on_pose(called)
    time.sleep(float(sys.argv[2]))
    told = list(poses)
    print(json.dumps([[*reports[k], *times, robot] for k, robot, *times in told if k in reports]), flush=True)
"""
STAGES = (
    "frame in memory, poses known",
    "report built and encoded, stamped",
    "put, on the wire, taken by the client",
    "decoded, checked, callback",
)
SETTLED_S = 1.5  # what starts is not what is measured
RATE_HZ = 60


def run(seconds: float, kind: str) -> tuple[np.ndarray, list[str]]:
    """The times of every pose (n, 5), ns, and whose they are."""
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as place:
        record = ("--record", place, *KINDS[kind]) if KINDS[kind] else ()
        server = serve_film(DEMO_RIG, Path(place), RATE_HZ, "--listen", endpoint, *record)
        try:
            done = subprocess.run(
                [sys.executable, "-c", CLIENT, endpoint, str(seconds + SETTLED_S)],
                capture_output=True,
                text=True,
                check=True,
            )
        finally:
            server.send_signal(signal.SIGINT)
            server.wait(timeout=60)
    told = json.loads(done.stdout)
    first_ns = told[0][0] + SETTLED_S * 1e9
    told = [row for row in told if row[0] >= first_ns]
    return np.array([row[:5] for row in told]), [row[5] for row in told]


def add(table: Table, label: str, ms: np.ndarray) -> None:
    """A row: median, 90, 99 %."""
    table.add_row(label, *(f"{value:.2f}" for value in np.percentile(ms, [50, 90, 99])))


def main(seconds: float, kind: str) -> None:
    """Measure and print."""
    warm_up(*localizing(load_rig(DEMO_RIG)))
    times, robots = run(seconds, kind)
    table = Table(title=f"{len(times)} poses, recording {kind}", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("stage", "p50 ms", "p90", "p99"):
        table.add_column(heading, justify="left" if heading == "stage" else "right")
    took = np.diff(times, axis=1) * 1e-6
    for label, ms in zip(STAGES, took.T, strict=True):
        add(table, label, ms)
    whole = took.sum(axis=1)
    add(table, "frame in memory to callback", whole)
    for robot in (robots[0], robots[-1]):
        add(table, f"the same, {robot}", whole[np.array(robots) == robot])
    Console(width=100).print(table)


if __name__ == "__main__":
    words = sys.argv[1:]
    main(float(words[0]) if words else 10.0, words[1] if len(words) > 1 else "none")
