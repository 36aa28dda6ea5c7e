"""What waits for fuse's loop has bounds: who floods loses its own."""

from asterism.server.service.fusing.ears import Answers, Heard
from asterism.server.service.fusing.inbox import MOST, MOST_AT_ONCE, MOST_FRAMES, Inbox


def test_a_camera_that_floods_takes_no_room_from_others() -> None:
    inbox = Inbox()
    for k in range(10_000):
        inbox.put(Heard(0, "loud", "frame", b"", k))
    assert inbox.put(Heard(0, "left", "frame", b"", 0))
    assert inbox.put(Heard(0, "loud", "event", b"", 0))
    assert inbox.lost == 10_000 - MOST_FRAMES
    some = inbox.taken(0.0)
    assert [heard.camera for heard in some] == ["loud"] * MOST_FRAMES + ["left", "loud"]
    assert inbox.put(Heard(0, "loud", "frame", b"", 0))


def test_names_without_end_leave_room_for_answers_and_the_loop_goes_on() -> None:
    inbox = Inbox()
    for k in range(2 * MOST):
        inbox.put(Heard(0, f"c{k}", "alive", None, 0))
    assert inbox.lost == MOST
    assert inbox.put(Answers("left", ()))
    assert len(inbox.taken(0.0)) == MOST_AT_ONCE
    taken = [heard for _ in range(MOST // MOST_AT_ONCE) for heard in inbox.taken(0.0)]
    assert taken[-1] == Answers("left", ())
    assert inbox.taken(0.0) == []
