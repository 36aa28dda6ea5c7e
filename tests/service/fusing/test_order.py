"""Reports are joined in the order of their exposures, and wait for nobody who is not about to come."""

from collections.abc import Iterable, Iterator

import numpy as np

from asterism.server.service.fusing.order import Order, Waiting

MS = 1_000_000
PERIOD = 16_666_667
Heard = tuple[int, str, int]  # arrived, camera, exposed


def camera(name: str, delay_ns: int, phase_ns: int = 0, count: int = 200, first: int = 0) -> list[Heard]:
    """Its reports: each so long after its exposure."""
    times = (10**18 + phase_ns + k * PERIOD for k in range(first, count))
    return [(exposed + delay_ns, name, exposed) for exposed in times]


def joined(heard: Iterable[Heard], order: Order[str] | None = None) -> Iterator[tuple[int, int, list[str]]]:
    """When each exposure went out, its time, its cameras: with a clock that stops at arrivals and where it is to."""
    order = Order() if order is None else order
    until: int | None = None

    def looked(now_ns: int) -> Iterator[tuple[int, int, list[str]]]:
        nonlocal until
        ready, until = order.due(now_ns)
        for reports in ready:
            yield now_ns, reports[0].exposed_ns, [waiting.report for waiting in reports]

    for arrived, name, exposed in sorted(heard):
        while until is not None and until <= arrived:
            yield from looked(until)
        order.add(name, Waiting(exposed, arrived, name))
        yield from looked(arrived)
    while until is not None:
        yield from looked(until)


def test_cameras_that_expose_together_are_one_exposure_as_soon_as_the_last_is_here() -> None:
    heard = camera("left", 5 * MS) + camera("right", 9 * MS) + camera("third", 2 * MS)
    out = list(joined(heard))
    usual = out[20:]
    assert all(cameras == ["left", "right", "third"] and at - exposed == 9 * MS for at, exposed, cameras in usual)
    assert len(usual) == 180


