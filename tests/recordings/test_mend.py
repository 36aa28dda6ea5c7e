"""Damaged recordings: readers refuse in a sentence, `recover` keeps what can be read, and all read what it mended."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.recordings.chunks import Chunk
from asterism.recordings.mend import mend
from asterism.recordings.reader import Recording
from asterism.recordings.records import HEAD
from tests.recordings.judge import read_all, readers_refuse_in_a_sentence, recovered
from tests.recordings.mutations import (
    BOMBS,
    MUTATIONS,
    hand_made,
    packed_record,
    payloads,
    records_of,
    untouched,
    write_file,
    write_old,
)

FRAMES = 24
A_CHUNK = 9  # messages: three frames


@pytest.fixture(params=["new", "old"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A small recording, as this version and version 0.1 write them."""
    told, images = hand_made(FRAMES, np.random.default_rng(5))
    place = tmp_path / "recording"
    place.mkdir()
    if request.param == "new":
        write_file(place, "poses", told, "zstd", A_CHUNK)
        write_file(place, "frames", images, "", 3)
    else:
        write_old(place / "poses-0001.mcap", told, "zstd", A_CHUNK)
        write_old(place / "frames-0001.mcap", images, "lz4", 3)
    return place


@pytest.mark.parametrize("kind", MUTATIONS)
def test_what_can_be_read_is_kept_and_read_by_all(folder: Path, kind: str, rng: np.random.Generator) -> None:
    whole = {file: file.read_bytes() for file in folder.iterdir()}
    for _ in range(2):
        for file, data in whole.items():
            for left in folder.iterdir():
                left.unlink()
            damage = MUTATIONS[kind](data, rng)
            for other, content in whole.items():
                other.write_bytes(damage.data if other == file else content)
            readers_refuse_in_a_sentence(folder)
            recovered(folder, payloads(data, untouched(data, damage)))


def chunks_of(file: Path) -> list[tuple[int, int]]:
    return [(begin, end) for begin, end, opcode in records_of(file.read_bytes()) if opcode == 6]


def test_what_is_lost_is_told_in_seconds_and_the_old_file_is_kept(folder: Path) -> None:
    file = folder / "poses-0001.mcap"
    data = bytearray(file.read_bytes())
    begin, end = chunks_of(file)[2]
    data[(begin + end) // 2] ^= 4
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"run this first: .*recover"):
        read_all(folder)
    mended = mend([file])[0]
    # Chunks of three frames at 60 Hz: nothing between frame 5 and frame 9.
    assert "0.07 s lost from 0.08 s on" in str(mended)
    assert mended.kept == 3 * (FRAMES - 3)
    assert (folder / "poses-0001.mcap.damaged").read_bytes() == data
    assert len(read_all(folder)) == 4 * FRAMES - A_CHUNK


def test_a_lost_chunk_is_missed_by_what_the_index_tells(folder: Path) -> None:
    file = folder / "frames-0001.mcap"
    data = file.read_bytes()
    begin, _ = chunks_of(file)[3]
    end = chunks_of(file)[4][0]
    file.write_bytes(data[:begin] + data[end:])
    assert "0.07 s lost from 0.13 s on" in str(mend([file])[0])
    assert len(list(Recording(folder).frames())) == FRAMES - 3


def test_channels_that_are_lost_are_told_by_the_messages(folder: Path) -> None:
    """Version 0.1 wrote channels into the first chunk and the index only: cut the end off, spoil the first chunk."""
    file = folder / "poses-0001.mcap"
    chunks = chunks_of(file)
    data = bytearray(file.read_bytes()[: chunks[-1][1]])
    data[chunks[0][1] - 20] ^= 1
    file.write_bytes(data)
    keys = [(message.key, message.kind) for message in hand_made(FRAMES, np.random.default_rng(5))[0]]
    mend([file])
    assert [(m.key, m.kind) for m in Recording(folder).messages()] == keys[A_CHUNK:]


def test_an_empty_part_is_removed_and_said(folder: Path) -> None:
    (folder / "frames-0002.mcap").write_bytes(b"")
    with pytest.raises(InputError, match=r"frames-0002\.mcap: was cut off .*recover"):
        Recording(folder)
    assert [str(one) for one in mend(sorted(folder.iterdir()))][1].endswith("it was empty and is removed")
    assert len(read_all(folder)) == 4 * FRAMES


def test_a_part_that_holds_nothing_is_set_aside(folder: Path) -> None:
    (folder / "poses-0002.mcap").write_bytes(b"not at all a recording" * 40)
    mended = mend(sorted(folder.iterdir()))[-1]
    assert "nothing in it can be read" in str(mended)
    assert (folder / "poses-0002.mcap.damaged").exists()
    assert len(read_all(folder)) == 4 * FRAMES


