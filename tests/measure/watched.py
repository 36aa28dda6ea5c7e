"""What it costs the chain that somebody watches, or has stopped watching:
`python -m tests.measure.watched [PAIRS] [SECONDS]`.

`asterism serve` of the demo rig (five robots, 60 Hz) before a camera that shows a film (`looped_camera`) runs for
SECONDS (default 10), by turns with nobody watching and with each kind of watcher; frame in memory to a callback in
another process is measured as in `latency`. The watchers: a headless Chromium on the page of `--web` that is stopped
(SIGSTOP) once it shows frames; a client of `--foxglove` that subscribes to everything and never reads; one that reads
everything. Printed: median and 99 % of all runs, the medians over PAIRS (default 10) of their ratios to nobody's of the
same turn, poses lost, the server's processor time a frame, and the addresses that it and what it started listen on.
"""

import contextlib
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.browser import PROGRAM, Browser
from tests.foxglove_client import FoxgloveClient
from tests.listening import family, free_ports, listening
from tests.measure.latency import RATE_HZ, Run, figures, heard
from tests.measure.looped_camera import serve_film
from tests.servers import free_endpoint

SHOWN_S = 10.0  # a browser draws, before it is stopped
FULL_S = 10.0  # until all buffers before it are full


class Watched(NamedTuple):
    """One run, and what the server listened on."""

    run: Run
    addresses: set[str]


@contextlib.contextmanager
def nobody(port: int) -> Iterator[None]:
    """Nobody watches."""
    time.sleep(FULL_S)
    yield


@contextlib.contextmanager
def stopped_browser(port: int) -> Iterator[None]:
    """It shows frames, then it is stopped."""
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        Browser(f"http://127.0.0.1:{port}", Path(profile)) as browser,
    ):
        browser.wait_for_request("ReadMessages", timeout_s=300.0)
        browser.look_on(SHOWN_S)
        browser.stop()
        time.sleep(FULL_S)
        yield


@contextlib.contextmanager
def stuck_client(port: int) -> Iterator[None]:
    """It wants everything, and reads nothing."""
    with FoxgloveClient(port) as client:
        client.wait_for(lambda: bool(client.topics))
        time.sleep(FULL_S)
        yield


@contextlib.contextmanager
def reading_client(port: int) -> Iterator[None]:
    """It wants everything, and reads it."""
    done = threading.Event()
    with FoxgloveClient(port) as client:
        reading = threading.Thread(target=lambda: client.wait_for(done.is_set, timeout_s=3600.0))
        reading.start()
        time.sleep(FULL_S)
        yield
        done.set()
        reading.join()


KINDS = {
    "nobody": ((), nobody),
    "--web, browser stopped": (("--web",), stopped_browser),
    "--foxglove, client stuck": (("--foxglove",), stuck_client),
    "--foxglove, client reads": (("--foxglove",), reading_client),
}


def run(kind: str, seconds: float, folder: Path) -> Watched:
    """Serve, watch, and listen from another process."""
    options, watch = KINDS[kind]
    endpoint, port = free_endpoint(), free_ports(2)
    ports = [str(port)] if options else []
    server = serve_film(DEMO_RIG, folder, RATE_HZ, "--listen", endpoint, *options, *ports)
    try:
        with watch(port):
            told = heard(server.pid, endpoint, seconds)
            addresses = {address for address, _ in listening(family(server.pid))}
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(timeout=60)
    return Watched(told, addresses)


def main(pairs: int = 10, seconds: float = 10.0) -> None:
    """Run by turns, and print a table."""
    kinds = [kind for kind in KINDS if PROGRAM is not None or "browser" not in kind]
    runs: dict[str, list[Run]] = {kind: [] for kind in kinds}
    addresses: set[str] = set()
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(pairs):
            for kind in kinds[:: 1 if turn % 2 == 0 else -1]:  # forwards and backwards: none always comes first
                watched = run(kind, seconds, Path(folder))
                runs[kind].append(watched.run)
                addresses |= watched.addresses
    Console(width=120).print(_table(runs))
    print("listened on:", ", ".join(sorted(addresses)), "(127.0.0.1 is 0100007F); load", os.getloadavg())


def _table(runs: dict[str, list[Run]]) -> Table:
    table = Table(box=None)
    headings = ("watched by", "poses", "lost", "p50 ms", "p99 ms", "p50 / nobody's", "p99 / nobody's", "cpu ms a frame")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == headings[0] else "right")
    for kind, told in runs.items():
        table.add_row(kind, *figures(told, runs["nobody"], (50, 99)))
    return table


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, float), sys.argv[1:], strict=False)))
