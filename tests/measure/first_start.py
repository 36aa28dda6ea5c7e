"""What the first start costs: `python -m tests.measure.first_start`.

Runs `asterism demo` with an empty cache and again with that cache, and prints processor time of all processes and wall
time of both; then the ten kernels that take longest to compile, each with the parts that it alone needs. `... write`
makes server/chain/kernels.json anew, the list of what is compiled when; needed when a kernel that Python calls comes,
goes or takes other arguments (a test says so).
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import event

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import ESTIMATORS, load_rig
from asterism.server import Frame, Tracks, localize
from asterism.server.centres.centre import REFINERS
from asterism.server.chain.kernel_list import (
    BLOBS,
    CHECK,
    COVERAGE,
    DESIGN,
    FILE,
    FUSE,
    LOCALIZE,
    PACKAGE,
    SIMULATE,
    kernel_list,
    text_of,
)
from asterism.server.identity.evidence import Version, version_of
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import plan_for
from asterism.server.kernel import Kernel
from asterism.server.pose.lens import undistort
from asterism.server.simulation.demo_rig import DEMO_RIG, DEMO_WORKPIECE
from asterism.server.simulation.simulate import Look, Scene
from tests.rigs import make_rig
from tests.servers import free_endpoint

DEMO_SECONDS = 20  # the command's own default


def chain(estimator: str) -> None:
    """Robots found, followed, lost, hidden in part, mirrored, beside glints, in the dark."""
    for rig, look, frames in (
        (load_rig(DEMO_RIG), Look(hidden=0.05, glints=20), 12),
        (make_rig(6), Look(hidden=0.3, glints=60), 12),
        (load_rig(DEMO_WORKPIECE), Look(hidden=0.05), 4),
    ):
        asked = replace(rig, centre=estimator)
        scene, tracks = Scene(rig, seed=2, look=look), Tracks.none()
        for index in range(frames):
            truth = scene.truth(index, index / 60.0)
            if index % 4 == 3:
                truth = [replace(entry, lit=(True,) * 4 + (False,) * 2) for entry in truth]
            image = scene.render(index, truth if index != 5 else [])
            localize(Frame(image, index * 16_666_667 + 1, index), asked, Tracks.none())
            _, tracks = localize(Frame(image, index * 16_666_667 + 1, index), asked, tracks)
        # Only where a spot was centred anew together with the light that leans on it, which is rare.
        undistort(plan_for(asked).lens, np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 3)))
        # Only where six spots fit with a ruler's tolerance.
        six, places, version = np.zeros(6), np.arange(6), Version(np.empty(6, np.int64), np.empty((3, 3)), np.empty(3))
        spots = Spots(np.zeros((6, 2)), np.zeros((6, 2)), six, six, six, np.ones(6, np.bool_))
        plan = plan_for(asked)
        version_of(plan.layouts[0], float(plan.extents[0]), places, spots, plan.focal, 1.0, 1, version)


def simulate() -> None:
    """What the simulated camera renders."""
    rig = load_rig(DEMO_RIG)
    scene = Scene(rig, seed=1, look=Look(glints=5))
    scene.render(0, scene.truth(0, 0.0))


def check() -> None:
    """`asterism check`."""
    from asterism.server.design.rig_check import check_rig

    check_rig(load_rig(DEMO_RIG), lambda _: None)


def design() -> None:
    """`asterism design`."""
    from asterism.server.design.plate_design import Request
    from asterism.server.design.plate_design import design as search

    search(Request(2, 0.1, 0.03, 1.5, 0.05))  # LEDs so far apart that there is little to search


def fuse() -> None:
    """Robots joined from three cameras: all LEDs and few, who says whose they are and who doesn't, one camera moved."""
    from asterism.server.fusing.fleet import Fleet, View
    from asterism.server.fusing.fuse import fuse as join
    from asterism.server.fusing.memory import Joint
    from tests.fusing.drawn import Seen, sighting
    from tests.several import Drive, facing_pair, looking_at, rigs_at

    rng = np.random.default_rng(0)
    rigs = rigs_at([*facing_pair(), looking_at(np.array([0.1, 0.8, 1.0]), np.zeros(3))], 3)
    drive, views = Drive(tuple(robot.id for robot in rigs[0].robots)), [View(rig) for rig in rigs]
    fleet = Fleet.of(views)
    for leds in ((0, 1, 2, 3, 4, 5), (0, 1, 2, 3), (0, 2, 4)):
        joint = Joint.none()
        for k in range(12):
            sightings = []
            for camera, view in enumerate(views):
                exposed_ns = 10**18 + k * 16_666_667 + (k > 5) * camera * 4_000_000
                place = view.T_world_camera
                off = np.array([0.01 * (camera == 2 and k > 8), 0.0, 0.0])
                seen = Seen(Pose(place.position + off, place.orientation), lit=dict.fromkeys(fleet.robots, leds))
                shown = sighting(view, drive((exposed_ns - 10**18) * 1e-9), exposed_ns, rng, seen)
                if len(leds) < 4 or k % 4 == 0:  # nobody knows whose they are
                    nobody = np.full(len(shown.robots), -1)
                    lost = {robot: pb.RobotReport(id=robot, state=pb.LOST) for robot in shown.told}
                    shown = replace(shown, robots=nobody, leds=nobody.copy(), told=lost)
                sightings.append(shown)
            for together in [sightings] if k <= 5 else [[one] for one in sightings]:
                _, joint = join(together, fleet, joint)


