"""A server that is left running: `python -m tests.measure.running [REPEATS]`.

`asterism serve --record` of the demo rig's simulated camera, 60 Hz. Printed: from SIGHUP to the first frame that was
solved with the new rig, frames lost meanwhile, and the longest time between two frames as a subscriber meets them, with
a reload and without; then, after `kill -9`, from the next start to its first frame, and from that to the recovered
recording, with what of it was lost.
"""

import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import zenoh
from rich.console import Console
from rich.table import Table

from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report
from asterism.protocol.network import client_config
from asterism.recordings.reader import Recording
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.servers import free_endpoint, running, wait_for_line

REPEATS = 20
CALM_S = 1.0
RUN_S = 6.0  # before it is killed


class Heard:
    """When each frame came, its number, and how many robots it told of."""

    def __init__(self, endpoint: str) -> None:
        self.frames: list[tuple[float, int, int]] = []
        self._more = threading.Condition()
        self.session = zenoh.open(client_config(endpoint))
        self.session.declare_subscriber(keys.frame("demo"), self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        now, report = time.monotonic(), decode_frame_report(sample.payload.to_bytes())
        with self._more:
            self.frames.append((now, report.sequence, len(report.robots)))
            self._more.notify_all()

    def until(self, robots: int) -> float:
        """When the newest frame tells of so many."""
        with self._more:
            assert self._more.wait_for(lambda: self.frames and self.frames[-1][2] == robots, 60.0)
            return self.frames[-1][0]

    def longest_gap_s(self, since: float) -> float:
        return float(np.diff([at for at, _, _ in self.frames if at >= since]).max())

    def lost(self) -> int:
        numbers = [number for _, number, _ in self.frames]
        return numbers[-1] - numbers[0] + 1 - len(numbers)


def reloads(folder: Path, repeats: int) -> list[tuple[float, float, float, int]]:
    """Of each reload: its time, the longest gap with it and in as long without it, s, and the frames lost so far."""
    rig, endpoint, found = folder / DEMO_RIG.name, free_endpoint(), []
    for file in DEMO_RIG.parent.glob("*.yaml"):
        (folder / file.name).write_text(file.read_text())
    whole = rig.read_text()
    texts = {4: whole[: whole.index("  echo:")], 5: whole}
    with running("serve", rig, "sim", "--listen", endpoint, "--record", folder) as server:
        wait_for_line(server, "recording to")
        heard = Heard(endpoint)
        heard.until(5)
        for turn in range(repeats):
            began = time.monotonic()
            time.sleep(CALM_S)
            calm = heard.longest_gap_s(began)
            robots = 4 + turn % 2
            rig.write_text(texts[robots])
            asked = time.monotonic()
            server.send_signal(signal.SIGHUP)
            took = heard.until(robots) - asked
            time.sleep(max(CALM_S - took, 0.1))
            found.append((took, heard.longest_gap_s(asked), calm, heard.lost()))
        heard.session.close()
    return found


def killed(folder: Path) -> tuple[float, float, float]:
    """Of a start after `kill -9`: to the first frame, from there to the recovered recording, and what was lost, s."""
    endpoint = free_endpoint()
    with running("serve", DEMO_RIG, "sim", "--listen", endpoint, "--record", folder) as server:
        wait_for_line(server, "recording to")
        heard = Heard(endpoint)
        heard.until(5)
        time.sleep(RUN_S)
        server.kill()
        server.wait()
        last = heard.frames[-1][1]
        heard.session.close()
    cut = next(folder.glob("demo-*"))
    began = time.monotonic()
    with running("serve", DEMO_RIG, "sim", "--listen", endpoint, "--record", folder) as server:
        wait_for_line(server, "was cut off; recovering it")
        first = time.monotonic()
        wait_for_line(server, f"{cut}: recovered in")
        done = time.monotonic()
    kept = max(message.sequence for message in Recording(cut).messages() if message.key == keys.frame("demo"))
    return first - began, done - first, (last - kept) / 60.0


def main(repeats: int) -> None:
    """Print both tables."""
    console = Console()
    with tempfile.TemporaryDirectory() as name:
        took, gaps, calm, lost = zip(*reloads(Path(name), repeats), strict=True)
    table = Table("", "median", "worst", title=f"{repeats} reloads at load {os.getloadavg()[0]:.1f}")
    for what, values in (
        ("SIGHUP to the first frame with the new rig, s", took),
        ("longest time between two frames with a reload, s", gaps),
        ("the same without one, s", calm),
    ):
        table.add_row(what, f"{np.median(values):.3f}", f"{max(values):.3f}")
    table.add_row("frames lost", "", str(lost[-1]))
    console.print(table)
    rows = []
    for _ in range(max(repeats // 4, 1)):
        with tempfile.TemporaryDirectory() as name:
            rows.append(killed(Path(name)))
    table = Table("", "median", "worst", title=f"{len(rows)} times kill -9")
    for what, values in zip(
        ("start to first frame, s", "first frame to recovered, s", "lost of the recording, s"),
        zip(*rows, strict=True),
        strict=True,
    ):
        table.add_row(what, f"{np.median(values):.2f}", f"{max(values):.2f}")
    console.print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else REPEATS)
