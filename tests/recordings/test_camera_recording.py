"""What a listener records of a camera: as its server does, with every rig, and what is missing is known."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_rig, encode_rig, in_session, stamped, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.messages import EVENT, ODOMETRY, STATUS, Message
from asterism.protocol.rig import Rig
from asterism.recordings.camera_recording import CameraRecording
from asterism.recordings.compare import compare
from asterism.recordings.from_network import arrived
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from tests.protocol import make_golden
from tests.recordings.mutations import START_NS, STEP_NS, hand_made, rig
from tests.recordings.reloaded import two_rigs
from tests.recordings.test_full_disk import SmallDisk, until

FRAMES = 6


@pytest.fixture
def told(rng: np.random.Generator) -> list[Message]:
    """A few frames, of each two poses and the report, in a server's order."""
    return [in_session(stamped(message, message.log_ns), 7) for message in hand_made(FRAMES, rng)[0]]


def event(number: int, sequence: int, happening: "pb.Happening" = pb.STATE_CHANGED, robot: str = "bravo") -> Message:
    time_ns = START_NS + sequence * STEP_NS
    made = pb.Event(
        robot=robot, happening=happening, since_ns=time_ns, sequence=sequence, number=number, session=7,
        published_ns=time_ns,
    )  # fmt: skip
    return Message(keys.event("demo"), EVENT, to_bytes(made), time_ns, time_ns, sequence)


def status(dropped: int) -> Message:
    made = pb.Status(time_ns=START_NS, source="sim", frames_dropped=dropped, session=7)
    return Message(keys.status("demo"), STATUS, to_bytes(made), START_NS, START_NS, 0)


def answer(of: Rig, session: int = 7, started_ns: int = 1) -> "pb.RigReport":
    told = decode_rig(encode_rig(of))
    told.session, told.started_ns, told.host, told.pid = session, started_ns, "bench", 4711
    return told


@dataclass
class Listener:
    """A camera's recording that is fed by hand; every question is answered at once, by ``answers`` as it is then."""

    parent: Path
    answers: "pb.RigReport | None"
    said: list[str] = field(default_factory=list)
    now_s: float = 0.0

    def __post_init__(self) -> None:
        self.camera = CameraRecording("demo", self._begin, self.said.append)

    def _begin(self, of: Rig, _: "pb.RigReport") -> Recorder:
        return Recorder(self.parent, of, "test", FramesKept(0), wait=True)

    def hears(self, messages: Sequence[Message]) -> "Listener":
        for message in messages:
            self.camera.arrived(arrived(message.key, message.payload), self.now_s)
            self.ask()
        return self

    def ask(self) -> None:
        if self.camera.asks(self.now_s) and self.answers is not None:
            self.camera.answered(self.answers, self.now_s)

    def recordings(self) -> list[Recording]:
        """All that is recorded, finished."""
        self.camera.finish()
        folders = sorted(self.parent.iterdir(), key=lambda folder: (len(folder.name), folder.name))
        return [Recording(folder) for folder in folders]


def on_wire(recording: Recording) -> list[tuple[str, bytes, int, int, int]]:
    wire = (message for message in recording.messages() if message.kind.on_wire)
    return [(m.key, m.payload, m.log_ns, m.publish_ns, m.sequence) for m in wire]


def served(parent: Path, messages: list[Message]) -> Recording:
    """As the server records them."""
    recorder = Recorder(parent, rig(), "test", FramesKept(0), wait=True)
    recorder.write(messages, None, START_NS, 0)
    recorder.close({})
    return Recording(recorder.folder)


def test_what_is_heard_is_recorded_as_the_server_records_it(tmp_path: Path, told: list[Message]) -> None:
    messages = [*told[:6], event(1, 1), *told[6:]]
    (heard,) = Listener(tmp_path / "heard", answer(rig())).hears(messages).recordings()
    own = served(tmp_path / "own", messages)
    assert on_wire(heard) == on_wire(own)
    assert [m.key for m in heard.messages()] == [m.key for m in own.messages()]  # what is for viewers as well
    assert compare(heard, own).within(0.0, 0.0)
    assert encode_rig(heard.rig()) == encode_rig(own.rig())


