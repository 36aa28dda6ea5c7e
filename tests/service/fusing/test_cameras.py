"""Which cameras are joined: what is known of each, and what is said of those that do not fit."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_rig, encode_rig, to_bytes
from asterism.protocol.messages import PROTOCOL, Happening
from asterism.protocol.rig import Rig
from asterism.server.fusing.fleet import View
from asterism.server.service.fusing.answer import Answer, read_answer
from asterism.server.service.fusing.cameras import Cameras
from tests.fusing.drawn import sighting
from tests.service.fusing.speaking import report_of, with_texts
from tests.several import Drive, facing_pair, rigs_at

S = 1_000_000_000
LEFT, RIGHT = (with_texts(rig) for rig in rigs_at(facing_pair()))
DRIVE = Drive(tuple(robot.id for robot in LEFT.robots))


def answer(rig: Rig, session: int, pid: int = 7, protocol: int = PROTOCOL) -> Answer:
    told = encode_rig(rig) + to_bytes(pb.RigReport(session=session, pid=pid, host="here", protocol=protocol))
    return read_answer(decode_rig(told), rig.camera.name, ())


class Told:
    """Cameras, and what they had said; time passes by what they are told."""

    def __init__(self, wanted: Sequence[str] = ()) -> None:
        self.said: list[str] = []
        self.changed: list[str] = []
        self.cameras = Cameras(wanted, self.said.append, self.changed.append)
        self.now_ns = S
        self._rng = np.random.default_rng(0)

    def report(self, rig: Rig, session: int, sequence: int = 0, after_s: float = 0.016) -> bool:
        """A frame of that camera comes; whether it is taken."""
        self.now_ns += int(after_s * S)
        placed = replace(rig, T_world_camera=rig.T_world_camera or facing_pair()[0])
        seen = sighting(View(placed), DRIVE(0.0), self.now_ns, self._rng)
        payload = to_bytes(report_of(seen, sequence, session))
        return self.cameras.report(rig.camera.name, 0, payload, self.now_ns) is not None

    def joins(self, rig: Rig, session: int) -> bool:
        """It comes and answers; whether its frames are taken then."""
        self.cameras.token(rig.camera.name, 0, True, self.now_ns)
        self.report(rig, session)
        assert rig.camera.name in [camera.name for camera in self.cameras.asks(self.now_ns)]
        self.cameras.answered(rig.camera.name, [answer(rig, session)])
        return self.report(rig, session)

    def problems(self) -> str:
        return "; ".join(self.cameras.problems(self.now_ns))


def test_a_camera_is_joined_when_its_rig_is_known() -> None:
    told = Told()
    assert not told.report(LEFT, 5)
    assert [camera.name for camera in told.cameras.asks(told.now_ns)] == ["left"]
    assert not told.cameras.asks(told.now_ns)
    assert told.cameras.answered("left", [answer(LEFT, 5)])
    assert told.report(LEFT, 5)
    assert told.joins(RIGHT, 6)
    assert list(told.cameras.fleet.views) == ["left", "right"]
    assert told.said == ["camera 'left' is joined: 2 robots", "camera 'right' is joined: 2 robots"]
    assert told.problems() == ""
    assert set(told.changed) == {"left", "right"}


def test_the_same_frame_heard_twice_counts_once() -> None:
    told = Told()
    assert told.joins(LEFT, 5)
    assert not told.report(LEFT, 5, after_s=0.0)


@pytest.mark.parametrize(
    ("rig", "protocol", "why"),
    [
        (replace(with_texts(replace(RIGHT, T_world_camera=None)), offset_texts={}), PROTOCOL, "the rig has no `world`"),
        (
            RIGHT,
            PROTOCOL + 1,
            "speaks protocol 3, this program 2, expected the same: update asterism-localization here",
        ),
        (RIGHT, 1, "speaks protocol 1, this program 2, expected the same: update asterism-localization there"),
    ],
    ids=["no world", "newer", "older"],
)
def test_who_does_not_fit_is_not_joined_and_the_others_are(rig: Rig, protocol: int, why: str) -> None:
    told = Told()
    assert told.joins(LEFT, 5)
    told.report(rig, 6)
    told.cameras.answered("right", [answer(rig, 6, protocol=protocol)])
    assert not told.report(rig, 6)
    assert told.report(LEFT, 5)
    assert why in told.said[-1]
    assert told.said[-1].startswith("camera 'right' is not joined")
    assert why in told.problems()
    assert list(told.cameras.fleet.views) == ["left"]


def test_robots_that_differ_keep_the_second_camera_out_until_they_do_not() -> None:
    told = Told()
    leds = np.array(RIGHT.robots[0].leds)
    leds[2] += [0.0, 0.002, 0.0]
    other = with_texts(replace(RIGHT, robots=(replace(RIGHT.robots[0], leds=leds), RIGHT.robots[1])))
    assert told.joins(LEFT, 5)
    assert not told.joins(other, 6)
    assert (
        "robot 'r00' is another one in the rig of camera 'right' than in that of 'left': LED 2 is 2 mm"
        in told.problems()
    )
    told.now_ns += 11 * S  # it is asked again
    assert told.joins(RIGHT, 6)
    assert told.problems() == "camera 'left' tells of no frames, for 11 s"


def test_two_cameras_of_one_name_are_told_and_the_first_is_taken() -> None:
    told = Told()
    assert told.joins(LEFT, 5)
    for k in range(100):
        assert told.report(LEFT, 5, k)
        assert not told.report(LEFT, 8, k)
    told.cameras.answered("left", [answer(LEFT, 8, pid=9), answer(LEFT, 5)])
    assert told.problems() == (
        "two cameras are called 'left': that of process 7 on here was heard first and is taken, that of process 9 on "
        "here is not: give one of them another camera_name"
    )
    told.now_ns += 3 * S
    assert told.report(LEFT, 5)
    assert told.problems() == ""


def test_a_server_that_starts_anew_is_taken_when_the_one_before_is_quiet() -> None:
    told = Told()
    assert told.joins(LEFT, 5)
    told.cameras.token("left", 0, False, told.now_ns)
    told.now_ns += 2 * S
    assert told.problems() == "camera 'left' is gone, for 2 s"
    told.changed.clear()
    assert told.joins(LEFT, 9)
    assert told.changed
    assert told.problems() == ""
    assert told.said[1:3] == ["camera 'left' is gone", "camera 'left' is back"]


def test_frames_of_a_rig_that_is_read_again_wait_for_it() -> None:
    told = Told()
    assert told.joins(LEFT, 5)
    event = pb.Event(happening=Happening.RIG_READ, since_ns=1, sequence=20, session=5, number=1)
    told.cameras.event("left", 0, to_bytes(event), told.now_ns)
    assert told.report(LEFT, 5, 19)
    assert not told.report(LEFT, 5, 20)
    assert told.cameras.asks(told.now_ns)
    moved = with_texts(replace(LEFT, T_world_camera=facing_pair(50)[0]))
    assert told.cameras.answered("left", [answer(moved, 5)])
    assert told.report(LEFT, 5, 21)
    assert told.said[-1] == "camera 'left' is joined, by another rig: 2 robots"


def test_only_the_cameras_that_are_asked_for_are_joined() -> None:
    told = Told(["right", "third"])
    assert not told.report(LEFT, 5)
    assert told.joins(RIGHT, 6)
    assert list(told.cameras.heard) == ["right"]
    assert told.problems() == "camera 'third' is not heard"


def test_what_is_no_report_is_said_once_and_passed_over() -> None:
    told = Told()
    assert told.joins(LEFT, 5)
    for _ in range(3):
        assert told.cameras.report("left", 0, b"\xff\xff", told.now_ns) is None
    assert sum("no asterism.FrameReport" in line for line in told.said) == 1
    assert told.cameras.report("fused", 0, b"\xff\xff", told.now_ns) is None
    assert "fused" not in told.cameras.heard


def test_a_frame_exposed_long_after_it_was_published_makes_no_other_late() -> None:
    told = Told()
    assert told.joins(LEFT, 5)
    report = pb.FrameReport(session=5, exposed_ns=told.now_ns + 3600 * S, published_ns=told.now_ns)
    assert told.cameras.report("left", 0, to_bytes(report), told.now_ns) is None
    assert "exposed 3.6e+03 s after they were published" in told.said[-1]
    assert told.report(LEFT, 5)


def test_a_rig_is_read_once_and_none_that_is_endless(monkeypatch: pytest.MonkeyPatch) -> None:
    first = answer(LEFT, 5)
    assert first.view is not None
    wrong = decode_rig(to_bytes(pb.RigReport(session=5, protocol=PROTOCOL, rig_yaml="- a", camera_yaml="x")))
    refused = read_answer(wrong, "left", ())
    assert refused.problem
    monkeypatch.setattr("asterism.server.service.fusing.answer.parse_rig", None)
    assert answer(LEFT, 6).view is first.view
    assert read_answer(wrong, "left", ()).problem == refused.problem
    wrong.rig_yaml = "- a\n" * 100_000
    assert "its rig is longer than" in read_answer(wrong, "left", ()).problem
