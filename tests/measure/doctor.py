"""Does `asterism doctor` name what is wrong, and nothing else: `python -m tests.measure.doctor [--seeds N] [FAULT ...]`

Healthy streams first: rigs of five kinds (tests/measure/doctor_streams.py), calibrated as well as ours are, in light of
many kinds; then every fault, from slight to severe, in streams of other seeds. "named": of so many streams, in how many
the row that is to name the fault says "look at it" or "wrong"; "beside": rows that say so as well, in how many streams.
With --samples FOLDER the films in a folder like that of the held-out frames are told about, too.
"""

import argparse
import os
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.table import Table

from asterism.protocol.rig import Rig, load_rig
from asterism.server import Frame
from asterism.server.doctor.examine import examine
from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.doctor.gather import Gatherer
from tests.measure.doctor_streams import FAULTS, Stream, by_hand, film_of, healthy

FRAMES = 120
FAULTY = 1000  # the first seed of streams with faults
BY_HAND = 4  # every so many healthy streams are a robot shown by hand
NOW_S = 1_800_000_000.0
DAY_S = 86_400.0


def diagnosed(told: Rig, frames: Iterator[Frame], age_days: float) -> list[Finding]:
    """The doctor's findings, its calibration being so old."""
    gatherer = Gatherer(told)
    for frame in frames:
        gatherer.note(frame)
        gatherer.add(frame)
    with tempfile.TemporaryDirectory() as folder:
        camera = Path(folder) / "camera.yaml"
        camera.touch()
        os.utime(camera, (NOW_S - age_days * DAY_S,) * 2)
        return examine(gatherer.gathered(), "rig.yaml", camera, NOW_S)


def alarms(stream: Stream, frames: int) -> list[Finding]:
    """What it says is not good."""
    found = diagnosed(stream.told, stream.frames(frames), stream.age_days)
    return [finding for finding in found if finding.verdict > Verdict.GOOD]


def told_healthy(streams: int, frames: int, console: Console) -> None:
    """Healthy streams, and every alarm in them."""
    false = 0
    for seed in range(streams):
        stream = by_hand(healthy(seed)) if seed % BY_HAND == 0 else healthy(seed)
        for alarm in alarms(stream, frames):
            false += 1
            console.print(f"healthy {seed}: {alarm.check}, {alarm.verdict.words}: {alarm.measured}", markup=False)
    console.print(f"{streams} healthy streams: {false} false alarms", highlight=False)


def told_faults(names: list[str], seeds: int, frames: int, console: Console) -> None:
    """A row for every fault and size."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("fault", "size", "named", "beside"):
        table.add_column(heading)
    for number, (name, fault) in enumerate(FAULTS.items()):
        if names and not any(part in name for part in names):
            continue
        for size in fault.sizes:
            named, beside = 0, Counter[str]()
            for k in range(seeds):
                found = alarms(fault.stage(healthy(FAULTY + 7 * number + k), size), frames)
                named += any(finding.check in fault.rows for finding in found)
                beside.update(finding.check for finding in found if finding.check not in fault.rows)
            others = ", ".join(f"{check} {count}" for check, count in beside.most_common())
            table.add_row(name, f"{size:g}", f"{named} of {seeds}", others)
            console.print(f"{name} {size:g}: named {named} of {seeds}; {others}", highlight=False, markup=False)
    console.print(table)


def told_samples(folder: Path, console: Console) -> None:
    """What it says of films of others."""
    for rig in sorted(folder.glob("*/rig.yaml")):
        images = sorted(path.name for path in (rig.parent / "frames").glob("*.png"))
        found = diagnosed(told := load_rig(rig), film_of(str(rig.parent / "frames"), told, images), 30.0)
        said = "; ".join(f"{f.check}: {f.measured}" for f in found if f.verdict > Verdict.GOOD)
        console.print(f"{rig.parent.name}, {len(images)} frames: {said or 'all good'}", highlight=False, markup=False)


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.doctor")
    parser.add_argument("faults", nargs="*", metavar="FAULT", help="only those whose name holds this")
    parser.add_argument("--seeds", type=int, default=5, help="streams of every fault and size")
    parser.add_argument("--healthy", type=int, default=30, help="streams without a fault")
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--samples", type=Path)
    options = parser.parse_args()
    began, console = time.monotonic(), Console(width=160)
    told_healthy(options.healthy, options.frames, console)
    if options.samples:
        told_samples(options.samples, console)
    told_faults(options.faults, options.seeds, options.frames, console)
    console.print(f"{time.monotonic() - began:.0f} s", highlight=False)


if __name__ == "__main__":
    main()
