"""Writes a recording from its own thread, so that disks and compression never hold up the chain.

The queue is bounded. A source that can wait waits for room; a live camera never does: frames are left out first,
then whole messages, and both are counted. When the disk is full the recording ends, readable, and the rest goes on.
"""

import os
import queue
import shutil
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism import __version__
from asterism.protocol import keys
from asterism.protocol.codec import (
    decode_frame_report,
    encode_annotations,
    encode_calibration,
    encode_image,
    encode_transforms,
    report_pose,
)
from asterism.protocol.errors import WorldError
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import ANNOTATIONS, CALIBRATION, FRAME_REPORT, IMAGE, TRANSFORMS, Message
from asterism.protocol.rig import Rig
from asterism.recordings.series import Series
from asterism.recordings.told import OFFSET_KEY

POSES_SPLIT_BYTES = 512 << 20
FRAMES_SPLIT_BYTES = 2 << 30
FLUSH_S = 1.0
QUEUE = 48  # frames; at 1.3 MB each some 60 MB
RESERVE_BYTES = 4 << 20  # given up when the disk is full, so that the index finds room
RESERVE = ".reserve"


@dataclass(frozen=True, slots=True)
class _Item:
    messages: Sequence[Message]
    image: NDArray[np.uint8] | None
    time_ns: int
    sequence: int


