"""An hour of ten robots, and how long `asterism coverage` takes for it:
`python -m tests.measure.coverage [MINUTES] [FOLDER]` (default 60, and a folder that is removed).

Ten robots go round on a bent surface, each on a circle of its own, at 60 Hz; frame reports and odometry are written by
the recorder's own classes, an hour is 2.5 GB. Only the first ten seconds are drawn: the frames after them are the same
with other times and numbers. Where FOLDER holds the recording of an earlier run, that is taken. Printed: of the
command, in a process of its own that has its kernels, seconds on the clock and of processors, and its table; and what
telling it live costs a frame, processor time of its thread.
"""

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.server.service.covering import Covering
from tests.coverage.driven import RATE_HZ, START_NS, STEP_NS, message_of, odometry_of, record, report_of, working_rig
from tests.on_surface import stood
from tests.servers import asterism

ROBOTS, LOOP_S = 10, 10
CIRCLE_M = 0.05


def drawn(rig: Rig) -> "list[pb.FrameReport]":
    """The reports of one round."""
    rng, reports = np.random.default_rng(0), []
    middles = [(-0.2 + 0.1 * (k % 5), -0.08 + 0.16 * (k // 5)) for k in range(ROBOTS)]
    assert rig.surface is not None
    for number in range(RATE_HZ * LOOP_S):
        angle = 2.0 * np.pi * number / (RATE_HZ * LOOP_S)
        poses = {
            robot.id: stood(rig.surface, x + CIRCLE_M * np.cos(angle), y + CIRCLE_M * np.sin(angle), angle)
            for robot, (x, y) in zip(rig.robots, middles, strict=True)
        }
        reports.append(report_of(rig, number, START_NS + number * STEP_NS, poses, rng))
    return reports


def frames(rig: Rig, count: int) -> Iterator[list[Message]]:
    """The messages of so many frames; what odometry tells inside is of the first round."""
    reports = drawn(rig)
    poses = [odometry_of(rig, report) for report in reports]
    for number in range(count):
        report, at = reports[number % len(reports)], START_NS + number * STEP_NS
        later, report.sequence = at - report.exposed_ns, number
        for field in ("exposed_ns", "arrived_ns", "solved_ns"):
            setattr(report, field, getattr(report, field) + later)
        told = [replace(message, log_ns=at, sequence=number) for message in poses[number % len(reports)]]
        yield [*told, message_of(rig, report)]


def live(rig: Rig, seconds: int = 40) -> float:
    """Processor time a frame of telling it once a second, ms; the first ten seconds do not count."""
    covering, told, took = Covering(rig), frames(rig, seconds * RATE_HZ), 0.0
    for second in range(seconds):
        reports = [next(told)[-1:] for _ in range(RATE_HZ)]
        began = time.process_time()
        for messages in reports:
            covering.add(messages)
        covering.look(7, lambda: None)
        took += (time.process_time() - began) * (second >= 10)
    return 1e3 * took / ((seconds - 10) * RATE_HZ)


def command(recording: Path, out: Path) -> None:
    """Run it and print what it took."""
    load, before, began = os.getloadavg()[0], os.times(), time.perf_counter()
    done = asterism("coverage", recording, "-o", out)
    took, after = time.perf_counter() - began, os.times()
    if done.returncode:
        sys.exit(done.stderr)
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    print(f"{took:.1f} s on the clock, {cpu:.1f} s of processors, load before {load:.1f}")
    print(done.stdout)


def main(minutes: int, folder: Path) -> None:
    """Record, run, print."""
    rig = working_rig(ROBOTS)
    there = sorted(folder.glob("test-*"))
    recording = there[0] if there else record(folder, rig, frames(rig, minutes * 60 * RATE_HZ))
    size = sum(file.stat().st_size for file in recording.iterdir())
    print(f"{recording.name}: {size / 1e9:.2f} GB")
    with tempfile.TemporaryDirectory() as out:
        for turn in range(2):  # the first may compile
            command(recording, Path(out) / str(turn))
    print(f"live: {live(rig):.3f} ms of processor time a frame")


if __name__ == "__main__":
    minutes = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    if len(sys.argv) > 2:
        main(minutes, Path(sys.argv[2]))
    else:
        with tempfile.TemporaryDirectory() as made:
            main(minutes, Path(made))
