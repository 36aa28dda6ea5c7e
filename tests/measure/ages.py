"""Are ages of poses true, over links that are not good: `python -m tests.measure.ages [--seconds 20]`.

`asterism serve` plays the demo's five robots at 60 Hz; a client reads through a TCP link that is whole, stands still
for 5 s again and again, or carries 60 kB/s. Every 2 ms it asks for a pose of at most 0.1 s; its true age is the
machine's clock, which stamps and client share here, less its exposure. Then five days of clocks that drift apart are
simulated, servers are frozen and killed, and programs are started before their server, to see how they end.
"""

import argparse
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.clients import LinkState, PoseClient
from asterism.clients.age import SessionAge
from asterism.protocol.rig import load_rig
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.clients.proxy import Proxy
from tests.clients.serving import until
from tests.clients.test_age import DAY_S, Clocks
from tests.clients.test_link import FROZEN, PROGRAM
from tests.helpers import REPOSITORY
from tests.servers import free_endpoint, running

STALL_S, PAUSE_S = 5.0, 3.0
LOOK_S = 0.002
TOGETHER = 8  # programs that run at once


@dataclass
class Seen:
    """What a client was given: true ages of what `latest(0.1)` handed out, s, and by how much it told them older."""

    looks: int = 0
    ages_s: list[float] = field(default_factory=list)
    errors_s: list[float] = field(default_factory=list)
    late: int = 0
    states: Counter[str] = field(default_factory=Counter)


def watched(endpoint: str, seconds: float, everyone: bool) -> Seen:
    """Ask a client again and again for what is fresh."""
    seen = Seen()
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        if everyone:
            robots.all()
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            before_ns = time.time_ns()
            pose = feed.latest(max_age_s=0.1)
            seen.looks += 1
            seen.states[robots.link.state.value] += 1
            if pose is not None:
                seen.ages_s.append((before_ns - pose.exposed_ns) * 1e-9)
                told_s = pose.age_s
                seen.errors_s.append(told_s - (time.time_ns() - pose.exposed_ns) * 1e-9)
            time.sleep(LOOK_S)
        seen.late = feed.late
    return seen


def stalling(proxy: Proxy, stop: threading.Event) -> None:
    """Let the link stand still again and again."""
    while not stop.wait(PAUSE_S):
        proxy.flows.clear()
        stop.wait(STALL_S)
        proxy.flows.set()


def over(endpoint: str, seconds: float, *, rate: float = 1e12, stalls: bool = False, everyone: bool = False) -> Seen:
    """A client behind a link."""
    with Proxy(endpoint, rate) as proxy:
        stop = threading.Event()
        thread = threading.Thread(target=stalling, args=(proxy, stop))
        if stalls:
            thread.start()
        try:
            return watched(proxy.endpoint, seconds, everyone)
        finally:
            stop.set()
            if stalls:
                thread.join()


def links(console: Console, seconds: float) -> None:
    endpoint = free_endpoint()
    table = Table(
        "link",
        "looks",
        "with a pose",
        "oldest given",
        "told less than true by",
        "median error",
        "late",
        "states",
        box=box.SIMPLE,
    )
    warm_up(*localizing(load_rig(DEMO_RIG)))
    with running("serve", DEMO_RIG, "sim", "--listen", endpoint):
        for name, options in (
            ("loopback", {}),
            (f"stands still for {STALL_S:.0f} s", {"stalls": True}),
            ("60 kB/s, one robot", {"rate": 60_000}),
            ("60 kB/s, six subscriptions", {"rate": 60_000, "everyone": True}),
        ):
            seen = over(endpoint, seconds, **options)  # type: ignore[arg-type]
            errors_ms = 1e3 * np.array(seen.errors_s or [np.nan])
            table.add_row(
                name,
                str(seen.looks),
                f"{100 * len(seen.ages_s) / seen.looks:.0f} %",
                f"{1e3 * max(seen.ages_s, default=0):.1f} ms",
                f"{-errors_ms.min():.2f} ms",
                f"{np.median(errors_ms):+.2f} ms",
                str(seen.late),
                ", ".join(f"{state} {100 * count / seen.looks:.0f} %" for state, count in seen.states.most_common()),
            )
    console.print(table)