def test_without_poses_the_frames_are_read(folder: Path) -> None:
    (folder / "poses-0001.mcap").unlink()
    recording = Recording(folder)
    assert recording.rig().camera.name == "demo"
    assert len(list(recording.frames())) == FRAMES


def test_where_nothing_can_be_read_nothing_is_changed(tmp_path: Path) -> None:
    file = tmp_path / "poses-0001.mcap"
    file.write_bytes(bytes(range(256)) * 20)
    with pytest.raises(InputError, match="holds nothing that can be read"):
        mend([file])
    assert file.read_bytes() == bytes(range(256)) * 20


def test_what_is_no_file_is_refused_and_left_alone(folder: Path) -> None:
    target = folder.parent / "target.mcap"
    (folder / "poses-0001.mcap").rename(target)
    target.write_bytes(target.read_bytes()[:-300])
    before = target.read_bytes()
    place = folder / "poses-0001.mcap"
    place.symlink_to(target)
    with pytest.raises(InputError, match=r"poses-0001\.mcap: is a link"):
        mend([place])
    assert target.read_bytes() == before
    place.unlink()
    os.mkfifo(place)
    for call in (lambda: mend([place]), lambda: Recording(folder)):
        with pytest.raises(InputError, match=r"poses-0001\.mcap: is a pipe, expected a file"):
            call()
    place.unlink()
    place.mkdir()
    for call in (lambda: mend([place]), lambda: Recording(folder)):
        with pytest.raises(InputError, match=r"poses-0001\.mcap: is a folder, expected a file"):
            call()
    place.rmdir()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(place))
        with pytest.raises(InputError, match="is a socket"):
            Recording(folder)


def test_a_full_disk_leaves_the_damaged_file_as_it_was(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from asterism.protocol.errors import WorldError
    from asterism.recordings import writer

    file = folder / "poses-0001.mcap"
    data = bytearray(file.read_bytes())
    data[sum(chunks_of(file)[2]) // 2] ^= 4
    file.write_bytes(data)

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writer.os, "writev", full)
    with pytest.raises(WorldError, match="cannot be written"):
        mend([file])
    assert file.read_bytes() == data
    assert sorted(path.name for path in folder.iterdir()) == ["frames-0001.mcap", "poses-0001.mcap"]


def test_every_chunk_can_be_read_alone(tmp_path: Path) -> None:
    told, _ = hand_made(6, np.random.default_rng(1))
    write_file(tmp_path, "poses", told, "", 3)
    data = (tmp_path / "poses-0001.mcap").read_bytes()
    for begin, end in chunks_of(tmp_path / "poses-0001.mcap"):
        chunk = Chunk(data[begin + HEAD.size : end]).read()
        assert {message.channel for message in chunk.messages} == set(chunk.channels)
        assert {channel.schema_id for channel in chunk.channels.values()} == set(chunk.schemas)


def test_what_is_being_recorded_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from asterism.recordings.recorder import FramesKept, Recorder
    from asterism.server.__main__ import main
    from tests.recordings.mutations import rig

    told, _ = hand_made(6, np.random.default_rng(1))
    recorder = Recorder(tmp_path, rig(), "test", FramesKept(0), wait=True)
    for message in told:
        recorder.write([message], None, message.log_ns, message.sequence)
    while not list(recorder.folder.glob("*.mcap")):
        time.sleep(0.002)
    assert main(["recover", str(recorder.folder)]) == 2
    assert f"is being written by process {os.getpid()}, which records or recovers it" in capsys.readouterr().err
    recorder.close({})
    assert [str(one).endswith("whole") for one in mend(sorted(recorder.folder.glob("*.mcap")))] == [True]


def test_a_file_full_of_bombs_takes_little_memory_and_time(folder: Path) -> None:
    """In a process of its own, whose memory is bounded: 200 chunks of 6 kB that each claim to be 60 MB."""
    file = folder / "poses-0001.mcap"
    data = file.read_bytes()
    begin, end = chunks_of(file)[1]
    like = Chunk(data[begin + HEAD.size : end])
    bombs = b"".join(packed_record(BOMBS[0][0], "zstd", 60 << 20, number, like) for number in range(1, 200))
    file.write_bytes(data[:begin] + bombs + data[end:])
    limit = "import resource; resource.setrlimit(resource.RLIMIT_DATA, (300 << 20, 300 << 20))\n"
    call = "from asterism.server.__main__ import main; import sys; sys.exit(main())"
    told = subprocess.run(
        [sys.executable, "-c", limit + call, "recover", str(folder)], capture_output=True, text=True, check=False
    )
    assert (told.returncode, told.stderr) == (0, "")
    assert f"{3 * FRAMES - A_CHUNK} messages" in told.stdout
