"""A server that is left running: `python -m tests.measure.hour [MINUTES]` (default 60).

Ten robots at 60 Hz from a camera that shows a film in a loop, recorded with `--record-frames spots`. Two subscribers in
processes of their own: one with plain zenoh, that reads every frame report and every odometry message, and a
PoseClient that is handed every pose. Printed for every tenth of the time: latency from the frame in memory to the plain
subscriber's callback with the report, the server's own memory (no files) and its processor time a frame; then by how
much its memory grew after the first twelfth, which of the recorded messages did not arrive, and what the server's log
says at the end.
"""

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.messages import FRAME_REPORT, ODOMETRY
from asterism.recordings.reader import Recording
from tests.measure.latency import cpu_s
from tests.measure.looped_camera import serve_film
from tests.measure.serving import resident_mb
from tests.measure.ten_robots import write_ten_robots
from tests.servers import free_endpoint

RATE_HZ, PARTS = 60, 10
# Counts what arrives until its input is closed; every line asked for tells what came since the last.
PLAIN = """
import json, sys, time
from collections import Counter
import numpy as np, zenoh
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_frame_report, decode_odometry
from asterism.protocol.network import client_config

took, frames, told, poses, newest = [], 0, Counter(), Counter(), [None, None]
def frame(sample):
    global frames
    now_ns, report = time.time_ns(), decode_frame_report(sample.payload.to_bytes())
    took.append((now_ns - report.arrived_ns) * 1e-6)
    newest[0] = report.sequence if newest[0] is None else newest[0]
    newest[1], frames = report.sequence, frames + 1
    told.update(robot.id for robot in report.robots if robot.HasField("pose"))
def pose(sample):
    poses[decode_odometry(sample.payload.to_bytes()).robot] += 1
with zenoh.open(client_config(sys.argv[1])) as session:
    held = [session.declare_subscriber("asterism/*/robot/*/odometry", pose)]
    held += [session.declare_subscriber("asterism/*/frame", frame)]
    for _ in sys.stdin:
        some, took = took, []
        now = {"ms": np.percentile(some, [50, 99]).tolist() if some else None, "frames": frames, "first": newest[0]}
        now |= {"last": newest[1], "told": sum(told.values()), "poses": sum(poses.values())}
        print(json.dumps(now), flush=True)
"""
CLIENT = """
import json, sys
from collections import Counter
from asterism.clients import PoseClient

count, first, last = Counter(), {}, {}
def pose(told):
    count[told.robot] += 1
    first.setdefault(told.robot, told.sequence)
    last[told.robot] = told.sequence
with PoseClient(sys.argv[1]) as robots:
    robots.all().on_pose(pose)
    for _ in sys.stdin:
        now = {"poses": count, "first": first, "last": last, "late": robots.all().late}
        print(json.dumps(now | {"refused": robots.all().refused}), flush=True)
"""


class Listening:
    """A subscriber in a process of its own."""

    def __init__(self, program: str, endpoint: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", program, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self) -> dict[str, Any]:
        """What it counted."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        told: dict[str, Any] = json.loads(self._process.stdout.readline())
        return told

    def close(self) -> None:
        """End it."""
        self._process.communicate()


def serve_ten(folder: Path, endpoint: str, rate_hz: float, *options: str | Path) -> subprocess.Popen[bytes]:
    """Start a server of ten robots, and wait until it serves; its log is in the folder."""
    return serve_film(write_ten_robots(folder, rate_hz), folder, rate_hz, "--listen", endpoint, *options)


def lost(recording: Path, plain: dict[str, Any], client: dict[str, Any]) -> dict[str, int]:
    """Of what was recorded between the first and the last that each heard: how much did not arrive."""
    frames, poses = 0, Counter[str]()
    for message in Recording(recording).messages():
        if message.kind.schema == FRAME_REPORT.schema:
            frames += plain["first"] <= message.sequence <= plain["last"]
        elif message.kind.schema == ODOMETRY.schema:
            robot = message.key.split("/")[-2]
            poses[robot] += client["first"][robot] <= message.sequence <= client["last"][robot]
    return {
        "frames": frames - plain["frames"],
        "poses of the client": sum(poses.values()) - sum(client["poses"].values()),
    }


def main(minutes: float, folder: Path) -> None:
    """Run, and print a table."""
    console = Console(width=110)
    endpoint = free_endpoint()
    recordings = folder / "recordings"
    recordings.mkdir()
    server = serve_ten(folder, endpoint, RATE_HZ, "--record", recordings, "--record-frames", "spots")
    listening = {"plain": Listening(PLAIN, endpoint), "client": Listening(CLIENT, endpoint)}
    table = Table("minute", "p50 ms", "p99 ms", "memory MB", "processor ms a frame", box=None)
    memory, part_s = [], 60.0 * minutes / PARTS
    time.sleep(2.0)
    listening["plain"].ask()
    for part in range(PARTS):
        until, used = time.monotonic() + part_s, cpu_s(server.pid)
        while time.monotonic() < until:
            time.sleep(min(part_s / 20, 10.0))
            memory.append(resident_mb(server.pid, "RssAnon"))
        told = listening["plain"].ask()
        used = 1e3 * (cpu_s(server.pid) - used) / (part_s * RATE_HZ)
        row = [f"{(part + 1) * part_s / 60:.0f}", *(f"{ms:.2f}" for ms in told["ms"]), f"{memory[-1]:.1f}"]
        table.add_row(*row, f"{used:.2f}")
        print(*row, flush=True)
    last = {name: one.ask() for name, one in listening.items()}
    server.send_signal(signal.SIGINT)
    code = server.wait(timeout=60)
    for one in listening.values():
        one.close()
    console.print(table)
    settled = np.array(memory[len(memory) // 12 :])
    growth = 100.0 * (settled.max() / settled[0] - 1.0)
    console.print(f"memory: {settled[0]:.1f} MB after the first twelfth, then at most {growth:.1f} % more")
    missing = lost(next(recordings.iterdir()), last["plain"], last["client"])
    missing["poses"] = last["plain"]["told"] - last["plain"]["poses"]
    console.print(f"of {last['plain']['frames']} frames and {last['plain']['poses']} poses lost: {json.dumps(missing)}")
    console.print(f"late {last['client']['late']}, refused {last['client']['refused']}")
    size = sum(file.stat().st_size for file in recordings.rglob("*.mcap"))
    console.print(f"recording: {size * 1e-6:.0f} MB; the server ended with exit code {code}, and said:")
    console.print((folder / "log.txt").read_text()[-3000:], markup=False, highlight=False)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0, Path(temporary))
