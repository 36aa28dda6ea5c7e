"""How soon drift is said, and how often wrongly: `python -m tests.measure.drift [--seeds N] [--hours H]`.

Frames without pixels (tests/measure/drawn_frames.py: errors that are not white, robots that drive, stand, leave),
solved by the chain's solver, watched by what `serve` watches with. First a fault four minutes after the start, once a
seed, ten frames a second (what `serve` keeps of 60): s until it is said, median and worst; how often it was named
right; what else was said. Then hours of nothing wrong, two frames a second: false alarms; and what it costs, of
processor time: us of the loop a frame that is kept, ms of the other thread a second.
"""

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.server.service.drift import Drift
from tests.measure.drawn_frames import Fault, Stage, stage_rig

AT_S, WATCHED_S = 240.0, 90
ROBOTS = 3


def turned(rng: np.random.Generator, size: float) -> Fault:
    """The camera tilted by ``size`` degrees about an axis across its view."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return Fault(AT_S, turn=np.radians(size) * np.array([np.cos(angle), np.sin(angle), 0.0]))


def bent(rng: np.random.Generator, size: float, fixed: int) -> Fault:
    """An LED of a robot moved by ``size`` m in its plate."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    led = fixed + int(rng.integers(ROBOTS)), int(rng.integers(6))
    return Fault(AT_S, led=led, moved=size * np.array([np.cos(angle), np.sin(angle), 0.0]))


def dark(rng: np.random.Generator, fixed: int) -> Fault:
    """An LED of a robot that drives."""
    return Fault(AT_S, led=(fixed + int(rng.integers(ROBOTS)), int(rng.integers(6))), dark=True)


def moved(rng: np.random.Generator, size: float) -> Fault:
    """A fixed constellation moved by ``size`` m."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return Fault(AT_S, fixed=0, fixed_moved=size * np.array([np.cos(angle), np.sin(angle), 0.0]))


# What goes wrong; how many constellations are fixed; what robots do; what must be said.
Kind = tuple[Callable[[np.random.Generator], Fault], int, str, str]
KINDS: dict[str, Kind] = {
    "lens turned, 0.05 % of f": (lambda rng: Fault(AT_S, focal=float(rng.choice([-5e-4, 5e-4]))), 3, "", "the lens"),
    "the same, two fixed": (lambda rng: Fault(AT_S, focal=float(rng.choice([-5e-4, 5e-4]))), 2, "", "the lens"),
    "camera tilted, 0.02 deg": (lambda rng: turned(rng, 0.02), 3, "", "the camera"),
    "the same, one fixed": (lambda rng: turned(rng, 0.02), 1, "", "the camera"),
    "LED 0.1 mm, robots drive": (lambda rng: bent(rng, 1e-4, 2), 2, "drive", "LED"),
    "LED 0.1 mm, robots stand": (lambda rng: bent(rng, 1e-4, 2), 2, "stand", "LED"),
    "LED dark, robots drive": (lambda rng: dark(rng, 2), 2, "drive", "not seen"),
    "fixed one moved, 0.5 mm": (lambda rng: moved(rng, 5e-4), 3, "", "r00, which"),
}


def watched(kind: Kind, seed: int) -> tuple[float, bool, int]:
    """One fault: s until anything was said (nan: nothing was), whether that was right, and what was said beside it."""
    make, fixed, always, right = kind
    fault = make(np.random.default_rng([seed, 91]))
    stage = Stage(stage_rig(ROBOTS, fixed, seed), seed, fault, always)
    said: list[tuple[float, str]] = []
    now = 0.0
    drift = Drift(stage.told, lambda text: said.append((now, text)))
    while now < AT_S + WATCHED_S:
        for _ in range(10):
            now += 0.1
            drift.add(stage.frame(now))
        drift.look()
    mine = [(when, text) for when, text in said if right in text and when > AT_S]
    if "LED" in right or "seen" in right:
        mine = [(when, text) for when, text in mine if f"r{fault.led[0]:02d}: LED {fault.led[1]} " in text]
    return (mine[0][0] - AT_S if mine else np.nan), bool(mine), len(said) - len(mine[:1])


def faults(kinds: list[str], seeds: int, console: Console) -> None:
    """The table of faults."""
    table = Table(title=f"{seeds} of each", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("fault", "said after s: median", "worst", "named right", "said beside"):
        table.add_column(heading, justify="left" if heading == "fault" else "right", no_wrap=True)
    for name in track(kinds, description="watching", transient=True):
        rows = [watched(KINDS[name], seed) for seed in range(seeds)]
        delays = np.array([row[0] for row in rows])
        right = sum(row[1] for row in rows)
        worst = f"{np.nanmax(delays):.0f}" if right == seeds else "-"
        table.add_row(name, f"{np.nanmedian(delays):.0f}", worst, f"{right}/{seeds}", str(sum(row[2] for row in rows)))
    console.print(table)


def healthy(hours: float, seeds: int, console: Console) -> None:
    """Hours of nothing wrong, and what it costs."""
    for seed in range(seeds):
        fixed = (3, 0, 1)[seed % 3]
        stage = Stage(stage_rig(ROBOTS, fixed, seed), seed)
        said: list[str] = []
        drift = Drift(stage.told, said.append)
        adding = looking = 0.0
        seconds = round(3600.0 * hours)
        for second in track(range(seconds), description="nothing wrong", transient=True):
            for half in range(2):
                result = stage.frame(second + 0.5 * half)
                began = time.thread_time()
                drift.add(result)
                adding += time.thread_time() - began
            began = time.thread_time()
            drift.look()
            looking += time.thread_time() - began
        robots = f"{ROBOTS} robots, {fixed} fixed"
        console.print(
            f"seed {seed}, {robots}, {hours:g} h: {len(said)} said; {1e6 * adding / seconds / 2:.1f} us a kept frame, "
            f"{1e3 * looking / seconds:.2f} ms a second"
        )
        for text in said:
            console.print(f"  {text}")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.drift")
    parser.add_argument("--seeds", type=int, default=10, help="of every fault")
    parser.add_argument("--hours", type=float, default=24.0, help="of nothing wrong; 0: none")
    parser.add_argument("--days", type=int, default=3, help="seeds of those hours")
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    options = parser.parse_args()
    console = Console(width=140)
    if options.seeds:
        faults(options.kinds, options.seeds, console)
    if options.hours:
        healthy(options.hours, options.days, console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
