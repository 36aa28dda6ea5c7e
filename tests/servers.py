"""Servers and subscribers in processes of their own, on free ports, for end-to-end tests."""

import contextlib
import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zenoh

from tests.helpers import REPOSITORY

TIMEOUT_S = 120.0


def free_endpoint() -> str:
    """A loopback endpoint that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def asterism(*arguments: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    command = [sys.executable, "-m", "asterism.server", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, **options)


@contextlib.contextmanager
def running(*arguments: str | Path) -> Iterator[subprocess.Popen[str]]:
    """The command line, running beside the test."""
    command = [sys.executable, "-m", "asterism.server", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        process.communicate(timeout=30)


def wait_for_line(process: subprocess.Popen[str], words: str) -> str:
    """Read the process' error channel until a line holds the words."""
    assert process.stderr is not None
    for line in process.stderr:
        if words in line:
            return line
    raise AssertionError(f"the process ended without saying {words!r}")


class Subscriber:
    """tests/service/plain_subscriber.py in a process of its own: zenoh and the Foxglove schema, nothing of Asterism."""

    def __init__(self, endpoint: str, out: Path, expression: str = "asterism/**") -> None:
        self._out = out
        command = [
            sys.executable,
            str(REPOSITORY / "tests" / "service" / "plain_subscriber.py"),
            endpoint,
            str(out),
            expression,
        ]
        while True:
            # A zenoh client whose server is not there yet gives up at once: try again.
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            )
            assert self._process.stdout is not None
            if self._process.stdout.readline().strip() == "ready":
                break
            self._process.communicate()

    def finish(self) -> list[dict[str, Any]]:
        """What it received by the time the server's liveliness token went."""
        self._process.wait(timeout=TIMEOUT_S)
        self._process.communicate()  # closes the pipes
        return [json.loads(line) for line in self._out.read_text().splitlines()]


@contextlib.contextmanager
def open_router() -> Iterator[tuple[str, zenoh.Session]]:
    """A zenoh router in this process, as an existing infrastructure would have: its endpoint and session."""
    endpoint, config = free_endpoint(), zenoh.Config()
    for key, value in (
        ("mode", '"router"'),
        ("listen/endpoints", json.dumps([endpoint])),
        ("scouting/multicast/enabled", "false"),
    ):
        config.insert_json5(key, value)
    session = zenoh.open(config)
    try:
        yield endpoint, session
    finally:
        session.close()
