"""What must be true of a damaged recording: readers refuse in a sentence, `recover` keeps every message that can be
read, and what it has mended every reader reads, MCAP's own among them.
"""

from io import BytesIO
from pathlib import Path

from mcap.reader import NonSeekingReader, make_reader

from asterism.protocol.codec import decode_frame_report
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT
from asterism.recordings.compare import compare
from asterism.recordings.mend import mend
from asterism.recordings.reader import Recording, recording_files


def read_all(folder: Path) -> list[bytes]:
    """Every payload, through every reader of the project; InputError is the one exception that they may raise."""
    recording = Recording(folder)
    found = [message.payload for message in recording.messages_and_images()]
    for message in recording.messages():
        if message.kind.schema == FRAME_REPORT.schema:
            decode_frame_report(message.payload)
    assert len(list(recording.frames())) <= len(found)
    recording.count_frames()
    recording.frame_rate_hz()
    compare(recording, recording)
    return found


def readers_refuse_in_a_sentence(folder: Path) -> None:
    """They raise InputError, or read."""
    refused = ""
    try:
        read_all(folder)
    except InputError as error:
        refused = str(error)
    assert "\n" not in refused
    assert len(refused) < 600


def recovered(folder: Path, untouched: list[bytes]) -> list[bytes]:
    """Recover: every message of a chunk that was left alone is there; returns all payloads."""
    try:
        mend(_files(folder))
    except InputError:
        assert not untouched, "what could be read was refused"
        return []
    again = mend(_files(folder))
    assert all(str(one).endswith("whole") for one in again), [str(one) for one in again]
    found = read_all(folder)
    plain = []
    for file in _files(folder):
        data = file.read_bytes()
        plain += [m.data for _, _, m in make_reader(BytesIO(data), validate_crcs=True).iter_messages()]
        count = sum(1 for _ in NonSeekingReader(BytesIO(data), validate_crcs=True).iter_messages())
        assert count == sum(1 for _ in make_reader(BytesIO(data)).iter_messages())
        for _ in make_reader(BytesIO(data)).iter_metadata():
            pass
    assert sorted(plain) == sorted(found)
    recording = Recording(folder)
    assert recording.count_frames() + recording.count_messages() == len(found)
    left = sorted(found)
    for payload in untouched:
        assert payload in left, "a message that could be read is lost"
    return found


def _files(folder: Path) -> list[Path]:
    poses, frames = recording_files(folder)
    return poses + frames
