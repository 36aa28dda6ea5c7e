"""Values handed to a thread of its own: in order, the newest, and at the end as much as was asked for."""

import threading

import pytest

from asterism.server.service.threads import Newest


class Slow:
    """Takes values once it may."""

    def __init__(self, waiting: int) -> None:
        self.taken: list[int] = []
        self.begun, self.may = threading.Event(), threading.Event()
        self.newest = Newest(self._take, "slow", waiting)

    def _take(self, value: int) -> None:
        self.begun.set()
        assert self.may.wait(20.0)
        self.taken.append(value)


@pytest.mark.parametrize(("waiting", "taken"), [(1, [0, 5]), (3, [0, 3, 4, 5]), (8, [0, 1, 2, 3, 4, 5])])
def test_who_is_slow_misses_the_oldest(waiting: int, taken: list[int]) -> None:
    slow = Slow(waiting)
    slow.newest.give(0)
    assert slow.begun.wait(20.0)
    for value in range(1, 6):
        slow.newest.give(value)
    slow.may.set()
    slow.newest.close(20.0, rest=True)
    assert slow.taken == taken


def test_what_waits_at_the_end_is_left_unless_it_is_wanted() -> None:
    slow = Slow(3)
    slow.newest.give(0)
    assert slow.begun.wait(20.0)
    slow.newest.give(1)
    slow.newest.close(0.0)  # which leaves the call that goes on behind
    slow.may.set()
    slow.newest.close(20.0)
    assert slow.taken == [0]
