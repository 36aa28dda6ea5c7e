"""asterism replay: a recording whose clock was set is played in its order, and no step is waited out."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_rig
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.recordings.reader import Recording
from asterism.server.command.replay import _answering, _play
from asterism.server.service.play_clock import PlayClock
from asterism.server.service.stop import Stop
from asterism.server.sources.open_source import open_source
from tests.recordings.mutations import hand_made, write_file
from tests.recordings.reloaded import record_reloaded, two_rigs

HOUR_NS = 3_600_000_000_000


class Listener:
    """In a publisher's place."""

    def __init__(self, clock: PlayClock) -> None:
        self._clock = clock
        self.sequences: list[int] = []
        self.sessions: list[int] = []
        self.rig_payload = b""

    def put(self, message: Message) -> None:
        self.sequences.append(message.sequence)
        self.sessions.append(self._clock.session)

    def show_visible(self, robots: Iterable[str]) -> None:
        """Nobody looks."""


def stepped(messages: list[Message], step_ns: int) -> list[Message]:
    """As if the clock had been set before frame 5."""
    return [
        replace(m, log_ns=m.log_ns + step_ns, publish_ns=m.publish_ns + step_ns) if m.sequence >= 5 else m
        for m in messages
    ]


@pytest.mark.parametrize(("step_ns", "words"), [(HOUR_NS, "for 3600.0 s"), (-HOUR_NS, "set back by 3600.0 s")])
def test_a_step_of_the_clock_is_said_and_not_waited_out(
    caplog: pytest.LogCaptureFixture, step_ns: int, words: str
) -> None:
    told = stepped(hand_made(10, np.random.default_rng(0))[0], step_ns)
    clock = PlayClock(1.0)
    listener = Listener(clock)
    with caplog.at_level("INFO"):
        assert _play(iter(told), listener, clock, Stop()) == len(told)  # type: ignore[arg-type]
    assert words in caplog.text
    assert listener.sequences == [message.sequence for message in told]
    assert len(set(listener.sessions)) == 2


@pytest.mark.parametrize("step_ns", [HOUR_NS, -60_000_000])
def test_frames_keep_the_order_in_which_they_were_taken(tmp_path: Path, step_ns: int) -> None:
    told, images = (stepped(messages, step_ns) for messages in hand_made(10, np.random.default_rng(0)))
    write_file(tmp_path, "poses", told, "zstd", 9)
    write_file(tmp_path, "frames", images, "", 4)
    recording = Recording(tmp_path)
    assert [number for _, _, number in recording.frames()] == list(range(10))
    # An image comes before what was made of it, whatever their times.
    both = [(m.sequence, m.kind.schema != "foxglove.RawImage") for m in recording.messages_and_images()]
    assert both == sorted(both)
    said: list[str] = []
    source = open_source(str(tmp_path), None, said.append)
    assert [frame.index for frame in source.frames()] == list(range(10))
    assert bool(said) == (step_ns < 0)
    assert source.rate_hz == pytest.approx(60.0, rel=1e-4)


def test_a_replay_answers_with_the_rig_that_was_in_force(tmp_path: Path) -> None:
    recording = record_reloaded(tmp_path, lambda _, number: pb.FrameReport(sequence=number, exposed_ns=10**18 + number))
    rigs = [(0, two_rigs()[0].rig_text), (3, two_rigs()[1].rig_text)]
    assert [(since, rig.rig_text) for since, rig in recording.rigs()] == rigs
    listener = Listener(PlayClock(1.0))
    answers = {
        message.sequence: [robot.id for robot in decode_rig(listener.rig_payload).robots]
        for message in _answering(recording, listener)  # type: ignore[arg-type]
        if message.kind == FRAME_REPORT
    }
    first, second = ([robot.id for robot in rig.robots] for rig in two_rigs())
    assert answers == {1: first, 2: first, 3: second, 4: second}
