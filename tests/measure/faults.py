"""A server and its clients through faults, in processes of their own: `python -m tests.measure.faults [ROUNDS] [NAME]`.

Each fault is done ROUNDS times (default 5) to a server of the simulated camera, which records, with a client of another
process listening all the while. Told for each: how long after the fault's end poses are there again (median and
worst), poses that are wrong (more than 5 mm from the simulation's truth), poses handed out older than they may be,
tracebacks anywhere, and what the recording lost.
"""

import argparse
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zenoh
from rich.console import Console
from rich.table import Table

from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report, encode_odometry
from asterism.protocol.messages import FRAME_REPORT
from asterism.protocol.network import client_config
from asterism.protocol.rig import load_rig
from asterism.recordings.reader import Recording
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.protocol.make_golden import ROBOT_POSE
from tests.servers import asterism, free_endpoint

RATE_HZ = 60
ROBOT, CAMERA = "alpha", "demo"
WRONG_M = 0.005
WARM = 180  # frames before the fault
OLDEST_S = 0.3  # of what `latest(0.1)` hands out, measured from outside
TIMEOUT_S = 60.0

CLIENT = """
import json, sys, time
from asterism.clients import PoseClient
with PoseClient(sys.argv[1]) as robots:
    feed, before = robots["alpha"], None
    print(json.dumps({"up": time.monotonic()}), flush=True)
    while True:
        pose = feed.latest(0.1)
        state = robots.link.state.name
        told = None if pose is None else (pose.session, pose.sequence)
        if (told, state) != before:
            before = told, state
            line = {"at": time.monotonic(), "state": state}
            if pose is not None:
                line |= {"sequence": pose.sequence, "session": pose.session, "exposed": pose.exposed_ns,
                         "position": pose.position.tolist(), "wall": time.time_ns()}
            print(json.dumps(line), flush=True)
        time.sleep(0.002)
"""


