"""What waits: in order, never more than the bound, and nobody who gives is held up."""

import threading

from asterism.server.service.threads import Newest


def test_everything_is_handed_on_in_order_also_at_the_end() -> None:
    got: list[int] = []
    newest = Newest(got.append, "test", waiting=1000)
    for k in range(500):
        newest.give(k)
    newest.close(rest=True)
    assert got == list(range(500))
    assert newest.dropped == 0


def test_who_is_slow_loses_the_oldest_and_it_is_counted() -> None:
    got: list[int] = []
    held, taken = threading.Event(), threading.Event()

    def slow(value: int) -> None:
        taken.set()
        held.wait()
        got.append(value)

    newest = Newest(slow, "test", waiting=3)
    newest.give(0)
    assert taken.wait(20.0)  # it is being handed on: it waits no more
    for k in range(1, 11):
        newest.give(k)
    held.set()
    newest.close(rest=True)
    assert got == [0, 8, 9, 10]
    assert newest.dropped == 7


def test_a_fault_of_one_value_does_not_end_it() -> None:
    got: list[int] = []

    def picky(value: int) -> None:
        if value == 1:
            raise ValueError("no ones")
        got.append(value)

    newest = Newest(picky, "test", waiting=10)
    for k in range(3):
        newest.give(k)
    newest.close(rest=True)
    assert got == [0, 2]
