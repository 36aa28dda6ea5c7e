"""The whole way at 60 Hz, between processes: `python -m tests.measure.serving [FOLDER]`.

FOLDER holds `rig.yaml`, `frames/` and their truth (default: 600 frames of the demo rig's five robots, simulated first).
`asterism serve --record` plays it, a subscriber with plain zenoh and the Foxglove schema only listens, then
`asterism replay` publishes the recording again through a zenoh router. Printed: messages and their order, errors
against the truth, frames without the robot, latency from the frame's arrival in memory to the subscriber's callback,
resident memory of the server, and whether the bytes on the wire, in the recording and from the replay are the same.
"""

import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.geometry import Pose, angle_between
from asterism.protocol.rig import load_rig
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.chain.judging import truth_of
from tests.servers import Subscriber, asterism, free_endpoint, open_router, running
from tests.wire_bytes import in_the_session_of, received_bytes, recorded_bytes

RATE, FRAMES = 60, 600


def resident_mb(pid: int, kind: str = "VmRSS") -> float:
    """Resident memory of a process; "RssAnon": its own, without files that are mapped."""
    status = Path(f"/proc/{pid}/status").read_text()
    return float(next(line.split()[1] for line in status.splitlines() if line.startswith(kind))) / 1024


def robots_table(folder: Path, received: list[dict[str, Any]]) -> Table:
    """What arrived of each robot, and how far from the truth."""
    truth = truth_of(folder)
    table = Table(title="messages received", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in (
        "robot",
        "messages",
        "in order",
        "missing frames",
        "x,y mm",
        "z mm",
        "deg",
        "worst mm",
        "worst deg",
    ):
        table.add_column(heading, justify="left" if heading == "robot" else "right")
    for robot in load_rig(folder / "rig.yaml").robots:
        told = {int(e["metadata"]["sequence"]): e for e in received if e.get("robot") == robot.id}
        order = [int(e["metadata"]["sequence"]) for e in received if e.get("robot") == robot.id]
        missing = sorted(set(range(len(truth))) - set(told))
        offs, angles = [], []
        for sequence, entry in told.items():
            right = next(r for r in truth[sequence]["robots"] if r["id"] == robot.id)
            offs.append(np.array(entry["position"]) - np.array(right["position"]))
            said, true = (Pose(np.zeros(3), np.array(e["orientation"])) for e in (entry, right))
            angles.append(np.degrees(angle_between(said.rotation, true.rotation)))
        off = 1e3 * np.array(offs)
        spans = f"{missing[0]}-{missing[-1]} ({len(missing)})" if missing else "none"
        table.add_row(
            robot.id,
            str(len(order)),
            "yes" if order == sorted(set(order)) else "NO",
            spans,
            f"{np.median(np.abs(off[:, :2])):.4f}",
            f"{np.median(np.abs(off[:, 2])):.3f}",
            f"{np.median(angles):.3f}",
            f"{np.linalg.norm(off, axis=1).max():.2f}",
            f"{max(angles):.2f}",
        )
    return table


def main(folder: Path, work: Path) -> None:
    """Measure and print."""
    console = Console(width=100)
    warm_up(*localizing(load_rig(DEMO_RIG)))
    endpoint, memory, ended = free_endpoint(), [], threading.Event()
    with running(
        *("serve", folder / "rig.yaml", folder / "frames", "--listen", endpoint),
        *("--record", work, "--rate", RATE),
    ) as server:

        def watch_memory() -> None:
            while not ended.wait(0.5) and server.poll() is None:
                memory.append(resident_mb(server.pid))

        watcher = threading.Thread(target=watch_memory)
        watcher.start()
        received = Subscriber(endpoint, work / "received.jsonl").finish()
        code = server.wait(timeout=60)
        ended.set()
        watcher.join()
    console.print(robots_table(folder, received))
    poses = [entry for entry in received if "robot" in entry]
    latency = np.array([entry["received_ns"] - entry["exposed_ns"] for entry in poses]) * 1e-6
    settled = latency[len(latency) // 10 :]
    for label, values in (("all messages", latency), ("after the first tenth", settled)):
        p50, p99 = np.percentile(values, [50, 99])
        console.print(f"latency, {label}: p50 {p50:.2f} ms, p99 {p99:.2f} ms, most {values.max():.2f} ms")
    frames = sum(entry["key"].endswith("/frame") for entry in received)
    console.print(f"frame reports: {frames} of {len(truth_of(folder))}; the server ended with exit code {code}")
    half = len(memory) // 2
    console.print(
        f"resident memory: {memory[half]:.0f} MB half-way, {memory[-1]:.0f} MB at the end, {max(memory):.0f} most"
    )

    recording = next(path for path in work.iterdir() if path.is_dir())
    wire, recorded = received_bytes(received), recorded_bytes(recording)
    with open_router() as (router, _):
        listener = Subscriber(router, work / "again.jsonl", "replay/asterism/**")
        asterism("replay", recording, "--connect", router, "--speed", 2)
        again = listener.finish()
    replayed = received_bytes(again)
    count = sum(map(len, recorded.values()))
    console.print(
        f"bytes of {count} messages: wire = recording: {'yes' if wire == recorded else 'NO'}; "
        f"replay = recording: {'yes' if replayed == in_the_session_of(replayed, recorded) else 'NO'}"
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        if len(sys.argv) > 1:
            source = Path(sys.argv[1])
        else:
            source = Path(temporary) / "simulated"
            made = asterism("simulate", DEMO_RIG, source, "--frames", FRAMES)
            if made.returncode:
                sys.exit(made.stderr)
        place = Path(temporary) / "recorded"
        place.mkdir()
        main(source, place)