def test_frames_reports_that_come_late_stand_where_they_belong(tmp_path: Path, told: list[Message]) -> None:
    # Poses overtake reports, and events too: each kind has its queue.
    poses, reports = [m for m in told if m.kind is ODOMETRY], [m for m in told if m.kind is not ODOMETRY]
    late = [*poses[:6], event(1, 1), *reports[:2], *poses[6:], event(2, 3), *reports[2:]]
    (heard,) = Listener(tmp_path / "heard", answer(rig())).hears(late).recordings()
    assert on_wire(heard) == on_wire(
        served(tmp_path / "own", [*told[:6], event(1, 1), *told[6:12], event(2, 3), *told[12:]])
    )


def test_events_keep_their_order_also_where_one_was_held_back(tmp_path: Path, told: list[Message]) -> None:
    held_back = event(3, 1)  # of a robot that flickered: told with frame 3
    events = [event(1, 0), event(2, 3), held_back, event(4, 4)]
    listener = Listener(tmp_path, answer(rig())).hears([*told[:9], events[0], *events[1:3], *told[9:], events[3]])
    assert listener.camera.missing.events == 0
    (heard,) = listener.recordings()
    assert [m.payload for m in heard.messages() if m.kind.schema == EVENT.schema] == [m.payload for m in events]


def test_what_never_comes_of_a_frame_holds_nothing_up(tmp_path: Path, told: list[Message]) -> None:
    listener = Listener(tmp_path, answer(rig()))
    order = listener.camera._order
    listener.hears(told[:2])  # its report is missing
    listener.hears(told[3:4])
    assert len(order._frames) == 2
    listener.hears(told[4:6])  # those of the frame behind it are all there: it was lost
    assert not order._frames
    listener.hears([told[6], told[8]])  # a pose is missing
    assert len(order._frames) == 1
    listener.now_s += 1.0  # nothing else comes for long
    listener.hears([told[9]])
    assert list(order._frames) == [3]


def test_nothing_is_lost_while_the_rig_is_waited_for(tmp_path: Path, told: list[Message]) -> None:
    listener = Listener(tmp_path, None).hears(told[:9])
    assert listener.camera.recorder is None
    listener.answers, listener.now_s = answer(rig()), 1.0
    (heard,) = listener.hears(told[9:]).recordings()
    assert on_wire(heard) == on_wire(served(tmp_path / "own", told))
    assert listener.camera.waiting_lost == 0


def test_who_never_tells_its_rig_is_not_recorded_and_that_is_counted(tmp_path: Path, told: list[Message]) -> None:
    listener = Listener(tmp_path / "heard", None).hears(told)
    listener.camera.finish()
    assert listener.camera.waiting_lost == len(told)
    assert not (tmp_path / "heard").exists()


def test_a_server_that_starts_anew_begins_another_recording(tmp_path: Path, told: list[Message]) -> None:
    listener = Listener(tmp_path, answer(rig())).hears(told[:9])
    listener.answers = answer(two_rigs()[0], session=8, started_ns=2)
    first, second = listener.hears([in_session(message, 8) for message in told]).recordings()
    assert (len(on_wire(first)), len(on_wire(second))) == (9, len(told))
    assert len(second.rig().robots) == len(first.rig().robots) - 1


def test_a_clock_that_was_set_begins_none(tmp_path: Path, told: list[Message]) -> None:
    listener = Listener(tmp_path, answer(rig())).hears(told[:9])
    listener.answers = answer(rig(), session=8)
    (heard,) = listener.hears([in_session(message, 8) for message in told[9:]]).recordings()
    assert len(on_wire(heard)) == len(told)
    assert len(heard.rigs()) == 1


def test_a_replay_that_plays_again_is_another_recording(tmp_path: Path, told: list[Message]) -> None:
    listener = Listener(tmp_path, answer(rig())).hears(told)
    listener.answers = answer(rig(), session=8)
    first, second = listener.hears([in_session(message, 8) for message in told]).recordings()
    assert len(on_wire(first)) == len(on_wire(second)) == len(told)


