"""Three camera hosts, one that fuses, a robot on wireless, through faults: `python -m tests.measure.hosts`

Needs root: every host is a network namespace. Four are on a bridge (the hub with `asterism router` and `asterism fuse`,
and a host for each camera with `asterism serve RIG sim`); the robots' host is behind a link with 20 ms of delay, 1 % of
loss and 1 Mbit/s (`slow_link`). Then, one after another: nothing for 10 s; a camera's plug is pulled for 5 s; the
wireless link is cut as long; the router is killed and started again; a camera's host loses its power; a camera's clock
goes wrong, and is set right. Printed is a transcript, what every program says with it, and for every phase: frames that
did not arrive, the longest time without a fused pose, ages of poses at the robot as told and as they are, bytes per
second to the robot, how long after the fault's end everything was back.

All hosts have one clock but for the camera's that goes wrong: a library of ours before the C library's (`fault_clock`).
"""

import argparse
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from tests.measure.fault_clock import SteppedClock
from tests.measure.host_figures import Phase, figures
from tests.measure.host_net import HUB, HUB_IN_THE_AIR, Network, network, why_not
from tests.measure.host_programs import OBSERVER, ROBOT, Line, Program
from tests.measure.host_rigs import CAMERAS, write_rigs
from tests.measure.slow_link import Quality

WIRED, AIR = f"tcp/{HUB}:7447", f"tcp/{HUB_IN_THE_AIR}:7447"
CALM_S, SETTLE_S = 10.0, 4.0
CLOCK_OFF_S = 0.05  # more than half a frame period, from which on fuse says it
SERVER = ("-m", "asterism.server")
NOTHING = "nothing"


class Stage:
    """The network, its programs, and the transcript."""

    def __init__(self, net: Network, folder: Path, rate_hz: float, stack: ExitStack) -> None:
        self._net = net
        self._stack = stack
        self._lock = threading.Lock()
        self.began_s = time.monotonic()
        self.rigs = write_rigs(folder, rate_hz)
        self.clock = SteppedClock(folder)
        self.router = self._asterism("hub", "router", "--listen", WIRED, "--listen", AIR)
        self.router.until_said("router at")
        self.observer = self._start("hub", "-c", OBSERVER, WIRED)
        self.cameras = {name: self.camera(name) for name in CAMERAS}
        for name in CAMERAS:
            self.cameras[name].until_said("serving")
        self.fuse = self._asterism("hub", "fuse", "--join", WIRED)
        self.robot = self._start("robots", "-c", ROBOT, AIR, "fused", "alpha")
        self.robot.until(lambda line: "exposed" in line)

    def tell(self, host: str, text: str) -> None:
        """A line of the transcript."""
        with self._lock:
            print(f"{time.monotonic() - self.began_s:6.1f} s  {host:<7} {text}", flush=True)

    def camera(self, name: str) -> Program:
        """Start a camera's server."""
        return self._asterism(name, "serve", self.rigs[name].name, "sim", "--connect", WIRED)

    def end(self) -> None:
        """What a person does in the evening: Ctrl-C everywhere, the router last."""
        self.tell("", "--- all of it is ended")
        for program in (self.robot, self.observer, self.fuse, *self.cameras.values(), self.router):
            program.end()

    def start_router(self) -> None:
        """Again, after it was killed."""
        self.router = self._asterism("hub", "router", "--listen", WIRED, "--listen", AIR)

    def _asterism(self, host: str, *words: str) -> Program:
        self.tell(host, f"$ asterism {' '.join(words)}")
        environment = self.clock.environment if host == "right" else None
        rig = [str(self.rigs[host]) if word == f"{host}.yaml" else word for word in words]
        return self._start(host, *SERVER, *rig, env=environment)

    def _start(self, host: str, *words: str, env: dict[str, str] | None = None) -> Program:
        program = Program(self._net.hosts[host], self.tell, *words, env=env)
        self._stack.callback(program.end)
        return program

    def phase(
        self,
        title: str,
        begin: Callable[[], None],
        hold_s: float,
        end: Callable[[], None],
        back: Callable[[Line], bool],
    ) -> None:
        """Do something, wait, undo it, wait until all is back; print figures of it. ``back`` is what of the observer's
        lines shows that it is.
        """
        self.tell("", f"--- {title}")
        began, bytes_before = time.monotonic(), self._air_bytes()
        begin()
        time.sleep(hold_s)
        end()
        ended, ended_ns = time.monotonic(), time.time_ns()
        told = {"observer": 0.0, "robot": 0.0}
        told["observer"] = self.observer.until(lambda line: line.get("exposed", 0) > ended_ns and back(line), ended)
        told["robot"] = self.robot.until(lambda line: line.get("exposed", 0) > ended_ns, ended)
        time.sleep(SETTLE_S)
        until = time.monotonic()
        done = Phase(began, until, {name: at - ended for name, at in told.items()}, self._air_bytes() - bytes_before)
        for line in figures(done, self.observer, self.robot):
            self.tell("", f"    {line}")

    def _air_bytes(self) -> int:
        return self._net.hosts["robots"].received_bytes(self._net.air_device)


def with_all(line: Line) -> bool:
    """A fused report in which some pose rests on all cameras."""
    return line.get("camera") == "fused" and any(set(CAMERAS) <= set(on) for on in line["robots"].values())


def nothing() -> None:
    """What is done in a phase without a fault."""


def faults(stage: Stage, net: Network, cut_s: float) -> None:
    """All phases."""
    stage.observer.until(with_all)
    stage.phase("nothing goes wrong", nothing, CALM_S, nothing, with_all)
    stage.phase(
        f"left's plug is pulled for {cut_s:g} s",
        lambda: net.cut("left", True),
        cut_s,
        lambda: net.cut("left", False),
        with_all,
    )
    stage.phase(
        f"the wireless link is cut for {cut_s:g} s",
        lambda: net.air.cut(True),
        cut_s,
        lambda: net.air.cut(False),
        with_all,
    )
    stage.phase("the router is killed, and started again", stage.router.kill, 2.0, stage.start_router, with_all)

    def start_third() -> None:
        stage.cameras["third"] = stage.camera("third")

    stage.phase("third's host loses its power for a while", stage.cameras["third"].kill, 10.0, start_third, with_all)
    stage.phase(
        f"right's clock is set {1e3 * CLOCK_OFF_S:g} ms ahead, and after 15 s right again",
        lambda: stage.clock.set(CLOCK_OFF_S),
        15.0,
        lambda: stage.clock.set(0.0),
        with_all,
    )


def main() -> None:
    """Do it, and print a transcript."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rate", type=float, nargs="?", default=15.0, help="of each camera, Hz (default: 15)")
    parser.add_argument("--cut", type=float, default=5.0, help="how long links are cut, s (default: 5)")
    options = parser.parse_args()
    if why := why_not():
        sys.exit(f"tests.measure.hosts: {why}")
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        net = stack.enter_context(network(("hub", *CAMERAS), Quality()))
        print(f"hub, left, right, third on a bridge; robots behind 20 ms, 1 % lost, 1 Mbit/s ({net.air.how})")
        print(f"{options.rate:g} Hz a camera, 3 robots; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
        stage = Stage(net, folder, options.rate, stack)
        faults(stage, net, options.cut)
        stage.end()


if __name__ == "__main__":
    main()
