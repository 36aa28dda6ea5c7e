"""Recordings: every byte back, split, cut off anywhere, on a full disk, refused when they are none."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from asterism.protocol import keys
from asterism.protocol.codec import decode_image, decode_rig, encode_rig, stamped
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message
from asterism.protocol.rig import load_rig, parse_rig
from asterism.recordings.compare import compare
from asterism.recordings.mend import mend
from asterism.recordings.packing import ZSTD_AND_CRC
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.recordings.series import Series
from asterism.server import Frame, Tracks, localize
from asterism.server.chain.report import report
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene

RIG = load_rig(DEMO_RIG)
START_NS = 1_795_398_896_000_000_000
FRAMES = 6


@pytest.fixture(scope="module")
def frames() -> list[tuple[Frame, list[Message]]]:
    """Some frames of the demonstration, and their messages."""
    scene, tracks, made = Scene(RIG, 0), Tracks.none(), []
    for index in range(FRAMES):
        exposed_ns = START_NS + index * 16_666_667
        frame = Frame(scene.render(index, scene.truth(index, index / 60)), exposed_ns, index)
        result, tracks = localize(frame, RIG, tracks)
        made.append(
            (
                frame,
                [
                    stamped(message, exposed_ns + 2_000_000)
                    for message in report(frame, result, RIG, exposed_ns + 1_000_000)
                ],
            )
        )
    return made


Made = list[tuple[Frame, list[Message]]]


def record(parent: Path, frames: Made, every: int = 1) -> Recorder:
    recorder = Recorder(parent, RIG, "test", FramesKept(every), wait=True)
    for frame, messages in frames:
        recorder.write(messages, frame.image, frame.exposed_ns, frame.index)
    recorder.close({"frames": str(len(frames))})
    return recorder


def test_a_recorder_knows_how_much_it_has_written(
    tmp_path: Path, frames: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = record(tmp_path / "whole", frames)
    assert whole.bytes_written == sum(file.stat().st_size for file in whole.folder.iterdir())
    monkeypatch.setattr("asterism.recordings.recorder.FRAMES_SPLIT_BYTES", 1000)
    split = record(tmp_path / "split", frames)
    assert len(list(split.folder.glob("frames-*"))) > 1
    assert split.bytes_written == sum(file.stat().st_size for file in split.folder.iterdir())
    assert whole.bytes_free() > 0


def test_the_files_that_the_rig_names_are_kept(tmp_path: Path, frames: Made) -> None:
    text = DEMO_RIG.read_text().replace("led: {", "led: {offset: glass/led.yaml, ", 1)
    offset = "axial_shift: [-0.002, 0.0003]\nup_to_deg: 50\n"
    rig = parse_rig(text, RIG.camera_text, "demo", {"glass/led.yaml": offset})
    recorder = Recorder(tmp_path, rig, "test", FramesKept(), wait=True)
    frame, messages = frames[0]
    recorder.write(messages, frame.image, frame.exposed_ns, frame.index)
    recorder.close({})
    kept = Recording(recorder.folder).rig()
    assert kept.offset_texts == {"glass/led.yaml": offset}
    assert [robot.led_offset is None for robot in kept.robots] == [False, True, True, True, True]
    report = decode_rig(encode_rig(rig))
    assert dict(report.offset_yaml) == {"glass/led.yaml": offset}


def test_what_was_written_is_read_byte_for_byte(tmp_path: Path, frames: Made) -> None:
    recorder = record(tmp_path, frames)
    assert recorder.problem == ""
    assert sorted(path.name for path in recorder.folder.iterdir()) == ["frames-0001.mcap", "poses-0001.mcap"]
    recording = Recording(recorder.folder)
    on_wire = [message for message in recording.messages() if message.kind.on_wire]
    assert on_wire == [message for _, messages in frames for message in messages]
    images = list(recording.frames())
    assert [(time_ns, index) for _, time_ns, index in images] == [(f.exposed_ns, f.index) for f, _ in frames]
    for (image, _, _), (frame, _) in zip(images, frames, strict=True):
        np.testing.assert_array_equal(image, frame.image)
    assert encode_rig(recording.rig()) == encode_rig(RIG)
    assert recording.metadata["source"] == "test"


def test_the_mcap_library_alone_reads_it(tmp_path: Path, frames: Made) -> None:
    folder = record(tmp_path, frames).folder
    with (folder / "poses-0001.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        topics: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
            assert message.log_time >= START_NS
            topics[channel.topic] = topics.get(channel.topic, 0) + 1
    assert topics == {
        **{keys.odometry("demo", robot.id): FRAMES for robot in RIG.robots},
        keys.frame("demo"): FRAMES,
        keys.annotations("demo"): FRAMES,
        keys.calibration("demo"): 1,
        "/tf": FRAMES + 1,
    }
    with (folder / "frames-0001.mcap").open("rb") as stream:
        payloads = [message.data for _, _, message in make_reader(stream).iter_messages()]
    np.testing.assert_array_equal(decode_image(payloads[2]), frames[2][0].image)


def test_transforms_place_robots_and_their_points(tmp_path: Path, frames: Made) -> None:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    recording = Recording(record(tmp_path, frames).folder)
    told = [message for message in recording.messages() if message.key == "/tf"]
    first, second = FrameTransforms(), FrameTransforms()
    first.ParseFromString(told[0].payload)
    second.ParseFromString(told[1].payload)
    assert [(t.parent_frame_id, t.child_frame_id) for t in first.transforms] == [("world", "demo")]
    pairs = [(t.parent_frame_id, t.child_frame_id) for t in second.transforms]
    assert ("world", "alpha") in pairs
    assert ("alpha", "alpha/tool") in pairs


@pytest.mark.parametrize(("every", "kept"), [(0, []), (1, [0, 1, 2, 3, 4, 5]), (3, [0, 3])])
def test_every_nth_frame_is_recorded(tmp_path: Path, frames: Made, every: int, kept: list[int]) -> None:
    recording = Recording(record(tmp_path, frames, every).folder)
    assert [index for _, _, index in recording.frames()] == kept
    assert recording.count_frames() == len(kept)


def test_two_recordings_of_one_second_do_not_collide(tmp_path: Path, frames: Made) -> None:
    folders = {record(tmp_path, frames[:1]).folder for _ in range(3)}
    assert len(folders) == 3


def test_a_file_ends_before_its_index_grows_long(tmp_path: Path, frames: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows around spots are small, and each frame is a chunk: by size alone a file would last for hours."""
    monkeypatch.setattr("asterism.recordings.series.MOST_CHUNKS", 4)
    recorder = Recorder(tmp_path, RIG, "test", FramesKept(1, spots=True), wait=True)
    for frame, messages in frames:
        recorder.write(messages, frame.image, frame.exposed_ns, frame.index)
    recorder.close({})
    assert len(list(recorder.folder.glob("frames-*"))) == 2
    assert [index for _, _, index in Recording(recorder.folder).frames()] == list(range(FRAMES))
    for file in recorder.folder.glob("frames-*"):
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 0