def coverage() -> None:
    """Where tools were, out of a recording's bytes."""
    from asterism.server.coverage.accumulate import Coverage
    from asterism.server.coverage.report_bytes import records_of
    from asterism.server.coverage.told import by_robot, told_in
    from asterism.server.coverage.working import working
    from tests.coverage.driven import START_NS, STEP_NS, message_of, report_of, working_rig

    rig, rng = working_rig(), np.random.default_rng(0)
    works = working(rig)
    assert works is not None
    pose = {"r00": Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))}
    reports = [message_of(rig, report_of(rig, k, START_NS + k * STEP_NS, pose, rng)).payload for k in range(2)]
    data, first = np.array(np.frombuffer(b"".join(reports), np.uint8)), len(reports[0])
    records_of(data)
    columns = told_in(data, np.array([[0, first], [first, len(data)]]), works.looked, Path("made here"))
    Coverage.none(works.surface, works.tools, 0.01, 10_000).add(by_robot(columns, works.looked), 1 / 60)


def called() -> set[tuple[str, str]]:
    """Every kernel that Python has called in this process, by module and name, with the types, as JSON."""
    found = set()
    for module in [module for name, module in sorted(sys.modules.items()) if name.startswith(PACKAGE)]:
        for name, value in vars(module).items():
            if isinstance(value, Kernel) and value.py_func.__module__ == module.__name__:
                for types in value.overloads:
                    key = f"{module.__name__.removeprefix(PACKAGE)}.{name}"
                    found.add((key, json.dumps([text_of(kind) for kind in types])))
    return found


SCENARIOS: dict[str, Callable[[], None]] = {
    SIMULATE: simulate,
    CHECK: check,
    DESIGN: design,
    FUSE: fuse,
    COVERAGE: coverage,
    **{estimator: (lambda estimator=estimator: chain(estimator)) for estimator in ESTIMATORS},  # type: ignore[misc]
}
REFINING = {f"centres.centre.{kernel.py_func.__name__}": name for name, kernel in REFINERS.items()}


def needs_in(scenario: str) -> tuple[str, ...]:
    """What a command that does the like of a scenario asks `warm_up` for."""
    return (BLOBS, scenario, LOCALIZE, SIMULATE) if scenario in ESTIMATORS else (scenario,)


def verify(scenario: str) -> dict[str, Any]:
    """Run a scenario after all is warmed up: what was compiled in spite of that, what it called that is not in the
    list, and what the list has it need that it did not call.
    """
    listener = Compiled()
    event.register("numba:compile", listener)
    SCENARIOS[scenario]()
    needed = [entry for entry in kernel_list() if not entry.needs.isdisjoint(needs_in(scenario))]
    listed = {(entry.kernel, json.dumps(entry.arguments)) for entry in needed}
    return {
        "compiled": listener.names,
        "not listed": sorted(called() - listed),
        "for nobody": sorted(listed - called()),
    }


