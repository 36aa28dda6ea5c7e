"""What runs on the hosts of `tests.measure.hosts`: commands as a person gives them, a robot, and who watches it all."""

import json
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.measure.host_net import Host

TIMEOUT_S = 120.0
Line = dict[str, Any]
Tell = Callable[[str, str], None]  # a host's name, and what is said there

# A robot: every pose as it arrives, with its age as told and as it is (all hosts here have one clock), and its link.
ROBOT = r"""
import json, sys, time
from asterism.clients import PoseClient
endpoint, camera, robot = sys.argv[1:]
with PoseClient(endpoint, camera=camera) as robots:
    feed, before = robots[robot], None
    def tell(**told): sys.stdout.write(json.dumps(told) + "\n")
    while True:
        pose, at = feed.wait(0.02), time.monotonic()
        if pose is not None:
            told, true = pose.age_s, (time.time_ns() - pose.exposed_ns) * 1e-9
            tell(at=at, exposed=pose.exposed_ns, told=told, true=true)
        link = robots.link
        if link.state != before:
            before = link.state
            tell(at=at, link=link.state.value, sentence=link.sentence)
"""

# Every report and status of every camera, and of fused poses, with plain zenoh.
OBSERVER = r"""
import json, sys, time, zenoh
from asterism.protocol.codec import decode_frame_report, decode_status
from asterism.protocol.network import client_config
def tell(**told): sys.stdout.write(json.dumps({"at": time.monotonic(), **told}) + "\n")  # whole: of several threads
def frame(sample):
    report = decode_frame_report(sample.payload.to_bytes())
    found = {robot.id: list(robot.cameras) for robot in report.robots if robot.HasField("pose")}
    tell(camera=str(sample.key_expr).split("/")[1], sequence=report.sequence, session=report.session,
        exposed=report.exposed_ns, robots=found)
def status(sample):
    told = decode_status(sample.payload.to_bytes())
    tell(status=str(sample.key_expr).split("/")[1], problem=told.problem)
while True:
    try:
        session = zenoh.open(client_config(sys.argv[1]))
        break
    except zenoh.ZError:
        time.sleep(0.1)
held = session.declare_subscriber("asterism/*/frame", frame), session.declare_subscriber("asterism/*/status", status)
time.sleep(1e6)
"""


class Program:
    """One that runs on a host. Its lines of JSON are kept, and what it says on its error channel is told."""

    def __init__(self, host: Host, tell: Tell, *words: "str | Path", env: dict[str, str] | None = None) -> None:
        self.host = host
        self.lines: list[Line] = []
        self.said: list[tuple[float, str]] = []
        self._tell = tell
        self._changed = threading.Condition()
        self.process = host.start(*words, env=env)
        self._threads = [threading.Thread(target=work) for work in (self._read, self._hear)]
        for thread in self._threads:
            thread.start()

    def until(self, wanted: Callable[[Line], bool], since: float = 0.0) -> float:
        """When the first line of that kind came, after a moment (monotonic, s); waited for. Raises AssertionError where
        none comes.
        """
        at = 0
        with self._changed:

            def look() -> bool:
                nonlocal at
                while at < len(self.lines) and not (self.lines[at]["at"] >= since and wanted(self.lines[at])):
                    at += 1
                return at < len(self.lines)

            assert self._changed.wait_for(look, TIMEOUT_S), f"{self.host.name}: it did not come about"
            return float(self.lines[at]["at"])

    def until_said(self, words: str) -> None:
        """Wait until it says that. Raises AssertionError where it never does."""
        end = time.monotonic() + TIMEOUT_S
        with self._changed:
            while not any(words in text for _, text in self.said):
                assert time.monotonic() < end, f"it never said {words!r}"
                assert self.process.poll() is None, f"it ended without saying {words!r}"
                self._changed.wait(0.5)

    def between(self, begin: float, end: float) -> list[Line]:
        """The lines that came in that time."""
        with self._changed:
            return [line for line in self.lines if begin <= line["at"] < end]

    def kill(self) -> None:
        """As a host does that loses its power."""
        self.process.kill()
        self._join()

    def end(self) -> None:
        """In order, if it still runs."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(30)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self._join()

    def _join(self) -> None:
        self.process.wait()
        for thread in self._threads:
            thread.join()
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for text in self.process.stdout:
            if text.startswith("{"):
                with self._changed:
                    self.lines.append(json.loads(text))
                    self._changed.notify_all()
            else:
                self._tell(self.host.name, text.rstrip())

    def _hear(self) -> None:
        assert self.process.stderr is not None
        for text in self.process.stderr:
            line = text.rstrip()
            with self._changed:
                self.said.append((time.monotonic(), line))
                self._changed.notify_all()
            self._tell(self.host.name, line)