def test_files_are_split_by_size_and_each_can_be_read_alone(
    tmp_path: Path, frames: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("asterism.recordings.recorder.FRAMES_SPLIT_BYTES", 1_500_000)
    monkeypatch.setattr("asterism.recordings.recorder.POSES_SPLIT_BYTES", 2_000)
    monkeypatch.setattr("asterism.recordings.recorder.FLUSH_S", 0.0)
    folder = record(tmp_path, frames).folder
    assert len(list(folder.glob("frames-*.mcap"))) > 1
    poses = sorted(folder.glob("poses-*.mcap"))
    assert len(poses) > 1
    recording = Recording(folder)
    on_wire = [message for message in recording.messages() if message.kind.on_wire]
    assert on_wire == [message for _, messages in frames for message in messages]
    with poses[-1].open("rb") as stream:
        assert any(channel.topic == keys.calibration("demo") for _, channel, _ in make_reader(stream).iter_messages())


@pytest.fixture
def whole(tmp_path: Path, frames: Made, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording with a chunk for every frame."""
    monkeypatch.setattr("asterism.recordings.recorder.FLUSH_S", 0.0)
    return record(tmp_path, frames).folder


@pytest.mark.parametrize("stem", ["poses", "frames"])
def test_cut_off_anywhere_what_was_whole_is_recovered(whole: Path, frames: Made, stem: str) -> None:
    path = whole / f"{stem}-0001.mcap"
    data = path.read_bytes()
    expected = [
        m
        for m in Recording(whole).messages_and_images()
        if (m.kind.schema == "foxglove.RawImage") == (stem == "frames")
    ]
    counts = []
    for length in [*np.linspace(0.4, 0.99, 20) * len(data), len(data) - 1]:
        path.write_bytes(data[: int(length)])
        (mended,) = mend([path])
        assert str(mend([path])[0]).endswith(", whole")
        with path.open("rb") as stream:
            back = [(c.topic, m.data) for _, c, m in make_reader(stream, validate_crcs=True).iter_messages()]
        assert back == [(m.key, m.payload) for m in expected[: len(back)]]
        assert mended.kept == len(back)
        counts.append(len(back))
    assert counts == sorted(counts)
    assert counts[-1] == len(expected)


def test_recovering_twice_changes_nothing(whole: Path) -> None:
    path = whole / "poses-0001.mcap"
    path.write_bytes(path.read_bytes()[:-700])
    mend([path])
    once = path.read_bytes()
    mend([path])
    assert path.read_bytes() == once


def test_a_damaged_chunk_in_the_middle_costs_only_itself(whole: Path) -> None:
    path = whole / "frames-0001.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data[:-900])
    (mended,) = mend([path])
    assert mended.kept == FRAMES - 1
    assert len(list(Recording(whole).frames())) == FRAMES - 1


def test_a_folder_that_cannot_be_made_is_the_worlds_fault(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WorldError, match="cannot be made"):
        Recorder(tmp_path / "file", RIG, "test", FramesKept(), wait=True)


def test_a_live_camera_never_waits_for_the_recorder(
    tmp_path: Path, frames: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    import threading

    release, real = threading.Event(), Recorder._record

    def slow(self: Recorder, item: object) -> None:
        release.wait(10.0)
        real(self, item)  # type: ignore[arg-type]

    monkeypatch.setattr(Recorder, "_record", slow)
    recorder = Recorder(tmp_path, RIG, "test", FramesKept(), wait=False)
    frame, messages = frames[0]
    for _ in range(200):
        recorder.write(messages, frame.image, frame.exposed_ns, frame.index)
    assert recorder.frames_left_out > 100
    assert recorder.messages_left_out > 0
    release.set()
    recorder.close({})
    recording = Recording(recorder.folder)
    assert 0 < recording.count_frames() < 200
    with (recorder.folder / "poses-0001.mcap").open("rb") as stream:
        ending = next(entry for entry in make_reader(stream).iter_metadata() if entry.name == "asterism/end")
    assert ending.metadata["frames_left_out"] == str(recorder.frames_left_out)


def test_what_is_no_recording_is_refused(tmp_path: Path, whole: Path) -> None:
    for path, words in (
        (tmp_path / "nowhere", "there is no such recording"),
        (whole / "poses-0001.mcap", "is a file, expected a recording's folder"),
        (tmp_path, "is no recording, expected a folder with poses-0001.mcap in it"),
    ):
        with pytest.raises(InputError, match=words):
            Recording(path)
    (tmp_path / "poses-0001.mcap").write_bytes(b"something else entirely")
    with pytest.raises(InputError, match=r"poses-0001\.mcap: is no MCAP file"):
        Recording(tmp_path)


def test_a_cut_off_recording_is_refused_and_told_about_recover(whole: Path) -> None:
    path = whole / "frames-0001.mcap"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=f"was cut off .*; run this first: asterism recover {whole}"):
        Recording(whole)


def test_comparing_finds_what_differs(tmp_path: Path, frames: Made) -> None:
    from asterism.protocol.codec import decode_frame_report, set_report_pose, to_bytes

    a = Recording(record(tmp_path / "a", frames).folder)
    assert compare(a, a).within(0.0, 0.0)
    changed = []
    for frame, messages in frames:
        told = decode_frame_report(messages[-1].payload)
        if frame.index == 3:
            pose = Pose(np.array([0.001, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
            entry = told.robots[1]
            from asterism.protocol.codec import report_pose

            set_report_pose(entry.pose, pose @ report_pose(entry.pose))
        last = messages[-1]
        new = Message(last.key, FRAME_REPORT, to_bytes(told), last.log_ns, last.publish_ns, last.sequence)
        changed.append((frame, [*messages[:-1], new]))
    found = compare(a, Recording(record(tmp_path / "b", changed[:5]).folder))
    assert (found.frames_both, found.frames_only_a, found.frames_only_b) == (5, 1, 0)
    assert max(found.robots["bravo"].position_m) == pytest.approx(0.001, rel=1e-6)
    assert max(found.robots["alpha"].position_m) == 0.0
    assert not found.robots["bravo"].within(0.0005, 1.0)
    assert found.robots["bravo"].within(0.002, 1.0)


def test_a_series_registers_each_schema_once(tmp_path: Path, frames: Made) -> None:
    out = Series(tmp_path, "poses", ZSTD_AND_CRC, 1 << 30, {"version": "x"}, list)
    for message in frames[0][1]:
        out.add(message)
    out.close({})
    with (tmp_path / "poses-0001.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert sorted(schema.name for schema in summary.schemas.values()) == [FRAME_REPORT.schema, ODOMETRY.schema]
