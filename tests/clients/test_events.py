"""Events as a robot program has them: told when it is lost and why, none skipped, and who misses some knows."""

import itertools
from typing import Any

import pytest

from asterism.clients import LinkState, PoseClient, RobotEvent
from asterism.clients.event_feed import MOST_WAITING, EventFeed, EventReader
from asterism.clients.servers import Servers
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import EVENT, Message
from tests.clients.serving import Server, until

WHY = "its constellation is not among the spots"


def event(number: int, robot: str = "alpha", **changes: Any) -> "pb.Event":
    made = pb.Event(
        robot=robot, happening=pb.STATE_CHANGED, before=pb.TRACKED, state=pb.LOST, reason=WHY, lasted_s=12.5,
        since_ns=1, sequence=42, session=7, number=number,
    )  # fmt: skip
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def tell(server: Server, told: "pb.Event", age_s: float = 0.0) -> None:
    told.since_ns, told.session = server.clock.now_ns() - round(1e9 * age_s), server.clock.session
    server.publisher.publish([Message(keys.event("cam"), EVENT, to_bytes(told), told.since_ns, 0, told.sequence)])


def read(*told: "pb.Event | bytes") -> tuple[list[RobotEvent], EventReader]:
    """What a reader hands on of these messages."""
    arrived: list[RobotEvent] = []
    reader = EventReader(Servers(""), arrived.append)
    for one in told:
        reader.read(one if isinstance(one, bytes) else to_bytes(one), "cam")
    return arrived, reader


def test_a_robot_is_told_when_it_is_lost_and_why_and_nothing_of_others(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        alpha, seen, of_all = robots["alpha"], [], []
        alpha.on_event(seen.append)
        robots.all().on_event(of_all.append)
        number = itertools.count(1)
        until(lambda: robots.alive)
        until(lambda: tell(server, event(next(number), "bravo"), 0.5) or of_all)
        assert seen == []
        last = next(number)
        tell(server, event(last), 0.5)
        until(lambda: seen)
        (lost,) = seen
        assert (lost.robot, lost.camera, lost.before, lost.state, lost.reason) == (
            "alpha",
            "cam",
            "TRACKED",
            "LOST",
            WHY,
        )
        assert (lost.lost, lost.lasted_s, lost.sequence, lost.number) == (True, 12.5, 42, last)
        until(lambda: 0.4 < lost.age_s < 60.0)  # by the server's clock, once it is known
        assert alpha.event is lost
        assert lost.sentence == f"alpha: LOST (TRACKED for 12.5 s before): {WHY}"
        assert robots.events_missed == 0
        assert robots.link.state is LinkState.LIVE
        assert alpha.link.sentence.startswith(f"robot 'alpha': no pose yet ({WHY}); camera 'cam'")


def test_what_is_of_the_camera_is_told_to_all(endpoint: str, server: Server) -> None:
    with PoseClient(endpoint) as robots:
        feeds = [robots["alpha"], robots["bravo"], robots.all()]
        number = itertools.count(1)
        stopped = {"happening": pb.FRAMES_STOPPED, "before": 0, "state": 0, "reason": "the camera vanished"}
        until(lambda: tell(server, event(next(number), "", **stopped)) or all(feed.event for feed in feeds))
        for feed in feeds:
            assert feed.event is not None
            assert (feed.event.happening, feed.event.lost, feed.event.robot) == ("FRAMES_STOPPED", True, "")


def test_iteration_skips_none_and_ends_with_the_client() -> None:
    feed = EventFeed()
    (*made,), _ = read(*(event(number) for number in range(1, 5)))
    events = feed.after_now(20.0)
    for one in made[:3]:
        feed.take(one)
    assert [next(events).number for _ in range(3)] == [1, 2, 3]
    assert list(feed.after_now(0.01)) == []
    feed.take(made[3])
    feed.close()
    assert list(events) == []
    assert feed.newest is made[3]


def test_who_is_far_behind_gets_the_newest() -> None:
    feed = EventFeed()
    events = feed.after_now(0.0)
    made, _ = read(*(event(number) for number in range(1, MOST_WAITING + 11)))
    for one in made:
        feed.take(one)
    assert [one.number for one in events] == list(range(11, MOST_WAITING + 11))


@pytest.mark.parametrize(
    ("numbers", "missed"), [((1, 2, 3), 0), ((5, 6, 9), 2), ((7, 7, 3), 0)], ids=["all", "some", "a replay's loop"]
)
def test_events_that_did_not_arrive_are_counted(numbers: tuple[int, ...], missed: int) -> None:
    arrived, reader = read(*(event(number) for number in numbers))
    assert len(arrived) == len(numbers)
    assert reader.missed == missed


def test_in_another_session_numbers_begin_anew() -> None:
    _, reader = read(event(5), event(9, session=8), event(10, session=8))
    assert reader.missed == 0


def test_what_is_no_event_is_counted_and_ignored(caplog: pytest.LogCaptureFixture) -> None:
    arrived, reader = read(b"\x07", event(0), event(1, state=99), event(2))
    assert [one.number for one in arrived] == [2]
    assert reader.refused == 3
    assert "bytes that are no asterism.Event" in caplog.text
