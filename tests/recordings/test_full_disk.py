"""A full disk: frames stop before poses, both go on once there is room, and what is missing is told."""

import errno
import os
import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import WorldError
from asterism.protocol.messages import Message
from asterism.recordings import recorder, room, writer
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from tests.recordings.judge import read_all
from tests.recordings.mutations import hand_made, rig

IMAGE = np.arange(1024 * 1280, dtype=np.uint32).astype(np.uint8).reshape(1024, 1280)
DEADLINE_S = 20.0


class SmallDisk:
    """A disk with little room, of which the recorder's files and its reserve take theirs."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, size: int) -> None:
        self.size, self.used = size, 0
        self._writev = os.writev
        monkeypatch.setattr(writer.os, "writev", self._write)
        monkeypatch.setattr(room.Room, "free", property(lambda _: max(self.size - self.used, 0)))
        keep = room.Room._keep

        def kept(of: room.Room, size: int) -> None:
            if size - of._kept > self.size - self.used:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self.used += size - of._kept
            keep(of, size)

        monkeypatch.setattr(room.Room, "_keep", kept)

    def _write(self, file: int, parts: Sequence[memoryview]) -> int:
        """As the kernel does it: the last piece is cut, then nothing goes."""
        left = self.size - self.used
        if left <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done = self._writev(file, [parts[0][:left]])
        self.used += done
        return done


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)
    monkeypatch.setattr(recorder, "RETRY_S", 0.0)


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def messages_of(index: int, told: list[Message]) -> list[Message]:
    return told[3 * index : 3 * index + 3]


def recorded(folder: Path) -> tuple[list[int], list[int]]:
    """The frames whose reports, and whose images, are there."""
    recording = Recording(folder)
    reports = [m.sequence for m in recording.messages() if m.kind.schema == "asterism.FrameReport"]
    return reports, [number for _, _, number in recording.frames()]


def test_frames_stop_first_and_all_goes_on_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    disk = SmallDisk(monkeypatch, 30_000_000)
    monkeypatch.setattr(room, "POSES_BYTES", 6_000_000)
    told, _ = hand_made(60, rng)
    made = Recorder(tmp_path, rig(), "test", FramesKept(), wait=True)

    def write(first: int, last: int) -> None:
        for index in range(first, last):
            made.write(messages_of(index, told), IMAGE, told[3 * index].log_ns, index)
        until(made._queue.empty)

    write(0, 30)
    until(lambda: "only poses are recorded at the moment" in made.problem)
    assert made.frames_left_out > 0
    assert made.messages_left_out == 0
    disk.size = disk.used  # the rest is taken by somebody else
    write(30, 40)
    until(lambda: "nothing is recorded at the moment" in made.problem)
    disk.size = 500_000_000
    until(lambda: made.problem == "")
    write(40, 60)
    made.close({})
    reports, images = recorded(made.folder)
    # The thread that writes may have had 29 in its hands when the disk became full; it is counted below then.
    assert set(range(29)) | set(range(41, 60)) <= set(reports)
    assert set(range(41, 60)) <= set(images)
    assert images[0] == 0
    assert made.messages_left_out == 3 * (60 - len(reports))
    assert made.frames_left_out == 60 - len(images)
    assert f"{made.frames_left_out} frames and {made.messages_left_out} messages are missing" in made.problem
    assert len(list(made.folder.glob("poses-*"))) > 1
    assert not (made.folder / room.RESERVE).exists()
    read_all(made.folder)


@pytest.mark.parametrize("size", [4_250_000, 4_600_000, 5_500_000, 9_000_000])
def test_on_a_disk_that_stays_full_the_recording_is_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator, size: int
) -> None:
    disk = SmallDisk(monkeypatch, size)
    monkeypatch.setattr(room, "POSES_BYTES", 0)
    told, _ = hand_made(30, rng)
    made = Recorder(tmp_path, rig(), "test", FramesKept(), wait=True)
    for index in range(30):
        made.write(messages_of(index, told), IMAGE, told[3 * index].log_ns, index)
        disk.size = min(disk.size, size)
    made.close({})
    reports, images = recorded(made.folder)
    assert made.messages_left_out == 3 * (30 - len(reports))
    assert made.frames_left_out == 30 - len(images)
    assert "are missing" in made.problem


def test_a_recording_of_limited_size_loses_its_oldest_frames_and_no_poses(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    told, _ = hand_made(60, rng)
    made = Recorder(tmp_path, rig(), "test", FramesKept(), wait=True, limit_bytes=20_000_000)
    for index in range(60):
        made.write(messages_of(index, told), IMAGE, told[3 * index].log_ns, index)
    made.close({})
    assert sum(file.stat().st_size for file in made.folder.iterdir()) < 20_000_000 + 2 * IMAGE.nbytes
    reports, images = recorded(made.folder)
    assert reports == list(range(60))
    assert images == list(range(60 - len(images), 60))
    assert len(images) >= 10
    assert made.frames_deleted == 60 - len(images)
    assert made.frames_left_out == 0


def test_a_fault_of_the_program_ends_no_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    told, _ = hand_made(60, rng)
    made = Recorder(tmp_path, rig(), "test", FramesKept(), wait=True)
    image, faults = made._image, iter([True] * 3)

    def faulty(*of: object) -> None:
        if next(faults, False):
            raise ValueError("never thought of")
        image(*of)  # type: ignore[arg-type]

    monkeypatch.setattr(made, "_image", faulty)
    for index in range(60):  # more than the queue holds
        made.write(messages_of(index, told), IMAGE, told[3 * index].log_ns, index)
    made.close({})
    reports, images = recorded(made.folder)
    assert images == list(range(3, 60))
    assert reports[-1] == 59
    assert made.frames_left_out == 3


def test_a_folder_that_is_removed_holds_up_nobody_and_is_told_of(tmp_path: Path, rng: np.random.Generator) -> None:
    told, _ = hand_made(60, rng)
    made = Recorder(tmp_path, rig(), "test", FramesKept(), wait=True)
    made.write(messages_of(0, told), IMAGE, told[0].log_ns, 0)
    until(lambda: len(list(made.folder.glob("*-0001.mcap"))) == 2)
    shutil.rmtree(made.folder)
    for index in range(1, 60):  # more than the queue holds
        made.write(messages_of(index, told), IMAGE, told[3 * index].log_ns, index)
    made.close({})
    assert made.problem == f"{made.folder}: somebody removed it while it was recorded to"


def test_what_cannot_be_begun_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    SmallDisk(monkeypatch, room.RESERVE_BYTES - 1)
    with pytest.raises(WorldError, match=r"cannot be recorded to \(No space left on device\)"):
        Recorder(tmp_path, rig(), "test", FramesKept(), wait=True)
    assert list(tmp_path.iterdir()) == []