class Client:
    """A program with a PoseClient, and what it was handed."""

    def __init__(self, endpoint: str) -> None:
        self.lines: list[dict[str, Any]] = []
        self.changed = threading.Condition()
        self.process = subprocess.Popen(
            [sys.executable, "-c", CLIENT, endpoint], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self.changed:
                self.lines.append(json.loads(line))
                self.changed.notify_all()

    def pose_after(self, moment: float, session_not: int | None = None) -> float:
        """When the first pose was handed out after a moment (monotonic, s)."""

        def found() -> list[dict[str, Any]]:
            return [
                line
                for line in self.lines
                if line.get("at", 0.0) > moment and "sequence" in line and line["session"] != session_not
            ]

        with self.changed:
            assert self.changed.wait_for(lambda: bool(found()), TIMEOUT_S), "no pose came again"
            return float(found()[0]["at"])

    def until_sequence(self, number: int) -> None:
        """Wait for the pose of that frame, or a later one."""
        with self.changed:
            assert self.changed.wait_for(
                lambda: any(line.get("sequence", 0) >= number for line in reversed(self.lines)), TIMEOUT_S
            ), f"frame {number} never came"

    def state_after(self, moment: float, state: str) -> float:
        """When it told that state first after a moment."""
        with self.changed:
            assert self.changed.wait_for(
                lambda: any(line.get("state") == state and line["at"] > moment for line in self.lines), TIMEOUT_S
            ), f"never {state}"
            return float(next(line["at"] for line in self.lines if line.get("state") == state and line["at"] > moment))

    def session(self) -> int:
        with self.changed:
            return int(next(line["session"] for line in reversed(self.lines) if "session" in line))

    def end(self) -> str:
        """End it; returns what it wrote on its error channel."""
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        return self.process.communicate(timeout=30)[1]


class Server:
    """`asterism serve sim --record`, and what it says."""

    def __init__(self, place: list[str], folder: Path, rig: Path = DEMO_RIG) -> None:
        self.place, self.folder, self.rig = place, folder, rig
        self.said = ""
        self.start()

    def start(self) -> None:
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115  # closed with the server
        self.process = subprocess.Popen(
            [sys.executable, "-m", "asterism.server", "serve", self.rig, "sim", *self.place, "--record", self.folder],
            stdout=subprocess.DEVNULL,
            stderr=self.errors,
        )

    def collect(self) -> None:
        self.errors.seek(0)
        self.said += self.errors.read()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.collect()

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            self.process.wait(60)
        self.collect()


class Place(NamedTuple):
    """A running server with a client that has had a pose."""

    server: Server
    client: Client
    endpoint: str
    folder: Path


@contextmanager
def served(rig: Path = DEMO_RIG) -> Iterator[Place]:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = free_endpoint()
        server = Server(["--listen", endpoint], folder, rig)
        stack.callback(server.end)
        client = Client(endpoint)
        stack.callback(client.end)
        client.until_sequence(WARM)
        yield Place(server, client, endpoint, folder)
        # What is judged comes after this.


# Faults. Each returns how long after its end poses were there again, s.


def killed(place: Place) -> float:
    """kill -9, and started again at once."""
    session = place.client.session()
    place.server.kill()
    moment = time.monotonic()
    place.server.start()
    return place.client.pose_after(moment, session) - moment


def frozen(place: Place) -> float:
    """SIGSTOP for 3 s: the client says so within a second."""
    place.server.process.send_signal(signal.SIGSTOP)
    moment = time.monotonic()
    told = place.client.state_after(moment, "SILENT") - moment
    assert told < 1.3, f"told after {told:.2f} s"
    time.sleep(max(3.0 - told, 0.0))
    place.server.process.send_signal(signal.SIGCONT)
    moment = time.monotonic()
    return place.client.pose_after(moment) - moment


def client_frozen(place: Place) -> float:
    """The client's program stopped for 2 s: what waited for it is not handed out as fresh."""
    place.client.process.send_signal(signal.SIGSTOP)
    time.sleep(2.0)
    place.client.process.send_signal(signal.SIGCONT)
    moment = time.monotonic()
    return place.client.pose_after(moment) - moment


def forged(place: Place) -> float:
    """Another client puts poses, presence and rig replies under the server's keys for a second."""
    with zenoh.open(client_config(place.endpoint)) as session:
        payload = encode_odometry(ROBOT_POSE)
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            session.put(keys.odometry(CAMERA, ROBOT), payload)
            time.sleep(0.005)
    moment = time.monotonic()
    return place.client.pose_after(moment) - moment


def silent_connections(place: Place) -> float:
    """300 connections that say nothing: how long until a new client has a pose."""
    host, port = place.endpoint.removeprefix("tcp/").split(":")
    with ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(socket.create_connection((host, int(port))))
        moment = time.monotonic()
        client = Client(place.endpoint)
        stack.callback(client.end)
        up = client.pose_after(0.0)
        return up - max(moment, next(line["up"] for line in client.lines if "up" in line))


def reloaded(place: Place) -> float:
    """SIGHUP: the rig is read again."""
    place.server.process.send_signal(signal.SIGHUP)
    moment = time.monotonic()
    return place.client.pose_after(moment) - moment


def interrupted_twice(place: Place) -> float:
    """Ctrl-C twice, and started again."""
    session = place.client.session()
    for _ in range(2):
        place.server.process.send_signal(signal.SIGINT)
    assert place.server.process.wait(60) == 0
    place.server.collect()
    assert not list(place.folder.rglob(".reserve"))
    moment = time.monotonic()
    place.server.start()
    return place.client.pose_after(moment, session) - moment


def taken_name(place: Place) -> float:
    """A second server of the camera at the same place is refused."""
    done = asterism("serve", DEMO_RIG, "sim", "--listen", place.endpoint)
    assert done.returncode == 2, done.stderr
    moment = time.monotonic()
    return place.client.pose_after(moment) - moment


FAULTS: dict[str, Callable[[Place], float]] = {
    f.__name__: f
    for f in (killed, frozen, client_frozen, forged, silent_connections, reloaded, interrupted_twice, taken_name)
}


class Judged(NamedTuple):
    """What a round showed."""

    back_s: float
    wrong: int
    old: int
    tracebacks: int
    lost_s: float  # of the recording, where a server was killed


def judge(place: Place, back_s: float) -> Judged:
    place.server.end()
    errors = place.server.said + place.client.end()
    rig = load_rig(DEMO_RIG)
    scene, T_world_camera = Scene(rig, 0), rig.T_world_camera
    assert T_world_camera is not None
    wrong = old = 0
    for line in place.client.lines:
        if "sequence" not in line:
            continue
        truth = scene.truth(line["sequence"], line["sequence"] / RATE_HZ)
        right = T_world_camera.map(next(t.T_camera_robot.position for t in truth if t.robot == ROBOT)[None])[0]
        wrong += bool(np.linalg.norm(np.subtract(line["position"], right)) > WRONG_M)
        old += (line["wall"] - line["exposed"]) * 1e-9 > OLDEST_S
    told = [(line["session"], line["exposed"]) for line in place.client.lines if "exposed" in line]
    lost = max((_lost_s(folder, told) for folder in place.folder.iterdir()), default=0.0)
    return Judged(back_s, wrong, old, errors.count("Traceback"), lost)


def _lost_s(folder: Path, told: list[tuple[int, int]]) -> float:
    """How much longer the client was told poses of a session than the recording holds, s; it is recovered first."""
    asterism("recover", folder)
    last: dict[int, int] = {}
    for message in Recording(folder).messages():
        if message.kind.schema == FRAME_REPORT.schema:
            last[decode_frame_report(message.payload).session] = message.log_ns
    return max([(exposed - last[session]) * 1e-9 for session, exposed in told if session in last] or [0.0])


def main() -> None:
    """Do it, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rounds", type=int, nargs="?", default=5)
    parser.add_argument("name", nargs="?", choices=FAULTS)
    options = parser.parse_args()
    table = Table(box=None)
    for heading in ("fault", "rounds", "back, median s", "worst s", "wrong", "old", "tracebacks", "recording lost s"):
        table.add_column(heading, justify="left" if heading == "fault" else "right")
    for name in [options.name] if options.name else list(FAULTS):
        rounds = []
        for _ in range(options.rounds):
            with served() as place:
                rounds.append(judge(place, FAULTS[name](place)))
        backs = [r.back_s for r in rounds]
        counts = [str(sum(of)) for of in zip(*((r.wrong, r.old, r.tracebacks) for r in rounds), strict=True)]
        times = [f"{s:.2f}" for s in (statistics.median(backs), max(backs), max(r.lost_s for r in rounds))]
        table.add_row(name, str(len(rounds)), *times[:2], *counts, times[2])
        print(name, [f"{b:.2f}" for b in backs], rounds[-1], flush=True)
    Console(width=120).print(table)


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    main()