@pytest.mark.parametrize("late", [False, True], ids=["in order", "reports of the rig before come late"])
def test_another_rig_holds_from_the_frame_on_that_the_event_names(
    tmp_path: Path, told: list[Message], late: bool
) -> None:
    before, after = two_rigs()
    listener = Listener(tmp_path, answer(before)).hears(told[:8])
    listener.answers = answer(after)
    read = event(1, 3, pb.RIG_READ, "")
    (heard,) = listener.hears([read, told[8], *told[9:]] if late else [told[8], read, *told[9:]]).recordings()
    assert [(first, encode_rig(one)) for first, one in heard.rigs()] == [
        (0, encode_rig(before)),
        (3, encode_rig(after)),
    ]
    assert len(on_wire(heard)) == len(told) + 1


def test_another_rig_is_found_where_nobody_told_of_it(tmp_path: Path, told: list[Message]) -> None:
    before, after = two_rigs()
    listener = Listener(tmp_path, answer(before)).hears(told[:9])
    listener.answers, listener.now_s = answer(after), 60.0
    (heard,) = listener.hears(told[9:]).recordings()
    assert len(heard.rigs()) == 2


def test_what_did_not_arrive_is_counted_by_its_numbers(tmp_path: Path, told: list[Message]) -> None:
    # Of frame 2 nothing comes, of frame 4 one pose does not; frame 3 was dropped by the server itself.
    messages = [*told[:6], status(1), event(1, 1), *told[12:13], *told[14:], status(2), event(4, 5)]
    listener = Listener(tmp_path, answer(rig())).hears(messages)
    missing = listener.camera.missing
    assert (missing.frames, missing.dropped, missing.frames_lost, missing.poses, missing.events) == (4, 1, 1, 1, 2)
    listener.recordings()
    assert listener.said[-1].startswith(
        "camera 'demo': 4 frames, 1 dropped by the server; did not arrive: 1 frames, 1 poses, 2 events; recorded in "
    )
    whole = Listener(tmp_path / "whole", answer(rig())).hears([*told, event(1, 1)])
    whole.camera.finish()
    assert "6 frames, all of them arrived; recorded in" in whole.said[-1]


def test_who_cannot_be_understood_is_refused_in_a_sentence_once(tmp_path: Path, told: list[Message]) -> None:
    newer, other = answer(rig()), answer(make_golden.RIG)
    newer.protocol = 99
    other.camera_yaml = "nonsense: ["
    for answered, words in ((newer, "its server speaks protocol 99"), (other, "is not recorded")):
        listener = Listener(tmp_path / "heard", answered)
        for _ in range(3):
            listener.now_s += 1.0
            listener.hears(told[:1])
        assert len(listener.said) == 1
        assert words in listener.said[0]
        assert listener.camera.recorder is None
    stranger = Listener(tmp_path / "heard", answer(rig()))
    stranger.camera = CameraRecording("other", stranger._begin, stranger.said.append)
    stranger.hears(told[:1])
    assert "who answers for its rig has one of camera 'demo'" in stranger.said[0]


@pytest.mark.parametrize("key", ["robot/alpha/odometry", "frame", "event"])
def test_what_no_server_makes_is_no_message(key: str) -> None:
    for payload in (b"\x07", b"", make_golden.beat().SerializeToString()):
        with pytest.raises(InputError, match=rf"asterism/cam/{key}: \d+ bytes that are no "):
            arrived(f"asterism/cam/{key}", payload)


def test_a_full_disk_is_told_and_what_was_recorded_is_kept(
    tmp_path: Path, told: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("asterism.recordings.recorder.FLUSH_S", 0.0)
    disk = SmallDisk(monkeypatch, 64 << 20)
    listener = Listener(tmp_path, answer(rig())).hears(told[:9])
    recorder = listener.camera.recorder
    assert recorder is not None
    until(lambda: (writer := recorder._poses._writer) is not None and writer.contents.messages > 3)
    disk.size = disk.used
    listener.hears(told[9:])
    (heard,) = listener.recordings()
    (problem,) = listener.camera.problems
    assert "the disk did not take everything" in problem
    disk.size += 64 << 20
    kept = on_wire(heard)
    assert 0 < len(kept) < len(told)
    assert kept == on_wire(served(tmp_path / "own", told))[: len(kept)]