class Compiled(event.Listener):  # type: ignore[misc]
    """The names of what numba compiles, in order."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def on_start(self, happened: Any) -> None:
        self.names.append(happened.data["dispatcher"].py_func.__name__)

    def on_end(self, _: Any) -> None:
        pass


def needs_of(kernel: str, scenario: str) -> str:
    """What a kernel that a scenario called is needed for."""
    if scenario not in ESTIMATORS or kernel == "simulation.simulate.trace_disc":
        return SIMULATE if kernel == "simulation.simulate.trace_disc" else scenario
    return REFINING.get(
        kernel, BLOBS if kernel.startswith("segmentation.") and "tell_whose" not in kernel else LOCALIZE
    )


def write() -> None:
    """Make the list anew; each scenario runs in a process of its own, and shows what it called."""
    needs: dict[tuple[str, str], set[str]] = defaultdict(set)
    for scenario in SCENARIOS:
        print(f"{scenario} ...", flush=True)
        told = subprocess.run(
            [sys.executable, "-m", "tests.measure.first_start", "called", scenario], stdout=subprocess.PIPE, check=True
        ).stdout
        for kernel, types in json.loads(told):
            needs[kernel, types].add(needs_of(kernel, scenario))
    lines = [
        {"kernel": kernel, "arguments": json.loads(types), "needs": sorted(needs[kernel, types]), "seconds": 1.0}
        for kernel, types in sorted(needs)
    ]
    _save(lines)
    print("seconds ...", flush=True)
    seconds = in_empty_cache("seconds")
    _save([{**line, "seconds": round(took["whole"], 2)} for line, took in zip(lines, seconds, strict=True)])


def _save(lines: list[dict[str, Any]]) -> None:
    FILE.write_text("[\n" + ",\n".join(json.dumps(line) for line in lines) + "\n]\n", encoding="utf-8")


def seconds() -> list[dict[str, Any]]:
    """Of every kernel in the list, compiled in turn: processor time, and that of its parts, each without its own."""
    taken: list[dict[str, Any]] = []
    for entry in kernel_list():
        listener = Timed()
        event.register("numba:compile", listener)
        began = time.process_time()
        entry.make_ready()
        taken.append({"kernel": entry.kernel, "whole": time.process_time() - began, "parts": listener.taken})
        event.unregister("numba:compile", listener)
    return taken


class Timed(event.Listener):  # type: ignore[misc]
    """Processor time that numba takes for each function, without what it takes for those that it calls."""

    def __init__(self) -> None:
        self.taken: dict[str, float] = defaultdict(float)
        self._running: list[list[float]] = []

    def on_start(self, _: Any) -> None:
        self._running.append([time.process_time(), 0.0])

    def on_end(self, happened: Any) -> None:
        began, inner = self._running.pop()
        took = time.process_time() - began
        if self._running:
            self._running[-1][1] += took
        self.taken[happened.data["dispatcher"].py_func.__name__] += took - inner


def in_empty_cache(word: str) -> Any:
    """What this module prints when called with ``word`` in a process without any compiled kernels."""
    with tempfile.TemporaryDirectory() as folder:
        told = subprocess.run(
            [sys.executable, "-m", "tests.measure.first_start", word],
            env={**os.environ, "XDG_CACHE_HOME": folder},
            stdout=subprocess.PIPE,
            check=True,
        ).stdout
    return json.loads(told)


def demo(cache: Path, folder: Path) -> tuple[float, float]:
    """Processor time of all processes and wall time of `asterism demo`, s."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    command = [sys.executable, "-m", "asterism", "demo", "--seconds", str(DEMO_SECONDS)]
    subprocess.run(
        [*command, "--record", str(folder), "--listen", free_endpoint()],
        env={**os.environ, "XDG_CACHE_HOME": str(cache)},
        stdout=subprocess.DEVNULL,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, time.monotonic() - began


def measure() -> None:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as folder:
        for what in ("with an empty cache", "with that cache"):
            processor, wall = demo(Path(folder) / "cache", Path(folder) / "recordings")
            print(f"asterism demo {what}: {processor:.1f} s of processor time in {wall:.1f} s", flush=True)
    taken = in_empty_cache("seconds")
    print(f"all {len(taken)} kernels in one process: {sum(entry['whole'] for entry in taken):.1f} s; the ten longest:")
    for entry in sorted(taken, key=lambda entry: -entry["whole"])[:10]:
        parts = sorted(entry["parts"].items(), key=lambda part: -part[1])[:3]
        told = ", ".join(f"{name} {took:.2f}" for name, took in parts)
        print(f"  {entry['whole']:6.2f} s  {entry['kernel']}: {told}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case []:
            measure()
        case ["write"]:
            write()
        case ["called", scenario]:
            SCENARIOS[scenario]()
            print(json.dumps(list(called())))
        case ["verify", scenario]:
            print(json.dumps(verify(scenario)))
        case ["seconds"]:
            print(json.dumps(seconds()))
        case _:
            sys.exit(__doc__)