def test_cameras_that_take_turns_wait_for_nobody() -> None:
    heard = [one for k in range(4) for one in camera(f"c{k}", 5 * MS, k * PERIOD // 4)]
    out = list(joined(heard))
    assert len(out) == len(heard)
    assert all(at - exposed == 5 * MS for at, exposed, _ in out)


def test_exposures_go_out_in_order_though_reports_overtake(rng: np.random.Generator) -> None:
    heard = [one for k in range(3) for one in camera(f"c{k}", (1 + 12 * k) * MS, k * PERIOD // 3)]
    heard = [(at + int(rng.uniform(0, 3 * MS)), name, exposed) for at, name, exposed in heard]
    order: Order[str] = Order()
    out = list(joined(heard, order))
    times = [exposed for _, exposed, _ in out]
    assert times == sorted(times)
    assert sum(order.late.values()) <= 30  # before their paces are known
    assert len(out) + sum(order.late.values()) == len(heard)


def test_uneven_stamps_lose_no_reports(rng: np.random.Generator) -> None:
    """Two cameras of one trigger, whose stamps are off by up to a millisecond."""
    heard = [
        (at + int(rng.uniform(0, MS)), name, exposed + int(rng.uniform(-MS, MS)))
        for at, name, exposed in camera("left", 5 * MS) + camera("right", 6 * MS)
    ]
    order: Order[str] = Order()
    out = list(joined(heard, order))
    assert sum(order.late.values()) <= 6
    assert max(at - exposed for at, exposed, _ in out) < 10 * MS


def test_a_camera_that_is_gone_costs_the_others_half_a_frame_once() -> None:
    order: Order[str] = Order()
    out = list(joined(camera("left", 5 * MS) + camera("right", 6 * MS, count=100), order))
    delays = [at - exposed for at, exposed, _ in out[20:]]
    late = [delay for delay in delays if delay > 6 * MS]
    assert late == [6 * MS + PERIOD // 2]
    assert max(np.diff([at for at, _, _ in out])) < 2 * PERIOD
    assert order.missed["right"] == 1
    assert order.absent == {"right"}


def test_one_that_is_back_is_waited_for_again() -> None:
    gone = camera("right", 6 * MS, count=100) + camera("right", 6 * MS, first=150)
    out = list(joined(camera("left", 5 * MS) + gone))
    assert [cameras for _, _, cameras in out[-40:]] == [["left", "right"]] * 40


def test_a_report_that_comes_late_is_counted_and_those_after_it_are_not() -> None:
    order: Order[str] = Order()
    right = camera("right", 6 * MS)
    at, name, exposed = right[120]
    right[120] = (at + 15 * MS, name, exposed)  # half a frame more would have been waited for
    out = list(joined(camera("left", 5 * MS) + right, order))
    alone = [exposed for _, exposed, cameras in out if cameras == ["left"]]
    assert [one for one in alone if one > 10**18 + 10 * PERIOD] == [exposed]  # before that its pace is not known
    assert order.late["right"] == len(alone)
    assert len(out) == 200
    assert max(at - exposed for at, exposed, _ in out) <= 6 * MS + PERIOD


def test_a_camera_that_becomes_slower_for_good_is_waited_for_as_long_as_it_takes() -> None:
    order: Order[str] = Order()
    right = camera("right", 6 * MS, count=100) + camera("right", 40 * MS, first=100, count=400)
    out = list(joined(camera("left", 5 * MS, count=400) + right, order))
    assert order.late["right"] < 45
    assert all(at - exposed == 40 * MS and len(cameras) == 2 for at, exposed, cameras in out[-200:])


def test_who_comes_much_later_than_the_others_is_not_waited_for() -> None:
    """Its clock shows another time, or its way is too long: poses of the others do not wait for it."""
    order: Order[str] = Order()
    out = list(joined(camera("left", 5 * MS) + camera("right", 150 * MS), order))
    assert all(at - exposed == 5 * MS for at, exposed, cameras in out if cameras == ["left"])
    assert order.late["right"] > 150


def test_a_frame_that_a_camera_leaves_out_costs_half_a_frame() -> None:
    right = camera("right", 6 * MS)
    del right[100]
    out = list(joined(camera("left", 5 * MS) + right))
    late = [at - exposed for at, exposed, _ in out[20:] if at - exposed > 6 * MS]
    assert late == [6 * MS + PERIOD // 2]


def test_what_was_told_of_a_session_is_not_expected_of_the_next() -> None:
    order: Order[str] = Order()
    list(joined(camera("left", 5 * MS, count=50) + camera("right", 6 * MS, count=50), order))
    order.forget("right")
    out = list(joined(camera("left", 5 * MS, first=60, count=80), order))
    assert all(at - exposed == 5 * MS for at, exposed, _ in out)


def test_whatever_the_others_do_a_camera_that_is_there_has_no_gap(rng: np.random.Generator) -> None:
    """Losses, late reports, a camera that is killed and one that joins: each exposure of the first one goes out, and no
    later than a frame after its report came.
    """
    heard = camera("left", 5 * MS, count=600)
    for name, exposures in (("right", range(600)), ("third", range(300)), ("fourth", range(200, 600))):
        for at, _, exposed in (one for k in exposures for one in camera(name, 6 * MS, first=k, count=k + 1)):
            if rng.uniform() > 0.05:
                heard.append((at + int(rng.choice([0, 40], p=[0.95, 0.05])) * MS, name, exposed))
    out = {exposed: at for at, exposed, cameras in joined(heard) if "left" in cameras}
    assert len(out) == 600
    assert max(at - exposed - 5 * MS for exposed, at in out.items()) < PERIOD
    assert max(np.diff(list(out.values()))) < 2 * PERIOD


def test_where_all_clocks_are_set_back_nothing_is_late() -> None:
    order: Order[str] = Order()
    list(joined(camera("left", 5 * MS) + camera("right", 5 * MS), order))
    for name in ("left", "right"):  # their sessions begin anew
        order.forget(name)
    back = [(at + 10**10, name, exposed - 10**12) for at, name, exposed in camera("left", 5 * MS)]
    assert len(list(joined(back, order))) == 200
    assert not order.late["left"]
