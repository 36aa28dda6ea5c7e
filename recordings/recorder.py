"""Writes a recording from its own thread, so that disks and compression never hold up the chain.

The queue is bounded. A source that can wait waits for room; a live camera never does: frames are left out first,
then whole messages, and both are counted. On a full disk frames stop first, then poses; both go on, in new files, once
there is room again.
"""

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism import __version__
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report, image_parts
from asterism.protocol.errors import WorldError
from asterism.protocol.messages import FRAME_REPORT, IMAGE, PROTOCOL, Message
from asterism.protocol.rig import Rig
from asterism.recordings.held import Hold, hold
from asterism.recordings.packing import PLAIN, ZSTD, ZSTD_AND_CRC
from asterism.recordings.room import Room
from asterism.recordings.series import Series
from asterism.recordings.spots import Spots, SpotWindows
from asterism.recordings.told import rig_metadata
from asterism.recordings.viewers import Viewers, first_messages

_LOG = logging.getLogger(__name__)

POSES_SPLIT_BYTES = 512 << 20
FRAMES_SPLIT_BYTES = 2 << 30
LIMIT_PARTS = 16  # frames files of a recording of limited size, about: the oldest goes when there are too many
FLUSH_S = 0.5
RETRY_S = 1.0  # after a write failed
QUEUE = 48  # frames; at 1.3 MB each some 60 MB


class FramesKept(NamedTuple):
    """``every`` Nth frame, 0 for none; of ``spots`` only the windows around them."""

    every: int = 1
    spots: bool = False


@dataclass(frozen=True, slots=True)
class _Item:
    messages: Sequence[Message]
    image: NDArray[np.uint8] | None
    time_ns: int
    sequence: int
    rig: Rig | None = None  # in force for it; None where it is nothing but a look at the clock


