"""A hundred subscribers: `python -m tests.measure.hundred [SECONDS] [TURNS]` (default 20, 3).

Ten robots at 100 Hz from a camera that shows a film in a loop, by turns with nobody but one reader of frame reports and
with a hundred subscribers, each with a zenoh session of its own, to one robot each (four processes of 25). Printed:
messages lost, and the chain's own time (frame in memory to poses known) with them over that without.
"""

import json
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console

from asterism.protocol.rig import load_rig
from tests.measure.hour import serve_ten
from tests.measure.ten_robots import write_ten_robots
from tests.servers import free_endpoint

RATE_HZ, PROCESSES, EACH = 100.0, 4, 25
# Payloads are kept, and read when all is over.
SUBSCRIBERS = """
import json, sys
import zenoh
from asterism.protocol.codec import decode_odometry
from asterism.protocol.network import client_config

endpoint, *robots = sys.argv[1:]
heard = [[] for _ in robots]
sessions = [zenoh.open(client_config(endpoint)) for _ in robots]
held = []
for session, robot, into in zip(sessions, robots, heard):
    def receive(sample, into=into):
        into.append(sample.payload.to_bytes())
    held.append(session.declare_subscriber(f"asterism/*/robot/{robot}/odometry", receive))
print("ready", flush=True)
sys.stdin.readline()
for session in sessions:
    session.close()
print(json.dumps([[decode_odometry(payload).sequence for payload in payloads] for payloads in heard]))
"""
READER = """
import json, sys
import zenoh
from asterism.protocol.codec import decode_frame_report
from asterism.protocol.network import client_config

heard = []
with zenoh.open(client_config(sys.argv[1])) as session:
    held = session.declare_subscriber("asterism/*/frame", lambda sample: heard.append(sample.payload.to_bytes()))
    print("ready", flush=True)
    sys.stdin.readline()
reports = [decode_frame_report(payload) for payload in heard]
print(json.dumps({"ms": [(r.solved_ns - r.arrived_ns) * 1e-6 for r in reports],
                  "poses": {r.sequence: [robot.id for robot in r.robots if robot.HasField("pose")] for r in reports}}))
"""


def started(program: str, *words: str) -> subprocess.Popen[str]:
    """A process, once it listens."""
    process = subprocess.Popen(
        [sys.executable, "-c", program, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def turn(folder: Path, crowd: bool, seconds: float) -> tuple[float, int, int]:
    """The chain's median time, ms; messages that should have been heard, and those that were not."""
    endpoint = free_endpoint()
    server = serve_ten(folder, endpoint, RATE_HZ)
    robots = [robot.id for robot in load_rig(write_ten_robots(folder, RATE_HZ)).robots]
    reader = started(READER, endpoint)
    wanted = [robots[k % len(robots)] for k in range(EACH)] if crowd else []
    many = [started(SUBSCRIBERS, endpoint, *wanted) for _ in range(PROCESSES if crowd else 0)]
    time.sleep(seconds)
    told = [process.communicate("\n")[0] for process in (*many, reader)]
    server.send_signal(signal.SIGINT)
    server.wait(timeout=60)
    read = json.loads(told[-1])
    expected = lost = 0
    for heard in map(json.loads, told[:-1]):
        for robot, numbers in zip(wanted, heard, strict=True):
            due = [k for k in range(numbers[0], numbers[-1] + 1) if robot in read["poses"].get(str(k), ())]
            expected, lost = expected + len(due), lost + len(set(due) - set(numbers))
    return statistics.median(read["ms"]), expected, lost


def main(seconds: float = 20.0, turns: int = 3) -> None:
    """Run by turns, and print."""
    alone, crowded = [], []
    with tempfile.TemporaryDirectory() as temporary:
        for _ in range(turns):
            alone.append(turn(Path(temporary), False, seconds))
            crowded.append(turn(Path(temporary), True, seconds))
    ratios = [many[0] / one[0] for many, one in zip(crowded, alone, strict=True)]
    console = Console()
    console.print(f"messages: {sum(t[1] for t in crowded)}, lost: {sum(t[2] for t in crowded)}")
    console.print(
        f"the chain, ms: {[round(t[0], 3) for t in alone]} alone, {[round(t[0], 3) for t in crowded]} with a hundred; "
        f"median ratio {statistics.median(ratios):.3f}"
    )


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((float, int), sys.argv[1:], strict=False)))
