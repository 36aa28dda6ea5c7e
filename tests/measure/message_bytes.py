"""How many bytes the messages of a camera are: of frames that the chain solved, told and recorded as by `serve`."""

import re
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import encode_rig, to_bytes
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message
from asterism.protocol.rig import load_rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.chain.pipeline import localize
from asterism.server.command.recorded_film import film_messages
from asterism.server.pose.track import Tracks
from asterism.server.service.events import Events
from asterism.server.service.health import Health
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.simulated import Simulated
from tests.rigs import random_layouts

FRAMES = 60
SEED = 40  # of constellations that `load_rig` finds apart from the demo's
BIG = 2**62  # as large as a number of a session or a time is


class Sizes(NamedTuple):
    """Bytes: payloads of messages, the mean where they differ; ``recorded``: of a frame on disk, without images."""

    odometry: int
    frame: int
    status: int
    beat: int
    rig: int
    recorded: float
    found: float  # robots a frame


def sizes(robots: int) -> Sizes:
    """Of a camera of so many robots, all in view."""
    with tempfile.TemporaryDirectory() as name:
        rig = load_rig(_rig(Path(name), robots))
        health, tracks, messages = Health(rig.camera.name, "sim", (robot.id for robot in rig.robots)), Tracks.none(), []
        recorder = Recorder(Path(name), rig, "sim", FramesKept(0), wait=True, timed=False)
        events = Events(rig.camera.name)
        for frame in Simulated(rig, count=FRAMES).frames():
            result, tracks = localize(frame, rig, tracks)
            told = film_messages(frame, result, rig, events)
            recorder.write(told, None, frame.exposed_ns, frame.index)
            health.add(frame, result, frame.exposed_ns, frame.exposed_ns)
            messages += told
        recorder.close({})
        recorded = sum(file.stat().st_size for file in recorder.folder.rglob("*.mcap")) / FRAMES
        found = sum(message.kind is ODOMETRY for message in messages)
        return Sizes(
            _mean(messages, ODOMETRY.schema), _mean(messages, FRAME_REPORT.schema),
            len(health.message(BIG, BIG).payload), _beat(), len(encode_rig(rig)), recorded, found / FRAMES,
        )  # fmt: skip


def _mean(messages: list[Message], schema: str) -> int:
    return round(float(np.mean([len(message.payload) for message in messages if message.kind.schema == schema])))


def _beat() -> int:
    return len(to_bytes(pb.Beat(session=BIG, sequence=10**6, time_ns=BIG, monotonic_ns=BIG, rate=1.0, started_ns=BIG)))


def _rig(folder: Path, robots: int) -> Path:
    """The demo's rig with so many robots, in files; those beyond its five are of the same kind."""
    text = DEMO_RIG.read_text()
    head, *parts = re.split(r"^(?=  \w+:$)", text, flags=re.MULTILINE)
    for number, layout in enumerate(random_layouts(max(robots - len(parts), 0), SEED)):
        leds = ", ".join(f"[{x:.4f}, {y:.4f}, 0.012]" for x, y in layout)
        led = "led: {radius: 0.0025}\n    normal: {world: [0, 0, 1], within_deg: 40}"
        parts.append(f"  robot{number}:\n    leds: [{leds}]\n    {led}\n")
    for file in DEMO_RIG.parent.glob("*.yaml"):
        (folder / file.name).write_text(file.read_text())
    (folder / DEMO_RIG.name).write_text(head + "".join(parts[:robots]))
    return folder / DEMO_RIG.name