class Recorder:
    """Records what it is given into a new folder <parent>/<camera>-<UTC start>.

    ``frames_every``: 1 records every frame, N every Nth, 0 none. ``wait``: `write` waits for room (files) instead of
    leaving out (live cameras). Raises WorldError when the folder cannot be made.
    """

    def __init__(self, parent: Path, rig: Rig, source: str, frames_every: int, wait: bool) -> None:
        started = datetime.now(UTC)
        self.folder = _new_folder(parent, f"{rig.camera.name}-{started:%Y%m%dT%H%M%SZ}")
        self.frames_left_out = 0
        self.messages_left_out = 0
        self.problem = ""  # why the recording ended early, a sentence
        self._rig = rig
        self._frames_every = frames_every
        self._wait = wait
        metadata = {
            "version": __version__,
            "camera": rig.camera.name,
            "frame_id": rig.parent_frame,
            "source": source,
            "started": started.isoformat(),
            "rig.yaml": rig.rig_text,
            "camera.yaml": rig.camera_text,
            **{f"{OFFSET_KEY}{name}": text for name, text in rig.offset_texts.items()},
        }
        try:
            with (self.folder / RESERVE).open("wb") as reserve:
                os.posix_fallocate(reserve.fileno(), 0, RESERVE_BYTES)
        except OSError as error:
            raise WorldError(f"{self.folder}: cannot be recorded to ({error.strerror})") from None
        self._poses = Series(self.folder, "poses", "zstd", POSES_SPLIT_BYTES, metadata, self._first_messages)
        self._frames = Series(self.folder, "frames", "lz4", FRAMES_SPLIT_BYTES, metadata, list)
        self._queue: queue.Queue[_Item | None] = queue.Queue(QUEUE)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def bytes_written(self) -> int:
        """How much is on the disk by now."""
        return self._poses.bytes_written + self._frames.bytes_written

    def bytes_free(self) -> int:
        """How much room the disk has left, 0 where it cannot be asked."""
        try:
            return shutil.disk_usage(self.folder).free
        except OSError:
            return 0

    def write(self, messages: Sequence[Message], image: NDArray[np.uint8] | None, time_ns: int, sequence: int) -> None:
        """Record messages and, if it is its turn, the image they came from."""
        if self.problem:
            self.messages_left_out += len(messages)
            self.frames_left_out += image is not None
            return
        if image is not None and (self._frames_every == 0 or sequence % self._frames_every):
            image = None
        if self._wait:
            self._queue.put(_Item(messages, image, time_ns, sequence))
            return
        # Images are what takes long: leave them out while there is still room for poses.
        if image is not None and self._queue.qsize() > QUEUE // 2:
            image = None
            self.frames_left_out += 1
        try:
            self._queue.put_nowait(_Item(messages, image, time_ns, sequence))
        except queue.Full:
            self.messages_left_out += len(messages)

    def close(self, ending: dict[str, str]) -> None:
        """Write what is queued, finish the files; ``ending`` goes into their last metadata."""
        self._ending = {
            **ending,
            "frames_left_out": str(self.frames_left_out),
            "messages_left_out": str(self.messages_left_out),
        }
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                item = self._queue.get(timeout=max(FLUSH_S - (time.monotonic() - flushed), 0.01))
            except queue.Empty:
                item = _Item((), None, 0, 0)
            if self.problem:
                if item is None:
                    return
                self.messages_left_out += len(item.messages)
                self.frames_left_out += item.image is not None
                continue
            try:
                if item is None:
                    self._poses.close(self._ending)
                    self._frames.close(self._ending)
                    (self.folder / RESERVE).unlink(missing_ok=True)
                    return
                self._record(item)
                if time.monotonic() - flushed >= FLUSH_S:
                    self._poses.flush()
                    self._frames.flush()
                    flushed = time.monotonic()
            except OSError as error:
                self._end_early(error)
                if item is None:
                    return

    def _record(self, item: _Item) -> None:
        for message in item.messages:
            self._poses.add(message)
            if message.kind is FRAME_REPORT:
                for extra in self._for_viewers(message):
                    self._poses.add(extra)
        if item.image is not None:
            payload = encode_image(item.time_ns, self._rig.camera, item.image)
            key = keys.image(self._rig.camera.name)
            self._frames.add(Message(key, IMAGE, payload, item.time_ns, item.time_ns, item.sequence))

    def _end_early(self, error: OSError) -> None:
        """The disk takes no more: make room for the index, leave both files readable."""
        self.problem = f"{self.folder}: the recording ended early ({error.strerror})"
        (self.folder / RESERVE).unlink(missing_ok=True)
        for series in (self._poses, self._frames):
            series.abandon()

    def _first_messages(self) -> list[Message]:
        """What every poses file begins with: the calibration, and where the camera stands."""
        rig = self._rig
        name = rig.camera.name
        first = [
            Message(keys.calibration(name), CALIBRATION, encode_calibration(0, rig.camera), 0, 0, 0),
        ]
        if rig.T_world_camera is not None:
            payload = encode_transforms(0, [("world", name, rig.T_world_camera)])
            first.append(Message(keys.TRANSFORMS, TRANSFORMS, payload, 0, 0, 0))
        return first

    def _for_viewers(self, message: Message) -> list[Message]:
        """Transforms and annotations derived from a frame report, for programs that draw."""
        report = decode_frame_report(message.payload)
        transforms: list[tuple[str, str, Pose]] = []
        for robot in report.robots:
            if not robot.HasField("pose"):
                continue
            pose = report_pose(robot.pose)
            transforms.append((report.frame_id, robot.id, pose))
            for name, point in self._rig.robot(robot.id).points.items():
                transforms.append((robot.id, f"{robot.id}/{name}", Pose(point, np.array([0.0, 0.0, 0.0, 1.0]))))
        times = (message.log_ns, message.publish_ns, message.sequence)
        annotations = encode_annotations(message.log_ns, report)
        return [
            Message(keys.TRANSFORMS, TRANSFORMS, encode_transforms(message.log_ns, transforms), *times),
            Message(keys.annotations(self._rig.camera.name), ANNOTATIONS, annotations, *times),
        ]


def _new_folder(parent: Path, name: str) -> Path:
    """Make parent/name, with a number behind it if there is one already."""
    for number in range(1, 1000):
        folder = parent / (name if number == 1 else f"{name}-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise WorldError(f"{folder}: cannot be made ({error.strerror})") from None
        return folder
    raise WorldError(f"{parent / name}: a thousand recordings of this second exist already")
