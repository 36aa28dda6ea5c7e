"""How messages flow past one machine: `python -m tests.measure.flow bytes|router|tree|many [--seconds S]`.

Real zenoh routers and sessions over loopback, payloads of the size that the codec gives, put as `serve` puts them.

- `bytes`: the size of every message by the number of robots, what a camera and a robot's link need with it, and what a
  recording takes.
- `router`: one router, more and more cameras of ten robots; every robot hears itself alone; with and without a desk
  that hears all. Messages in and out, the router's processor time for each, latency, losses.
- `tree`: two halls with a router each, linked to a site's: what passes between them by who listens where.
- `many`: one router and more and more robots that wait for poses: its memory and its time for a message.

Processor times are those that the kernel counts for the router's process, so they hold on a busy machine; latencies do
not.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tests.measure.flow_parts import Part
from tests.measure.message_bytes import Sizes, sizes
from tests.servers import free_endpoint

RATE_HZ, ROBOTS = 60.0, 10
CAMERAS = (1, 4, 8, 16, 32)
WAITING = (0, 1000, 3000, 10_000)
SETTLE_S = 1.0
TICKS = os.sysconf("SC_CLK_TCK")


def main() -> None:
    """One of the tables."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.flow")
    parser.add_argument("what", choices=("bytes", "router", "tree", "many"))
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    console = Console(width=100)
    if options.what == "bytes":
        console.print(_bytes())
        return
    table = {"router": _router, "tree": _tree, "many": _many}[options.what](options.seconds)
    console.print(table)


def _bytes() -> Table:
    table = _table(
        "payloads, bytes", "robots", "found", "odometry", "frame", "beat", "status", "rig reply", "a camera, kB/s",
        "a robot, kB/s", "recorded, MB/h",
    )  # fmt: skip
    for robots in (1, 5, 10, 20):
        size = sizes(robots)
        camera = RATE_HZ * (robots * size.odometry + size.frame) + 5 * size.beat + size.status
        cells = (size.odometry, size.frame, size.beat, size.status, size.rig)
        table.add_row(
            str(robots), f"{size.found:.1f}", *(f"{cell}" for cell in cells), f"{camera / 1e3:.0f}",
            f"{RATE_HZ * size.odometry / 1e3:.1f}", f"{RATE_HZ * 3600 * size.recorded / 1e6:.0f}",
        )  # fmt: skip
    return table


def _router(seconds: float) -> Table:
    table = _table(
        f"one router, cameras of {ROBOTS} robots at {RATE_HZ:g} Hz", "cameras", "desk", "in /s", "out /s", "MB/s out",
        "CPU %", "us a message", "robots p50 ms", "p99", "lost %", "desk lost %",
    )  # fmt: skip
    size = sizes(ROBOTS)
    for desk in (False, True):
        for cameras in CAMERAS:
            _row(table, _loaded(size, cameras, desk, seconds))
    return table


def _loaded(size: Sizes, cameras: int, desk: bool, seconds: float) -> list[str]:
    with ExitStack() as stack:
        endpoint = free_endpoint()
        router = _part(stack, "router", listen=[endpoint], connect=[])
        listening = [(endpoint, [f"asterism/*/robot/{robot}/odometry"]) for robot in _robots(0, cameras)]
        robots = _part(stack, "subscribers", subscribers=listening)
        everything = _part(stack, "subscribers", subscribers=[(endpoint, ["asterism/**"])] if desk else [])
        shown = [(endpoint, f"c{k}", _robots(k, 1)) for k in range(cameras)]
        sending = _part(stack, "cameras", cameras=shown, rate=RATE_HZ, bytes=[size.frame, size.odometry])
        time.sleep(SETTLE_S)
        busy = _busy_s(router.pid)
        sent = sending.ask(str(seconds))
        time.sleep(SETTLE_S)
        busy = _busy_s(router.pid) - busy
        heard, all_heard = robots.ask(""), everything.ask("")
    came = sent["frames"] * (ROBOTS + 1)
    out, took = heard["messages"] + all_heard["messages"], sent["seconds"]
    return [
        str(cameras), "yes" if desk else "no", f"{came / took:.0f}", f"{out / took:.0f}",
        f"{(heard['bytes'] + all_heard['bytes']) / took / 1e6:.1f}", f"{100 * busy / took:.0f}",
        f"{1e6 * busy / (came + out):.1f}", f"{heard['p50']:.1f}", f"{heard['p99']:.1f}",
        f"{100 * (1 - heard['messages'] / (sent['frames'] * ROBOTS)):.2f}",
        f"{100 * (1 - all_heard['messages'] / came):.2f}" if desk else "",
    ]  # fmt: skip


def _tree(seconds: float) -> Table:
    table = _table(
        f"two halls of two cameras with {ROBOTS} robots each, {RATE_HZ:g} Hz; kB/s", "who listens", "hall A to site",
        "site to hall B", "a robot's link", "of it poses",
    )  # fmt: skip
    for name, at_site, in_b in (
        ("robots, each in its hall", [], []),
        ("and a robot of A that is in hall B", [], ["asterism/*/robot/r0-0/odometry"]),
        ("and at the site: one robot's poses", ["asterism/*/robot/r0-0/odometry"], []),
        ("and at the site: all poses", ["asterism/*/robot/*/odometry"], []),
        ("and at the site: frame reports", ["asterism/*/frame"], []),
        ("and at the site: asterism/**", ["asterism/**"], []),
    ):
        _row(table, [name, *_halls(at_site, in_b, seconds)])
    return table


