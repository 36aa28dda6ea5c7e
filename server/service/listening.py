"""Recording what servers publish, by listening: every camera that is heard gets a recording of its own.

zenoh's threads put what arrives into a queue; all else is one thread's. Nothing of ours is in any server's way.
"""

import queue
import time
from pathlib import Path
from typing import NamedTuple

import zenoh

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_rig
from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.recordings.camera_recording import CameraRecording
from asterism.recordings.from_network import arrived, expressions
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.service.disk import Disk
from asterism.server.service.say import say

QUEUE = 20_000  # messages that wait to be recorded
LOOK_EVERY_S = 0.1
TICK_S = 1.0
ANSWER_S = 2.0  # a server that does not tell its rig within that time is asked again
QUIET_S = 3.0  # without a message it is said that nobody is heard
MOST_CAMERAS = 32


class _Sample(NamedTuple):
    key: str
    payload: bytes | None  # None: the token of a server came, or went
    there: bool = True


class Listening:
    """Records into ``parent`` what is published under ``prefix``. `step` again and again, then `close`."""

    def __init__(self, session: zenoh.Session, parent: Path, prefix: str, endpoint: str) -> None:
        self._session = session
        self._parent = parent
        self._prefix = prefix
        self._endpoint = endpoint
        self._queue: queue.Queue[_Sample] = queue.Queue(QUEUE)
        self._cameras: dict[str, CameraRecording] = {}
        self._disks: dict[str, Disk] = {}
        self._gone: set[str] = set()
        self._said: set[str] = set()
        self.lost = 0  # messages that arrived and found no room in the queue
        self._ticked_s = self._began_s = time.monotonic()
        self._held = [session.declare_subscriber(expression, self._take) for expression in expressions(prefix)]
        self._tokens = session.liveliness().declare_subscriber(prefix + keys.alive("*"), self._shows, history=True)

    def step(self) -> None:
        """Record what has arrived; ask for rigs; once a second look at the disk."""
        try:
            self._record(self._queue.get(timeout=LOOK_EVERY_S))
        except queue.Empty:
            self._say_if_quiet()
        now_s = time.monotonic()
        for name, camera in list(self._cameras.items()):
            if camera.asks(now_s):
                self._ask(name, camera)
        if now_s - self._ticked_s >= TICK_S:
            self._ticked_s = now_s
            for camera in self._cameras.values():
                camera.tick(now_s)
            for disk in self._disks.values():
                disk.look()

    def close(self) -> list[str]:
        """Record what still waits, finish every recording; returns what is wrong with them, in sentences."""
        for subscriber in self._held:
            subscriber.undeclare()
        self._tokens.undeclare()
        while not self._queue.empty():
            self._record(self._queue.get_nowait())
        for camera in self._cameras.values():
            camera.finish()
        problems = [problem for camera in self._cameras.values() for problem in camera.problems]
        if lost := self.lost + sum(camera.waiting_lost for camera in self._cameras.values()):
            problems.append(f"{lost} messages arrived and are not recorded: this program was too slow, or had no rig")
        if not self._disks:
            problems.append(f"{self._parent}: nothing was recorded: no server was heard at {self._endpoint}")
        return problems

    def _take(self, sample: zenoh.Sample) -> None:
        try:
            self._queue.put_nowait(_Sample(str(sample.key_expr), sample.payload.to_bytes()))
        except queue.Full:
            self.lost += 1

    def _shows(self, sample: zenoh.Sample) -> None:
        self._queue.put(_Sample(str(sample.key_expr), None, sample.kind == zenoh.SampleKind.PUT))

    def _record(self, sample: _Sample) -> None:
        key = sample.key.removeprefix(self._prefix)
        name = key.split("/")[1]
        if sample.payload is None:
            self._tell_token(name, sample.there)
            return
        try:
            message = arrived(key, sample.payload)
        except InputError as error:
            self._say_once(f"{error}; such messages are not recorded")
            return
        camera = self._camera(name)
        if camera is not None:
            camera.arrived(message, time.monotonic())

    def _tell_token(self, name: str, there: bool) -> None:
        if there and name in self._gone:
            self._gone.remove(name)
            say(f"camera '{name}': the server is back")
        elif not there and name in self._cameras:
            self._gone.add(name)
            say(f"camera '{name}': the server is gone; waiting for it")

    def _camera(self, name: str) -> CameraRecording | None:
        camera = self._cameras.get(name)
        if camera is None and len(self._cameras) < MOST_CAMERAS:
            camera = CameraRecording(name, self._begin, say)
            self._cameras[name] = camera
        elif camera is None:
            self._say_once(f"more than {MOST_CAMERAS} cameras are heard; the others are not recorded")
        return camera

    def _ask(self, name: str, camera: CameraRecording) -> None:
        """Ask the server for its rig, and wait for the answer: what arrives meanwhile waits in the queue."""
        for reply in self._session.get(self._prefix + keys.rig(name), timeout=ANSWER_S):
            if reply.ok is None:
                continue
            try:
                told = decode_rig(reply.ok.payload.to_bytes())
            except InputError as error:
                self._say_once(f"camera '{name}': {error}")
                continue
            camera.answered(told, time.monotonic())
            return
        if camera.recorder is None:
            self._say_once(f"camera '{name}': nobody tells its rig; without one nothing of it can be recorded")

    def _begin(self, rig: Rig, told: "pb.RigReport") -> Recorder:
        name = rig.camera.name
        source = f"published by process {told.pid} on {told.host}, version {told.version}, at {self._endpoint}"
        recorder = Recorder(self._parent, rig, source, FramesKept(0), wait=True)
        self._disks[name] = Disk(recorder, say)
        say(f"camera '{name}': recording to {recorder.folder}")
        return recorder

    def _say_if_quiet(self) -> None:
        if not self._cameras and time.monotonic() - self._began_s > QUIET_S:
            self._say_once(f"nothing is heard at {self._endpoint} yet; waiting for a server ...")

    def _say_once(self, text: str) -> None:
        if text not in self._said and len(self._said) < 100:
            self._said.add(text)
            say("".join(char if char.isprintable() else "?" for char in text)[:400])