def drifts(console: Console) -> None:
    rng = np.random.default_rng(1)
    table = Table("drift", "speed", "days", "told less by", "told more by", box=box.SIMPLE)
    for ppm, rate in ((-100.0, 1.0), (0.0, 1.0), (100.0, 1.0), (100.0, 10.0)):
        clocks, age = Clocks(*rng.integers(0, 10**18, 2).tolist(), ppm, rate), SessionAge(rate)
        errors = []
        for time_s in np.arange(0.0, 5.0 * DAY_S, 10.0):
            clocks.ask(age, time_s, *rng.uniform(0.0002, 0.003, 2))
            clocks.hear(age, time_s + 1.0, 5.0 if rng.random() < 0.1 else 0.001)
            errors.append(1e3 * clocks.error_s(age, time_s + rng.uniform(6.0, 10.0)) / rate)
        table.add_row(f"{ppm:+.0f} ppm", f"{rate:g}", "5", f"{-min(errors):.1f} ms", f"{max(errors):.1f} ms")
    console.print(table)


def faults(console: Console, rounds: int) -> None:
    """How soon a client says that its server is frozen, or gone, and how soon after that it has fresh poses again."""
    times: dict[str, list[float]] = defaultdict(list)
    endpoint = free_endpoint()
    command = [sys.executable, "-c", FROZEN, endpoint]
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        for _ in range(rounds):
            server = subprocess.Popen(command, cwd=REPOSITORY)
            until(lambda: feed.link.state is LinkState.LIVE)
            for number, state, told in (
                (signal.SIGSTOP, LinkState.SILENT, "frozen, told after"),
                (signal.SIGCONT, LinkState.LIVE, "thawed, fresh pose after"),
                (signal.SIGKILL, LinkState.GONE, "killed, told after"),
            ):
                start_s = time.monotonic()
                os.kill(server.pid, number)
                until(lambda state=state: feed.link.state is state)  # type: ignore[misc]
                times[told].append(time.monotonic() - start_s)
            server.wait()
            server = subprocess.Popen(command, cwd=REPOSITORY)
            until(lambda: is_alive_at(endpoint))
            start_s = time.monotonic()
            until(lambda: feed.link.state is LinkState.LIVE)
            times["started again, fresh pose after"].append(time.monotonic() - start_s)
            server.kill()
            server.wait()
            until(lambda: robots.link.state is LinkState.GONE)
    table = Table("fault", "rounds", "median", "worst", box=box.SIMPLE)
    for told, seconds in times.items():
        table.add_row(told, str(len(seconds)), f"{np.median(seconds):.2f} s", f"{max(seconds):.2f} s")
    console.print(table)


def is_alive_at(endpoint: str) -> bool:
    """Whether somebody listens there."""
    host, port = endpoint.removeprefix("tcp/").split(":")
    with socket.socket() as probe:
        return probe.connect_ex((host, int(port))) == 0


def endings(console: Console, programs: int) -> None:
    codes: Counter[str] = Counter()
    for first in range(0, programs, TOGETHER):
        endpoint = free_endpoint()
        how = ("leave", "close")[first // TOGETHER % 2]
        command = [sys.executable, "-c", PROGRAM, endpoint, how]
        started = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(min(TOGETHER, programs - first))]
        time.sleep(2.5)
        with running("serve", DEMO_RIG, "sim", "--listen", endpoint):
            codes.update(f"exit code {program.wait(60)}" for program in started)
    told = ", ".join(f"{code}: {count}" for code, count in sorted(codes.items()))
    console.print(f"{programs} programs older than their server, half of them never closed: {told}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="for each link")
    parser.add_argument("--programs", type=int, default=40)
    parser.add_argument("--rounds", type=int, default=20, help="of freezing and killing a server")
    options = parser.parse_args()
    console = Console(width=160)
    links(console, options.seconds)
    drifts(console)
    faults(console, options.rounds)
    endings(console, options.programs)


if __name__ == "__main__":
    main()
