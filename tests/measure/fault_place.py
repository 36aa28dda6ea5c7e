"""A running server and a client in processes of their own, for `tests.measure.faults`, and what they say."""

import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.clients.proxy import Proxy
from tests.measure.fault_clock import SteppedClock
from tests.servers import free_endpoint

ROBOT, CAMERA = "alpha", "demo"
WARM = 120  # frames before a fault
TIMEOUT_S = 60.0
DISK_BYTES = 128 << 20
# Of the simulated camera every twentieth frame, which is 4 MB/s: a program of many rounds must fit on a disk.
RECORDED = "20"

CLIENT = """
import json, sys, time
from asterism.clients import PoseClient
with PoseClient(sys.argv[1]) as robots:
    feed, before = robots["alpha"], None
    print(json.dumps({"at": time.monotonic(), "up": True}), flush=True)
    while True:
        asked = {"at": time.monotonic(), "wall": time.time_ns()}  # should it be stopped behind this
        pose = feed.latest(0.1)
        state = robots.link.state.name
        told = None if pose is None else (pose.session, pose.sequence)
        if (told, state) != before:
            before = told, state
            line = {**asked, "state": state}
            if pose is not None:
                line |= {"sequence": pose.sequence, "session": pose.session, "exposed": pose.exposed_ns,
                         "position": pose.position.tolist()}
            print(json.dumps(line), flush=True)
        time.sleep(0.002)
"""

ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config):
    print("ready", flush=True)
    sys.stdin.read()
"""

SUBSCRIBER = """
import sys, zenoh
from pathlib import Path
from asterism.protocol.network import client_config
count = 0
def hear(sample):
    global count
    count += 1
with zenoh.open(client_config(sys.argv[1])) as session:
    session.declare_subscriber("asterism/**", hear)
    print("ready", flush=True)
    sys.stdin.read()
print(count)
"""


def start(program: str, *arguments: str) -> "subprocess.Popen[str]":
    """A Python program in a process of its own, once it says that it is ready."""
    process = subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


class Client:
    """A program with a PoseClient, and what it was handed."""

    def __init__(self, endpoint: str) -> None:
        self.lines: list[dict[str, Any]] = []
        self._changed = threading.Condition()
        self.process = subprocess.Popen(
            [sys.executable, "-c", CLIENT, endpoint], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._changed:
                self.lines.append(json.loads(line))
                self._changed.notify_all()

    def first_after(self, moment: float, wanted: Callable[[dict[str, Any]], bool], what: str) -> float:
        """When the first line of that kind came after a moment (monotonic, s)."""
        with self._changed:
            at = bisect_right(self.lines, moment, key=lambda line: line["at"])

            def look() -> bool:
                nonlocal at
                while at < len(self.lines) and not wanted(self.lines[at]):
                    at += 1
                return at < len(self.lines)

            assert self._changed.wait_for(look, TIMEOUT_S), f"{what} did not come"
            return float(self.lines[at]["at"])

    def up(self) -> float:
        """When its PoseClient was made."""
        return self.first_after(0.0, lambda line: "up" in line, "the client")

    def pose_after(self, moment: float, session_not: int | None = None) -> float:
        """When the first pose, of another session than that, was handed out after a moment."""
        return self.first_after(moment, lambda line: line.get("session", session_not) != session_not, "a pose")

    def state_after(self, moment: float, state: str) -> float:
        """When it told that state first after a moment."""
        return self.first_after(moment, lambda line: line.get("state") == state, state)

    def until_warm(self) -> None:
        """Wait until the server that it hears has run for a while."""
        self.first_after(time.monotonic(), lambda line: line.get("sequence", 0) >= WARM, f"frame {WARM}")

    def longest_gap_s(self, since: float) -> float:
        """The longest time without a new pose, from a moment on."""
        with self._changed:
            times = [line["at"] for line in self.lines if "sequence" in line and line["at"] >= since]
        return max(after - before for before, after in zip([since, *times], [*times, time.monotonic()], strict=True))

    def session(self) -> int:
        """The server's session, of the newest pose."""
        with self._changed:
            return int(next(line["session"] for line in reversed(self.lines) if "session" in line))

    def end(self) -> str:
        """End it; returns what it wrote on its error channel."""
        assert self.process.stderr is not None
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        self.process.wait(30)
        self._thread.join()
        with self.process.stderr as errors:
            return errors.read()