class Recorder:
    """Records what it is given into a new folder <parent>/<camera>-<UTC start>.

    ``wait``: `write` waits for room (files) instead of leaving out (live cameras). ``limit_bytes``: the oldest frames
    files are deleted where the recording would become larger; poses stay. Raises WorldError when the folder cannot be
    made. ``timed``: what was written is brought to the file twice a second; otherwise the same messages make the same
    files, to the byte, but for when they were begun.

    ``problem`` says, in a sentence, what is not recorded at the moment, and after `close` what was not.
    """

    def __init__(
        self,
        parent: Path,
        rig: Rig,
        source: str,
        kept: FramesKept,
        wait: bool,
        limit_bytes: int | None = None,
        timed: bool = True,
    ) -> None:
        started = datetime.now(UTC)
        self.folder = _new_folder(parent, f"{rig.camera.name}-{started:%Y%m%dT%H%M%SZ}")
        self.problem = ""
        self.frames_deleted = 0
        self._behind, self._lost = [0, 0], [0, 0]  # frames and messages, left out by `write` and by the disk
        self._rig = rig  # of the files that are being written
        self._taken = rig  # of what is given to be written
        self._kept = kept
        self._viewers = Viewers(rig)
        self._wait = wait
        self._timed = timed
        self._limit = limit_bytes
        self._room = Room(self.folder)
        self._failed: tuple[str, float] | None = None  # why nothing can be written, and when that was tried last
        self._frames_failed: tuple[str, float] | None = None
        self._windows = SpotWindows(rig.camera.height, rig.camera.width) if kept.spots else None
        split = FRAMES_SPLIT_BYTES if limit_bytes is None else min(FRAMES_SPLIT_BYTES, limit_bytes // LIMIT_PARTS)
        # Where a disk knows no locks, nothing is recovered by itself either.
        self._hold: Hold | None = None
        with contextlib.suppress(OSError):
            self._hold = hold(self.folder, rig.camera.name)
        self._run_metadata = {
            "protocol": str(PROTOCOL),
            "version": __version__,
            "source": source,
            "started": started.isoformat(timespec="microseconds"),
        }
        metadata = self._run_metadata | rig_metadata(rig)
        self._poses = Series(
            self.folder, "poses", ZSTD_AND_CRC, POSES_SPLIT_BYTES, metadata, lambda: first_messages(self._rig)
        )
        self._frames = Series(self.folder, "frames", ZSTD if kept.spots else PLAIN, split, metadata, list)
        self._queue: queue.Queue[_Item | None] = queue.Queue(QUEUE)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def frames_left_out(self) -> int:
        """Frames that should have been recorded and were not."""
        return self._behind[0] + self._lost[0]

    @property
    def messages_left_out(self) -> int:
        """Poses and reports that were not recorded."""
        return self._behind[1] + self._lost[1]

    @property
    def bytes_written(self) -> int:
        """How much is on the disk by now."""
        return self._poses.bytes_written + self._frames.bytes_written

    def bytes_free(self) -> int:
        """How much room the disk has left, 0 where it cannot be asked."""
        return self._room.free

    def take_rig(self, rig: Rig) -> None:
        """Another rig is in force for everything that is written from now on: it begins new files."""
        self._taken = rig

    def write(self, messages: Sequence[Message], image: NDArray[np.uint8] | None, time_ns: int, sequence: int) -> None:
        """Record messages and, if it is its turn, the image they came from."""
        if image is not None and (self._kept.every == 0 or sequence % self._kept.every):
            image = None
        if self._wait:
            self._queue.put(_Item(messages, image, time_ns, sequence, self._taken))
            return
        # Images are what takes long: leave them out while there is still room for poses.
        if image is not None and self._queue.qsize() > QUEUE // 2:
            image = None
            self._behind[0] += 1
        try:
            self._queue.put_nowait(_Item(messages, image, time_ns, sequence, self._taken))
        except queue.Full:
            self._behind[0] += image is not None
            self._behind[1] += len(messages)

    def close(self, ending: dict[str, str]) -> None:
        """Write what is queued, finish the files; ``ending`` goes into their last metadata."""
        self._ending = ending
        self._queue.put(None)
        self._thread.join()
        if self._hold is not None:
            self._hold.release()

    def _run(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                item = self._queue.get(timeout=max(FLUSH_S - (time.monotonic() - flushed), 0.01))
            except queue.Empty:
                item = _Item((), None, 0, 0)
            if item is None:
                self._finish()
                return
            try:
                self._record(item)
            except Exception as error:  # a fault of the program must not end the recording, nor hold up who writes
                _LOG.exception("frame %d", item.sequence)
                self._lost[0] += item.image is not None
                self._stop(OSError(0, f"a fault of the program: {error!r}"))
            if time.monotonic() - flushed >= FLUSH_S:
                if self._timed:
                    self._flush()
                flushed = time.monotonic()

    def _record(self, item: _Item) -> None:
        if item.rig is not None and item.rig is not self._rig:
            self._change_rig(item.rig)
        report: pb.FrameReport | None = None
        if self._writes():
            added = 0
            try:
                for message in item.messages:
                    added += 1
                    self._poses.add(message)
                    if message.kind is FRAME_REPORT:
                        report = decode_frame_report(message.payload)
                        for extra in self._viewers.messages(message, report):
                            self._poses.add(extra)
            except OSError as error:
                self._lost[1] += len(item.messages) - added
                self._stop(error)
        else:
            self._lost[1] += len(item.messages)
        if item.image is None:
            return
        if not self._writes_frames():
            self._lost[0] += 1
            return
        try:
            self._image(item, item.image, report)
        except OSError as error:
            self._stop_frames(error)

    def _change_rig(self, rig: Rig) -> None:
        self._rig, self._viewers = rig, Viewers(rig)
        metadata = self._run_metadata | rig_metadata(rig)
        for series, stop in ((self._poses, self._stop), (self._frames, self._stop_frames)):
            try:
                series.begin_anew(metadata)
            except OSError as error:
                stop(error)

    def _image(self, item: _Item, image: NDArray[np.uint8], report: "pb.FrameReport | None") -> None:
        if self._windows is not None:
            told = pb.Spots() if report is None else report.spots
            image = self._windows.keep(image, Spots(*map(np.array, (told.x, told.y, told.radius, told.fate))))
        parts = image_parts(item.time_ns, self._rig.camera, image)
        times = (item.time_ns, item.time_ns)
        message = Message(keys.image(self._rig.camera.name), IMAGE, b"", *times, item.sequence)
        self._frames.add(message, parts)
        if self._windows is not None:
            self._frames.flush()  # the next frame has the same buffer
        self._keep_within_limit()

    def _keep_within_limit(self) -> None:
        """Delete the oldest frames while the recording is larger than it may be."""
        while self._limit is not None and self.bytes_written > self._limit and self._frames.finished:
            self.frames_deleted += self._frames.delete_oldest()

    def _flush(self) -> None:
        if self._writes():
            try:
                self._poses.flush()
            except OSError as error:
                self._stop(error)
        if self._writes_frames():
            try:
                self._frames.flush()
            except OSError as error:
                self._stop_frames(error)

    def _writes(self) -> bool:
        """Whether the disk takes poses; after it did not, that is tried again every now and then."""
        if self._failed is None:
            return True
        why, tried_s = self._failed
        if time.monotonic() - tried_s < RETRY_S:
            return False
        self._failed = None if self._room.take_again() else (why, time.monotonic())
        self._tell()
        return self._failed is None

    def _writes_frames(self) -> bool:
        if self._failed is not None:
            return False
        stopped = self._frames_failed
        if stopped is not None and time.monotonic() - stopped[1] < RETRY_S:
            return False
        if self._room.has_for_frames(stopped is not None):
            self._frames_failed = None
        else:
            self._frames_failed = ("the disk is nearly full", time.monotonic())
        if (stopped is None) != (self._frames_failed is None):
            self._tell()
        return self._frames_failed is None

    def _stop(self, error: OSError) -> None:
        """The disk takes no more: make room for the index, leave both files readable."""
        self._failed = (error.strerror or "the disk fails", time.monotonic())
        self._room.give_up()
        self._lost[1] += self._poses.abandon()
        self._lost[0] += self._frames.abandon()
        self._tell()

    def _stop_frames(self, error: OSError) -> None:
        self._frames_failed = (error.strerror or "the disk fails", time.monotonic())
        self._room.give_half()
        self._lost[0] += self._frames.abandon()
        self._tell()

    def _tell(self) -> None:
        if self._failed is not None:
            self.problem = f"{self.folder}: nothing is recorded at the moment ({self._failed[0]})"
        elif self._frames_failed is not None:
            self.problem = f"{self.folder}: only poses are recorded at the moment ({self._frames_failed[0]})"
        else:
            self.problem = ""

    def _finish(self) -> None:
        for series in (self._poses, self._frames):
            try:
                series.close({**self._ending, **self._counts()})
            except OSError:
                self._room.give_up()
                self._lost[series is self._poses] += series.abandon()
        self._room.give_up()
        frames, messages = self._lost
        if not self.folder.exists():
            self.problem = f"{self.folder}: somebody removed it while it was recorded to"
        elif frames or messages:
            self.problem = (
                f"{self.folder}: the disk did not take everything: {frames} frames and {messages} messages are missing"
            )
        else:
            self.problem = ""

    def _counts(self) -> dict[str, str]:
        return {
            "frames_left_out": str(self.frames_left_out),
            "messages_left_out": str(self.messages_left_out),
            "frames_deleted": str(self.frames_deleted),
        }


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
