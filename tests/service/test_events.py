"""Events follow from the frames' results: what a robot's state was and is, since when, how often, and no flood."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_event, in_session, stamped
from asterism.protocol.errors import InputError
from asterism.protocol.event_text import is_loss, sentence
from asterism.protocol.messages import Message
from asterism.server.centres.blobs import Blobs
from asterism.server.chain.frame import FrameResult
from asterism.server.pose.solve import Lost, PoseEstimate
from asterism.server.service.events import AT_ONCE, EVERY_NS, Events
from tests.protocol import make_golden

START_NS = 1_795_398_896_000_000_000
FRAME_NS = 16_666_667
HIDDEN = Lost("its constellation is not among the spots")
ODD = Lost("bravo explains its spots as well", "IDENTITY_AMBIGUOUS")
SEEN = PoseEstimate(
    np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6), tuple(range(6)), tuple(range(6)), np.zeros((6, 2)), 0.01,
    None,
)  # fmt: skip
NOTHING = Blobs(*(np.zeros((0, n)) for n in (2, 3)), *(np.zeros(0, int) for _ in range(5)), np.zeros((0, 9)))
Answer = PoseEstimate | Lost


def result(index: int, **answers: Answer) -> FrameResult:
    return FrameResult(index, START_NS + index * FRAME_NS, NOTHING, dict(answers), np.zeros(len(answers)))


def decoded(messages: Sequence[Message]) -> list["pb.Event"]:
    return [decode_event(message.payload) for message in messages]


def told(answers: Sequence[Answer], session: int = 5) -> list["pb.Event"]:
    """The events of one robot, frame by frame."""
    events = Events("cam")
    return decoded([m for k, answer in enumerate(answers) for m in events.add(result(k, alpha=answer), session)])


def test_a_robot_that_is_lost_and_found_is_told_once_each_with_reason_and_times() -> None:
    first, lost, found = told([SEEN] * 60 + [HIDDEN] * 30 + [SEEN] * 10)
    assert (first.before, first.state, first.lasted_s) == (pb.STATE_UNSPECIFIED, pb.TRACKED, 0.0)
    assert (lost.robot, lost.happening, lost.before, lost.state) == ("alpha", pb.STATE_CHANGED, pb.TRACKED, pb.LOST)
    assert (lost.reason, lost.sequence, lost.since_ns) == (HIDDEN.reason, 60, START_NS + 60 * FRAME_NS)
    assert lost.lasted_s == pytest.approx(60 * FRAME_NS * 1e-9)
    assert (found.state, found.reason, found.sequence) == (pb.TRACKED, "", 90)
    assert found.lasted_s == pytest.approx(30 * FRAME_NS * 1e-9)
    assert [event.number for event in (first, lost, found)] == [1, 2, 3]
    assert {event.session for event in (first, lost, found)} == {5}
    assert [is_loss(event) for event in (first, lost, found)] == [False, True, False]


def test_every_change_of_state_is_one_and_another_reason_is_none() -> None:
    changed = told([SEEN, HIDDEN, Lost("none of its LEDs is visible"), ODD, SEEN])
    assert [event.state for event in changed] == [pb.TRACKED, pb.LOST, pb.IDENTITY_AMBIGUOUS, pb.TRACKED]
    assert changed[2].reason == ODD.reason


def test_the_same_results_have_the_same_events_bit_for_bit(rng: np.random.Generator) -> None:
    answers = [(SEEN, HIDDEN, ODD)[k] for k in rng.integers(0, 3, 200)]
    one, other = Events("cam"), Events("cam")
    for k, answer in enumerate(answers):
        assert one.add(result(k, alpha=answer), 0) == other.add(result(k, alpha=answer), 0)


def test_one_that_flickers_is_told_of_now_and_then_and_what_was_left_out_is_counted(rng: np.random.Generator) -> None:
    flickering: list[Answer] = [SEEN, HIDDEN] * 600
    for restless in (flickering, [flickering[k] for k in rng.integers(0, 2, 1200)]):
        answers = [*restless, *[SEEN] * 60]  # quiet at last
        changes = 1 + sum(a is not b for a, b in pairwise(answers))
        events = told(answers)
        assert len(events) <= AT_ONCE + 1 + len(answers) * FRAME_NS / EVERY_NS
        assert sum(1 + event.left_out for event in events) == changes
        assert [event.left_out for event in events[:AT_ONCE]] == [0] * AT_ONCE
        # Each goes on where the one before ended, and the last is how things are.
        assert [event.before for event in events[1:]] == [event.state for event in events[:-1]]
        assert events[-1].state == pb.TRACKED
        since = [event.since_ns for event in events]
        assert since == sorted(since)
        lasted = [(b - a) * 1e-9 for a, b in pairwise(since)]
        assert [event.lasted_s for event in events[1:]] == pytest.approx(lasted)


def test_one_robots_flicker_costs_no_other_its_events() -> None:
    events = Events("cam")
    for k in range(300):
        made = events.add(result(k, alpha=(SEEN, HIDDEN)[k % 2], bravo=HIDDEN if k == 299 else SEEN), 5)
    assert "bravo" in {event.robot for event in decoded(made)}


def test_another_session_tells_every_robots_state_again() -> None:
    events = Events("cam")
    events.add(result(0, alpha=SEEN, bravo=HIDDEN), 5)
    again = decoded(events.add(result(1, alpha=SEEN, bravo=HIDDEN), 6))
    assert [(e.robot, e.before, e.number, e.session) for e in again] == [("alpha", 0, 1, 6), ("bravo", 0, 2, 6)]


def test_robots_that_join_and_leave_the_rig_are_told() -> None:
    events = Events("cam")
    events.add(result(0, alpha=SEEN, bravo=SEEN), 5)
    joined, left = decoded(events.add(result(1, alpha=SEEN, charlie=HIDDEN), 5))[::-1]
    assert (left.robot, left.before, left.state, left.reason) == ("bravo", pb.TRACKED, 0, "the rig has it no more")
    assert (joined.robot, joined.before, joined.state) == ("charlie", 0, pb.LOST)
    assert is_loss(left)
    assert events.add(result(2, alpha=SEEN, charlie=HIDDEN), 5) == []


def test_frames_that_stop_and_come_again_are_told_once() -> None:
    events = Events("cam")
    assert events.silent(0.5, "why") == []  # none has come yet
    events.add(result(0, alpha=SEEN), 5)
    (stopped,) = decoded(events.silent(0.5, "the camera vanished"))
    assert (stopped.robot, stopped.happening, stopped.reason) == ("", pb.FRAMES_STOPPED, "the camera vanished")
    assert (stopped.since_ns, stopped.sequence) == (START_NS, 0)
    assert is_loss(stopped)
    assert events.silent(1.0, "the camera vanished") == []
    (came,) = decoded(events.add(result(120, alpha=SEEN), 5))
    assert (came.happening, came.sequence, came.lasted_s) == (pb.FRAMES_CAME, 120, pytest.approx(120 * FRAME_NS * 1e-9))
    assert not is_loss(came)


def test_slow_cameras_do_not_stop_between_two_frames() -> None:
    events = Events("cam")
    for k in range(3):
        events.add(result(60 * k, alpha=SEEN), 5)  # one a second
        assert k == 0 or events.silent(1.0, "") == []
    assert decoded(events.silent(3.5, ""))[0].happening == pb.FRAMES_STOPPED


def test_another_rig_and_a_refused_one_are_told_before_the_frame_they_are_of() -> None:
    events = Events("cam")
    events.add(result(0, alpha=SEEN), 5)
    (read,) = decoded(events.rig_read("", (START_NS + FRAME_NS, 1), 0, 5))
    assert (read.happening, read.sequence, read.since_ns) == (pb.RIG_READ, 1, START_NS + FRAME_NS)
    (refused,) = decoded(events.rig_read("rig.yaml: five LEDs", None, START_NS, 5))
    assert (refused.happening, refused.reason, refused.sequence) == (pb.RIG_REFUSED, "rig.yaml: five LEDs", 1)


def test_a_stamp_and_a_session_come_last_and_a_person_can_read_it() -> None:
    (message,) = Events("cam").add(result(3, alpha=SEEN), 5)
    assert (message.key, message.log_ns, message.sequence) == ("asterism/cam/event", START_NS + 3 * FRAME_NS, 3)
    out = in_session(stamped(message, START_NS), 77)
    assert out.payload.startswith(message.payload)
    event = decode_event(out.payload)
    assert (event.published_ns, event.session) == (START_NS, 77)
    assert sentence(event) == "alpha: TRACKED"
    assert sentence(make_golden.event()) == (
        "bravo: LOST (TRACKED 12.5 s before, 2 changes between): its constellation is not among the spots"
    )


@pytest.mark.parametrize("wrong", [{"happening": 0}, {"happening": 99}, {"state": 77}, {"number": 0},
                                   {"lasted_s": float("nan")}, {"since_ns": 1 << 63}])  # fmt: skip
def test_what_no_server_makes_is_no_event(wrong: dict[str, int]) -> None:
    event = make_golden.event()
    for name, value in wrong.items():
        setattr(event, name, value)
    with pytest.raises(InputError, match=r"bytes that are no asterism\.Event"):
        decode_event(event.SerializeToString())
    for payload in (
        b"",
        b"\x07",
        make_golden.status().SerializeToString(),
        make_golden.frame_report().SerializeToString(),
    ):
        with pytest.raises(InputError, match=r"bytes that are no asterism\.Event"):
            decode_event(payload)
