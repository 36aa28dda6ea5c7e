"""Recordings of every version stay readable; tests/data/recordings/N was written by the program of protocol N.

Four frames of 32 x 24 pixels, two robots at known places, one status. They are never written anew.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.codec import decode_frame_report, decode_odometry, decode_status, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, PROTOCOL, STATUS
from asterism.recordings.compare import compare
from asterism.recordings.mend import mend
from asterism.recordings.packing import PLAIN
from asterism.recordings.reader import Recording
from asterism.recordings.series import Series
from tests.helpers import REPOSITORY
from tests.recordings.mutations import hand_made, metadata, write_file

KEPT = REPOSITORY / "tests" / "data" / "recordings"
VERSIONS = sorted(int(folder.name) for folder in KEPT.iterdir())
START_NS, STEP_NS = 1_795_398_896_000_000_000, 16_666_667


def test_there_is_one_of_every_version() -> None:
    assert list(range(1, PROTOCOL + 1)) == VERSIONS


@pytest.mark.parametrize("version", VERSIONS)
def test_a_recording_of_that_version_is_read(version: int) -> None:
    recording = Recording(KEPT / str(version))
    assert recording.metadata.get("protocol", "1") == str(version)
    assert [robot.id for robot in recording.rig().robots] == ["alpha", "bravo", "charlie", "delta", "echo"]
    messages = list(recording.messages())
    assert [m.log_ns for m in messages if m.kind == FRAME_REPORT] == [START_NS + i * STEP_NS for i in range(4)]
    for message in messages:
        if message.kind == ODOMETRY:
            told = decode_odometry(message.payload)
            other = 0.2 * (told.robot == "bravo")
            np.testing.assert_allclose(told.position, [0.1 * told.sequence, other, 0.3])
            assert (told.state, told.leds) == ("TRACKED", 6)
            assert (told.session == 0) == (version == 1)
        elif message.kind == FRAME_REPORT:
            assert len(decode_frame_report(message.payload).robots) == 2
        elif message.kind == STATUS:
            assert decode_status(message.payload).frames == 4
    for image, _, number in recording.frames():
        np.testing.assert_array_equal(image.ravel(), np.arange(48 * number, 48 * number + 768).astype(np.uint8))
    assert (recording.count_frames(), recording.frame_rate_hz()) == (4, pytest.approx(60.0, rel=1e-4))


def test_versions_compare_with_each_other() -> None:
    assert compare(Recording(KEPT / "1"), Recording(KEPT / str(PROTOCOL))).within(1e-12, 1e-12)


@pytest.mark.parametrize("version", VERSIONS)
def test_one_that_was_cut_off_is_mended(tmp_path: Path, version: int) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(KEPT / str(version), folder)
    before = [message.payload for message in Recording(folder).messages_and_images()]
    for file in folder.iterdir():
        file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(InputError, match="recover"):
        Recording(folder)
    mend(sorted(folder.iterdir()))
    assert [message.payload for message in Recording(folder).messages_and_images()] == before


@pytest.mark.parametrize("told", ["3", "99", "2.5", "newest"])
def test_a_newer_recording_is_refused_in_a_sentence(tmp_path: Path, told: str) -> None:
    series = Series(tmp_path, "poses", PLAIN, 1 << 30, {**metadata(), "protocol": told}, list)
    for message in hand_made(2, np.random.default_rng(0))[0]:
        series.add(message)
    series.close({})
    with pytest.raises(InputError, match=rf"holds messages of protocol {told}, this program reads those up to 2; "):
        Recording(tmp_path)


def test_a_report_that_no_server_makes_is_refused(tmp_path: Path) -> None:
    told, _ = hand_made(2, np.random.default_rng(5))
    for number, message in enumerate(told):
        if message.kind == FRAME_REPORT:
            report = decode_frame_report(message.payload)
            report.robots[1].pose.orientation.w = 0.0
            told[number] = replace(message, payload=to_bytes(report))
    write_file(tmp_path, "poses", told, "", 3)
    with pytest.raises(
        InputError, match=r"its report of frame 0 is none that a server makes; run this first: .*recover"
    ):
        compare(Recording(tmp_path), Recording(tmp_path))
