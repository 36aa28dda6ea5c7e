"""What `asterism fuse` takes, live: `python -m tests.measure.fusing_live [SECONDS] [CAMERAS] [ROBOTS]`.

CAMERAS servers (default 4) in one process publish frame reports at 60 Hz for SECONDS (default 20), of ROBOTS (default
10) that all of them see, with spots drawn beforehand; `asterism fuse` runs in a process of its own and hears each over
a connection of its own. Once all cameras expose at the same times, once they take turns. Printed, ms: from the last
report of an exposure going out to the last of its poses arriving back in the first process, median, 99 % and most; what
fuse itself says it took from the last report's arrival to the poses; exposures that never came; and its processor time.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zenoh
from rich.console import Console
from rich.table import Table

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report, decode_status, to_bytes
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.protocol.network import client_config
from asterism.server.fusing.fleet import View
from tests.fusing.drawn import sighting
from tests.servers import free_endpoint
from tests.service.fusing.speaking import Speaker, report_of
from tests.several import Drive, looking_at, rigs_at

RATE_HZ = 60
PERIOD_NS = round(1e9 / RATE_HZ)
SOLVED_NS = 5_000_000  # from an exposure to its report, as a server has it
SETTLING_S = 3.0
TICKS = os.sysconf("SC_CLK_TCK")


def places(count: int) -> list[Pose]:
    """T_world_camera of cameras in a ring above the floor, that look at its middle."""
    angles = [2 * np.pi * k / count + 0.4 for k in range(count)]
    return [looking_at(np.array([0.6 * np.cos(a), 0.6 * np.sin(a), 1.2]), np.zeros(3), 0.3 * a) for a in angles]


class Back(NamedTuple):
    """What came back: when the last message of each exposure did, by its time; what fuse says it took, s."""

    arrived: dict[int, int]
    told: list[tuple[float, float]]


def hear(session: zenoh.Session, back: Back) -> list[object]:
    def frame(sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        back.arrived[decode_frame_report(sample.payload.to_bytes()).exposed_ns] = now_ns

    def status(sample: zenoh.Sample) -> None:
        told = decode_status(sample.payload.to_bytes())
        back.told.append((told.solve_p50_s, told.solve_p99_s))
        if told.problem:
            print(told.problem, file=sys.stderr)

    return [
        session.declare_subscriber(keys.frame(keys.FUSED), frame),
        session.declare_subscriber(keys.status(keys.FUSED), status),
    ]


def processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


class Player:
    """The cameras' servers, and when the last report of every exposure went out, by the monotonic clock."""

    def __init__(self, speakers: list[Speaker], drawn: list[list[bytes]], staggered: bool) -> None:
        self.out: dict[int, int] = {}
        self._speakers = speakers
        self._drawn = drawn
        self._staggered = staggered

    def play(self, until_s: float) -> None:
        begin_ns, k = self._speakers[0].clock.now_ns(), 0
        offset_ns = begin_ns - time.monotonic_ns()
        while time.monotonic() < until_s:
            for c, speaker in enumerate(self._speakers):
                exposed_ns = begin_ns + k * PERIOD_NS + (c * PERIOD_NS // len(self._speakers)) * self._staggered
                left_ns = exposed_ns + SOLVED_NS - offset_ns - time.monotonic_ns()
                if left_ns > 0:
                    time.sleep(left_ns * 1e-9)
                self._tell(c, speaker, k, exposed_ns)
                self.out[exposed_ns] = time.monotonic_ns()
            k += 1

    def _tell(self, c: int, speaker: Speaker, k: int, exposed_ns: int) -> None:
        payload = self._drawn[c][k % len(self._drawn[c])]
        now = to_bytes(pb.FrameReport(exposed_ns=exposed_ns, sequence=k, session=speaker.clock.session))
        speaker.publisher.publish([Message(keys.frame(speaker.name), FRAME_REPORT, payload + now, exposed_ns, 0, k)])


def run(speakers: list[Speaker], drawn: list[list[bytes]], staggered: bool, seconds: float) -> list[str]:
    """One row of the table."""
    endpoint = free_endpoint()
    words = [word for speaker in speakers for word in ("--connect", speaker.endpoint)]
    command = [sys.executable, "-m", "asterism", "fuse", "--quiet", "--listen", endpoint, *words]
    back, player = Back({}, []), Player(speakers, drawn, staggered)
    with subprocess.Popen(command) as process, ExitStack() as stack:
        config = client_config(endpoint)
        config.insert_json5("connect/timeout_ms", "60000")
        stack.callback(hear(stack.enter_context(zenoh.open(config)), back).clear)
        end_s = time.monotonic() + SETTLING_S + seconds
        playing = threading.Thread(target=player.play, args=(end_s,))
        playing.start()
        time.sleep(SETTLING_S)
        before_s, from_ns = processor_s(process.pid), time.monotonic_ns()
        back.told.clear()
        playing.join()
        used_s, passed_s = processor_s(process.pid) - before_s, (time.monotonic_ns() - from_ns) * 1e-9
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        process.wait()
    wanted = [exposed for exposed, out in player.out.items() if out > from_ns]
    took = [(back.arrived[exposed] - player.out[exposed]) * 1e-6 for exposed in wanted if exposed in back.arrived]
    fused = np.array(back.told) * 1e3
    cells = [*np.percentile(took, [50, 99, 100]), np.median(fused[:, 0]), np.median(fused[:, 1])]
    return [
        "taking turns" if staggered else "together",
        *(f"{cell:.2f}" for cell in cells),
        f"{len(wanted) - len(took)} of {len(wanted)}",
        f"{100 * used_s / passed_s:.0f} %",
    ]


def film(speaker: Speaker, drive: Drive, later: float, count: int, rng: np.random.Generator) -> Iterator[bytes]:
    """A camera's reports of frames that are so much of a period later than the first camera's."""
    for k in range(count):
        yield to_bytes(report_of(sighting(View(speaker.rig), drive((k + later) / RATE_HZ), 1, rng)))


def main(seconds: float = 20.0, cameras: int = 4, robots: int = 10) -> None:
    """Both rows."""
    rng = np.random.default_rng(1)
    rigs = rigs_at(places(cameras), robots)
    drive = Drive(tuple(robot.id for robot in rigs[0].robots))
    frames = round((SETTLING_S + seconds + 1.0) * RATE_HZ)
    with ExitStack() as stack:
        speakers = [Speaker(rig, rng) for rig in rigs]
        for speaker in speakers:
            stack.callback(speaker.close)
        table = Table("exposures", "p50", "p99", "most", "fuse p50", "fuse p99", "not joined", "processor")
        for staggered in (False, True):
            later = [c / cameras * staggered for c in range(cameras)]
            drawn = [list(film(one, drive, later[c], frames, rng)) for c, one in enumerate(speakers)]
            table.add_row(*run(speakers, drawn, staggered, seconds))
    Console(width=120).print(f"{cameras} cameras, {robots} robots, {RATE_HZ} Hz", table)


if __name__ == "__main__":
    main(*map(float, sys.argv[1:2]), *map(int, sys.argv[2:4]))