@dataclass
class Server:
    """`asterism serve sim --record`, and what it says. ``log`` is where: a file that is read, or /dev/full."""

    rig: Path
    place: list[str]
    folder: Path
    log: Path
    environment: dict[str, str] | None = None
    code: int = 0  # with which it ends in order

    def start(self) -> None:
        """Begin, or begin again."""
        words = ["serve", self.rig, "sim", *self.place, "--record", self.folder, "--record-frames", RECORDED]
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "asterism.server", *words],
                stdout=subprocess.DEVNULL,
                stderr=log,
                env=self.environment,
            )

    def said(self) -> str:
        """All that it has said by now."""
        return self.log.read_text() if self.log.is_file() else ""

    def until_said(self, words: str, since: int) -> None:
        """Wait until it says that, behind so many characters."""
        end = time.monotonic() + TIMEOUT_S
        while words not in self.said()[since:]:
            assert time.monotonic() < end, f"it never said {words!r}"
            time.sleep(0.01)

    def kill(self) -> None:
        """As the kernel does where memory runs out."""
        self.process.kill()
        self.process.wait()

    def end(self) -> None:
        """In order. Raises AssertionError where it did not end so."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
        code = self.process.wait(60)
        assert code == self.code, f"it ended with exit code {code}"


@dataclass(frozen=True)
class Setting:
    """What a fault needs beside a server and a client."""

    router: bool = False  # both are clients of a zenoh router, of a process of its own
    link: bool = False  # the client comes in over a link that can be made bad
    small_disk: bool = False  # the recordings have a disk of their own (mounted by root)
    log: str = ""  # where the server's words go; else a file
    clock: bool = False  # the server's clock can be stepped


@dataclass
class Place:
    """A running server with a client that has had poses."""

    server: Server
    client: Client
    endpoint: str  # the server's, or the router's
    folder: Path  # of the recordings
    router: "subprocess.Popen[str] | None" = None
    link: Proxy | None = None
    clock: SteppedClock | None = None
    errors: list[str] = field(default_factory=list)  # what other programs wrote on their error channels


@contextmanager
def served(setting: Setting) -> Iterator[Place]:
    """A place with that setting; the server has run for a while."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for file in DEMO_RIG.parent.glob("*.yaml"):
            (folder / file.name).write_text(file.read_text())
        recordings = folder / "recordings"
        recordings.mkdir()
        if setting.small_disk:
            size = f"size={DISK_BYTES}"
            subprocess.run(["mount", "-t", "tmpfs", "-o", size, "none", recordings], check=True)
            stack.callback(subprocess.run, ["umount", "-l", recordings], check=True)
        endpoint = free_endpoint()
        clock = SteppedClock(folder) if setting.clock else None
        server = Server(
            folder / DEMO_RIG.name,
            ["--connect" if setting.router else "--listen", endpoint],
            recordings,
            Path(setting.log or folder / "said"),
            None if clock is None else clock.environment,
            int(setting.small_disk),  # it says in the end that something is missing
        )
        router = start(ROUTER, endpoint) if setting.router else None
        server.start()
        stack.callback(_make_sure, server)
        # With a window smaller than a segment the kernel may go on only after seconds, when it probes the window again.
        link = stack.enter_context(Proxy(endpoint, buffer=None)) if setting.link else None
        client = Client(endpoint if link is None else link.endpoint)
        stack.callback(client.process.kill)
        place = Place(server, client, endpoint, recordings, router, link, clock)
        stack.callback(_end_router, place)
        client.until_warm()
        yield place


def _make_sure(server: Server) -> None:
    server.process.kill()
    server.process.wait()


def _end_router(place: Place) -> None:
    if place.router is not None:
        place.router.kill()
        place.router.communicate()