def _halls(at_site: list[str], in_b: list[str], seconds: float) -> list[str]:
    size = sizes(ROBOTS)
    with ExitStack() as stack:
        site, hall_a, hall_b = (free_endpoint() for _ in range(3))
        _part(stack, "router", listen=[site], connect=[])
        halls = [_part(stack, "router", listen=[hall], connect=[site]) for hall in (hall_a, hall_b)]
        ours = [
            (hall, [f"asterism/*/robot/{r}/odometry"]) for k, hall in ((0, hall_a), (2, hall_b)) for r in _robots(k, 2)
        ]
        robots = _part(stack, "subscribers", subscribers=ours)
        _part(stack, "subscribers", subscribers=[(site, at_site), (hall_b, in_b)])
        shown = [(hall, f"c{k}", _robots(k, 1)) for k, hall in enumerate((hall_a, hall_a, hall_b, hall_b))]
        sending = _part(stack, "cameras", cameras=shown, rate=RATE_HZ, bytes=[size.frame, size.odometry])
        time.sleep(SETTLE_S)
        robots.ask("")
        before = [_sent(site, halls[0].pid, False), _sent(site, halls[1].pid, True), _sent(hall_a, robots.pid, True)]
        took = sending.ask(str(seconds))["seconds"]
        after = [_sent(site, halls[0].pid, False), _sent(site, halls[1].pid, True), _sent(hall_a, robots.pid, True)]
        heard = robots.ask("")
    to_site, to_b, to_robots = ((b - a) / took / 1e3 for a, b in zip(before, after, strict=True))
    robot = to_robots / (2 * ROBOTS)
    return [f"{to_site:.1f}", f"{to_b:.1f}", f"{robot:.1f}", f"{heard['bytes'] / len(ours) / took / 1e3:.1f}"]


def _many(seconds: float) -> Table:
    table = _table(
        f"one router, 4 cameras of {ROBOTS} robots at {RATE_HZ:g} Hz, robots that wait for poses of their own",
        "waiting", "declared in, s", "router MB", "us a message", "p50 ms", "p99",
    )  # fmt: skip
    size = sizes(ROBOTS)
    for waiting in WAITING:
        _row(table, _waited(size, waiting, seconds))
    return table


def _waited(size: Sizes, waiting: int, seconds: float) -> list[str]:
    """The robots that wait share sessions, a hundred each: what is measured is their key expressions."""
    with ExitStack() as stack:
        endpoint, cameras = free_endpoint(), 4
        router = _part(stack, "router", listen=[endpoint], connect=[])
        began = time.monotonic()
        idle = [f"asterism/*/robot/w{k}/odometry" for k in range(waiting)]
        _part(stack, "subscribers", subscribers=[(endpoint, idle[k : k + 100]) for k in range(0, waiting, 100)])
        declared = time.monotonic() - began
        listening = [(endpoint, [f"asterism/*/robot/{robot}/odometry"]) for robot in _robots(0, cameras)]
        robots = _part(stack, "subscribers", subscribers=listening)
        shown = [(endpoint, f"c{k}", _robots(k, 1)) for k in range(cameras)]
        sending = _part(stack, "cameras", cameras=shown, rate=RATE_HZ, bytes=[size.frame, size.odometry])
        time.sleep(SETTLE_S)
        busy = _busy_s(router.pid)
        sent = sending.ask(str(seconds))
        time.sleep(SETTLE_S)
        busy = _busy_s(router.pid) - busy
        memory, heard = _memory_mb(router.pid), robots.ask("")
    passed = sent["frames"] * (ROBOTS + 1) + heard["messages"]
    return [
        str(waiting), f"{declared:.1f}", f"{memory:.0f}", f"{1e6 * busy / passed:.1f}", f"{heard['p50']:.1f}",
        f"{heard['p99']:.1f}",
    ]  # fmt: skip


def _row(table: Table, cells: list[str]) -> None:
    """A row of the table, told while the others are measured."""
    print("  ".join(cells), file=sys.stderr, flush=True)
    table.add_row(*cells)


def _part(stack: ExitStack, name: str, **asked: Any) -> Part:
    part = Part(name, **asked)
    stack.callback(part.close)
    return part


def _robots(camera: int, cameras: int) -> list[str]:
    """Those that so many cameras see, of this one on."""
    return [f"r{k}-{number}" for k in range(camera, camera + cameras) for number in range(ROBOTS)]


def _busy_s(pid: int) -> float:
    """Processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def _memory_mb(pid: int) -> float:
    found = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    assert found is not None
    return int(found[1]) / 1e3


def _sent(endpoint: str, pid: int, to_it: bool) -> int:
    """Bytes over TCP between who listens at an endpoint and a process that joined: to it, or from it."""
    port, total = endpoint.rpartition(":")[2], 0
    told = subprocess.run(["ss", "-tinpHO", f"dport = :{port}"], stdout=subprocess.PIPE, text=True, check=True).stdout
    for line in told.splitlines():
        if f"pid={pid}," in line:
            found = re.search(rf"bytes_{'received' if to_it else 'sent'}:(\d+)", line)
            total += int(found[1]) if found else 0
    return total


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, box=None, header_style="bold", padding=(0, 1))
    for column in columns:
        table.add_column(column, justify="left" if column in ("who listens", "desk") else "right")
    return table


if __name__ == "__main__":
    main()
