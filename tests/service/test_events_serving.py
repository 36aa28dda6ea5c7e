"""A server tells what happens to its frames and its rig, and records what it tells."""

import queue
import threading
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_event
from asterism.protocol.messages import EVENT, Message
from asterism.protocol.rig import load_rig
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.service.serve import Outlets, Run
from asterism.server.service.stop import Stop
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.camera import Camera, Taken
from tests.service.nobody import Nobody

TIMEOUT_S = 60.0


class Device:
    """A camera that gives an image whenever it is told to."""

    def __init__(self) -> None:
        self.images: queue.Queue[Taken | None] = queue.Queue()

    def show(self) -> None:
        self.images.put(Taken(np.zeros((1024, 1280), np.uint8)))

    def read(self) -> Taken | None:
        return self.images.get(timeout=TIMEOUT_S)

    def close(self) -> None:
        """Nothing to let go of."""


class Heard(Nobody):
    """Keeps the events that are published."""

    def __init__(self) -> None:
        super().__init__()
        self.events: queue.Queue[pb.Event] = queue.Queue()

    def publish(self, messages: Iterable[Message], session: int | None = None) -> list[Message]:
        told = super().publish(messages, session)
        for message in told:
            if message.kind is EVENT:
                self.events.put(decode_event(message.payload))
        return told

    def next(self) -> "pb.Event":
        return self.events.get(timeout=TIMEOUT_S)


def test_frames_that_stop_and_a_rig_that_is_read_again_are_told_and_recorded(tmp_path: Path) -> None:
    for file in DEMO_RIG.parent.glob("*.yaml"):
        (tmp_path / file.name).write_text(file.read_text())
    path, heard, device, stop = tmp_path / DEMO_RIG.name, Heard(), Device(), Stop()
    rig = load_rig(path)
    camera = Camera("cam", lambda: device, rig, print)
    recorder = Recorder(tmp_path / "recordings", rig, "test", FramesKept(0), wait=True)
    run = Run(rig, camera, Outlets(heard, recorder), stop, camera.clock, str(path))
    serving = threading.Thread(target=run.serve)
    serving.start()
    try:
        device.show()
        first = [heard.next() for _ in rig.robots]
        assert {(event.robot, event.state) for event in first} == {(robot.id, pb.LOST) for robot in rig.robots}
        stopped = heard.next()
        assert (stopped.happening, stopped.since_ns) == (pb.FRAMES_STOPPED, first[0].since_ns)
        assert stopped.reason == "no frame has come for 0.5 s"
        device.show()
        came = heard.next()
        assert (came.happening, came.sequence) == (pb.FRAMES_CAME, 1)
        assert came.lasted_s >= 0.5
        whole = path.read_text()
        path.write_text(whole[: whole.index("  echo:")])
        assert run.reloader is not None
        run.reloader.ask()
        after = heard.next()
        while after.happening == pb.FRAMES_STOPPED:  # reading a rig may take longer than frames are waited for
            after = heard.next()
        assert (after.happening, after.sequence) == (pb.RIG_READ, 2)
        device.show()
        left = heard.next()
        while left.happening != pb.STATE_CHANGED:
            left = heard.next()
        assert (left.robot, left.before, left.state) == ("echo", pb.LOST, pb.STATE_UNSPECIFIED)
        path.write_text("nonsense")
        run.reloader.ask()
        refused = heard.next()
        while refused.happening == pb.FRAMES_STOPPED:
            refused = heard.next()
        assert refused.happening == pb.RIG_REFUSED
        assert "the one before stays in force" in refused.reason
    finally:
        stop.set()
        device.show()
        serving.join(TIMEOUT_S)
        recorder.close({})
    recording = Recording(recorder.folder)
    happened = [
        decode_event(message.payload) for message in recording.messages() if message.kind.schema == EVENT.schema
    ]
    numbers = [event.number for event in happened]
    assert numbers == list(range(1, len(numbers) + 1))
    assert {pb.FRAMES_STOPPED, pb.FRAMES_CAME, pb.RIG_READ, pb.RIG_REFUSED} <= {event.happening for event in happened}
    assert [first for first, _ in recording.rigs()] == [0, 2]
